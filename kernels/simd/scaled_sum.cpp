// Body of scaled_sum in sums.py.
#pragma clang fp contract(off)
const auto x = reinterpret_cast<const number*>(call.data[0]) + first;
const auto y = reinterpret_cast<const number*>(call.data[1]) + first;
const auto out = reinterpret_cast<number*>(call.data[2]) + first;
const number a = c[0], b = c[1];
#pragma clang loop vectorize(assume_safety)
for (long i = 0; i < m; ++i) out[i] = a * x[i] + b * y[i];
