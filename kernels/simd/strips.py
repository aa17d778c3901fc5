"""A sequence of launches on a CPU, strip by strip of a mesh."""

import warp as wp

from swe_sphere.kernels.define import Register, kernel, source

Table = wp.array2d(dtype=wp.uint64)


@Register.func_native(source("run_strips"))
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
