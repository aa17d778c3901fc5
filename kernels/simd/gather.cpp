// Body of gather in memory.py.
const auto sum = [&](int lane) {
    const auto at = places.data[first + lane];
    auto total = local.data[at.c[0] + offset];
    if (at.c[1] >= 0) {
        total += local.data[at.c[1] + offset];
        if (at.c[2] >= 0)
            total += local.data[at.c[2] + offset] + local.data[at.c[3] + offset];
    }
    return total;
};
return as_value(each_lane(sum));
