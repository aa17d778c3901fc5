// Body of add in add_functions of arithmetic.py.
alignas(64) number found[$functions * lanes];
const auto number_of = reinterpret_cast<const int*>(numbers.data + e * $functions);
#pragma clang loop vectorize(disable) unroll_count(16)  // the processor's own gathers are slow
for (int i = 0; i < $functions * lanes; ++i) found[i] = coefficients.data[number_of[i]];
const auto at = runs(found);
const auto add = [](run a, run b) {
    #ifdef __CUDA_ARCH__  // a fused multiply-add would depend on the order of the functions
        return run(sizeof(number) == 4 ? __fadd_rn(a, b) : __dadd_rn(a, b));
    #else
        return a + b;
    #endif
};
const auto to = runs(x.data) + e * $points;
for (int n = begin; n < end; ++n) {
    const auto part = [&](int k) { return values.data[k * $points + n] * at[k]; };
    run sum = part(0), modes = {};
    for (int k = 1; k < $smooth; ++k) sum = add(sum, part(k));
    for (int k = $smooth; k < $smooth + 4; ++k)
        modes = add(modes, add(part(k), add(part(k + 4), part(k + 8))));
    to[n] += add(sum, modes);
}
