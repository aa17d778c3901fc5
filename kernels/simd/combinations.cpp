// Body of combinations in sums.py.
const auto x = reinterpret_cast<const number*>(call.data[0]) + first;
const auto out = reinterpret_cast<number*>(call.data[2]) + first;
const number scale = *c++;
number sum[most] = {};
auto row = reinterpret_cast<const number*>(call.data[1]) + first;
long left = call.data[3];
for (; left >= 4; left -= 4, row += 4 * n, c += 4) {
    const number a = c[0], b = c[1], d = c[2], e = c[3];
    const auto r = row + n, s = r + n, t = s + n;
    for (long i = 0; i < m; ++i) sum[i] += (a * row[i] + b * r[i]) + (d * s[i] + e * t[i]);
}
for (; left > 0; --left, row += n, ++c) {
    const number a = *c;
    for (long i = 0; i < m; ++i) sum[i] += a * row[i];
}
#pragma clang loop vectorize(assume_safety)
for (long i = 0; i < m; ++i) out[i] = scale * (x[i] + sum[i]);
