// A register of numbers found one by one.  If a kernel does little else with 16 of them, stores and a
// load are faster than inserts; the processor's own gathers are slower than either.
const auto each_lane = [](auto number_of) {
    number each[lanes];
    if (lanes > 8) {
        #pragma clang loop vectorize(disable) unroll(disable)
        for (int lane = 0; lane < lanes; ++lane) each[lane] = number_of(lane);
    } else {
        #pragma clang loop unroll(full)
        for (int lane = 0; lane < lanes; ++lane) each[lane] = number_of(lane);
    }
    return *runs(each);
};
