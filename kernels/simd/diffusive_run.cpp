// Body of diffusive_run in stages.py.
const auto scaled = [&](const auto& v, auto c) {
    run r = *runs(v.data + at);
    r *= c;
    return r;
};
run d = scaled(last, cl), r = scaled(rate, cr);
d += scaled(before, cb);
r += scaled(first, cf);
r += scaled(slope, cs);
d += r;
r = *runs(x.data + at);
r += d;
*runs(y.data + at) = r;
*runs(change.data + at) = d;
