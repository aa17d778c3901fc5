// Body of line_sum in arithmetic.py.
const int count = sizeof(*f.data) / sizeof(run);
run sums[count];
#pragma unroll
for (int m = 0; m < $np; ++m) {
    const auto a = d.data[$factor];
    const auto at = reinterpret_cast<const run*>(f.data + ($node));
    #pragma unroll
    for (int k = 0; k < count; ++k) {
        const run product = a * at[k];
        sums[k] = m > 0 ? sums[k] + product : product;
    }
}
auto r = *f.data;
const runs each = runs(&r);
#pragma unroll
for (int k = 0; k < count; ++k) each[k] = sums[k];
return r;
