// Body of put in shared_lines.py.
const auto to = reinterpret_cast<number*>(room) + p;
#pragma unroll
for (int k = 0; k < $count; ++k) {
    to[k * $apart] = first.c[k];
    to[($count + k) * $apart] = second.c[k];
}
