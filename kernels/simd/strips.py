"""A sequence of launches on a CPU, strip by strip of a mesh."""

import warp as wp

from swe_sphere.kernels.define import Register, kernel

Table = wp.array2d(dtype=wp.uint64)


@Register.func_native("""
    typedef void (*entry)(void*, void*);
    const long launches = table.shape[0], width = table.shape[1];
    const long lag = table.data[(launches - 1) * width + 8];
    for (long strip = strips - 1; strip >= -lag; --strip)
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
""")
def run_strips(table: Table, strips: int): ...


@kernel
def sweep_strips(table: Table, strips: int):
    """Run launches strip by strip, from the last strip to the first; of one thread.

    A row of the table describes a launch: the addresses of its function, its bounds, its arguments
    and the first thread of each strip (strips + 1,); the first argument of its first thread, and by
    how much a thread changes it; the offset in the bounds of the number of all threads, and of how
    many the first dimension has each; by how many strips it follows the first launch.
    """
    run_strips(table, strips)
