// Body of run_strips in strips.py.
typedef void (*entry)(void*, void*);
const long launches = table.shape[0], width = table.shape[1];
for (long strip = first; strip >= last; --strip)
    for (const auto* t = table.data; t < table.data + launches * width; t += width) {
        const long r = strip + long(t[8]);
        if (r < 0 || r >= strips) continue;
        const auto starts = reinterpret_cast<const int*>(t[3]) + r;
        const long threads = starts[1] - starts[0];
        if (threads <= 0) continue;
        *reinterpret_cast<int*>(t[2]) = t[4] + t[5] * starts[0];
        *reinterpret_cast<unsigned*>(t[1]) = threads;
        *reinterpret_cast<size_t*>(t[1] + t[6]) = threads * t[7];
        reinterpret_cast<entry>(t[0])(
            reinterpret_cast<void*>(t[1]), reinterpret_cast<void*>(t[2])
        );
    }
