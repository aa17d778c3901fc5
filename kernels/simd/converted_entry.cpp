// Entry k of `values` in coarse.py, as a register of another number type.
[&] {
    number each[lanes];
    for (int lane = 0; lane < lanes; ++lane)
        each[lane] = number(values.data[k * lanes + lane]);
    return *runs(each);
}()
