// Body of shared_sum in shared_lines.py.
const auto from = reinterpret_cast<const number*>(room) + $begin;
number sums[$count] = {};
#pragma unroll
for (int m = 0; m < $np; ++m) {
    const auto a = d.data[$factor];
    #pragma unroll
    for (int k = 0; k < $count; ++k) {
        const auto product = a * from[k * $apart + $node];
        sums[k] += product;
    }
}
wp::vec_t<$count, number> r;
#pragma unroll
for (int k = 0; k < $count; ++k) r.c[k] = sums[k];
return r;
