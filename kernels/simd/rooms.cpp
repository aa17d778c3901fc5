// Body of rooms in arithmetic.py; `wide` is a register of double.
typedef double wide $attributes;
const auto widen = [](run r) { return $widened; };
wide sums[3] = {};
const auto add = [&](auto mass, auto h, auto space, auto to) {
    const auto least = low * h, most = high * h;
    auto clipped = mass < least ? least : mass;  // NaN stays NaN
    clipped = clipped > most ? most : clipped;
    const auto over = mass - clipped, above = most - clipped, below = clipped - least;
    to(0, over, space); to(1, above, space); to(2, below, space);
};
int i = begin;
for (; i + lanes <= end; i += lanes)
    add(*runs(x.data + first + i), *runs(x.data + depth + i), *(const wide*)(area.data + i),
        [&](int s, run r, wide a) { sums[s] += a * widen(r); });
double left[3] = {};
for (; i < end; ++i)
    add(x.data[first + i], x.data[depth + i], area.data[i],
        [&](int s, auto r, double a) { left[s] += a * double(r); });
wp::vec3d total;
for (int s = 0; s < 3; ++s) {
    total[s] = left[s];
    for (int lane = 0; lane < lanes; ++lane)
        total[s] += reinterpret_cast<const double*>(&sums[s])[lane];
}
return total;
