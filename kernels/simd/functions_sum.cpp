// Body of add in functions_sum of arithmetic.py.
alignas(64) number found[$functions * lanes];
const auto number_of = reinterpret_cast<const int*>(numbers.data + e * $functions);
#pragma clang loop vectorize(disable) unroll_count(16)  // the processor's own gathers are slow
for (int i = 0; i < $functions * lanes; ++i) found[i] = coefficients.data[number_of[i]];
const auto at = runs(found);
const auto to = runs(x.data) + e * $points;
for (int n = begin; n < end; ++n) {
    const auto part = [&](int k) { return values.data[k * $points + n] * at[k]; };
    run sum = part(0), modes = {};
    for (int k = 1; k < $smooth; ++k) { const run hat = part(k); sum += hat; }
    for (int k = $smooth; k < $smooth + 4; ++k) {
        const run first = part(k + 4), second = part(k + 8), both = part(k);
        const run along = first + second;
        const run corner = both + along;
        modes += corner;
    }
    sum += modes;
    to[n] += sum;
}
