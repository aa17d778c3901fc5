"""A sequence of launches on a CPU, strip by strip of a mesh."""

import warp as wp

from swe_sphere.kernels.define import Register, kernel, source

Table = wp.array2d(dtype=wp.uint64)


@Register.func_native(source("run_strips"))
def run_strips(table: Table, strips: int, first: int, last: int): ...


@kernel
def sweep_strips(table: Table, strips: int, first: int, last: int):
    """Run a sequence of launches in one thread, strip by strip from the last strip to the first.

    Each row of the table is a launch: the addresses of its function, its bounds, its arguments and
    the first thread of each strip (strips + 1,); the first argument of its first thread, and the
    increment of that argument per thread; the offset in the bounds of the thread count, and the
    threads per index of the first dimension; the number of strips by which it lags the first one.
    The strips `first` down to `last` of the first launch are run, and those that lag behind them.
    """
    run_strips(table, strips, first, last)
