// Body of store_stage in stages.py, of $fields fields.
for (int f = 0; f < $fields; ++f, at += size) {
    run r = runs(&rates)[f];
    if (s.on) {
        r *= s.tau;
        r += *runs(s.start.data + at);
    }
    *runs(out.data + at) = r;
}
