"""Line sums of numbers that all threads of an element share.

Each number is loaded and computed once. On a GPU a block contains whole elements (`block_threads`),
and its threads synchronise in shared memory, where numbers of one kind follow one another and so
lie in different banks. On a CPU the threads of an element run one after the other, and the first
thread computes the numbers of all.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import Register, real, source

MOST_THREADS = 256


def block_threads(nodes: int) -> int:
    """Return the number of threads of a block of whole elements with `nodes` nodes each."""
    return max(1, MOST_THREADS // nodes) * nodes


def shared_lines(kind: Any, np_: int, name: str, transposed: bool) -> tuple[Any, ...]:
    """Return functions by which threads (..., element, node) share two values of `kind` per node.

    kind: a type of rows. A kernel has one memory block per name, and a thread enters it once: on
    a CPU the next thread enters when this one has ended. All threads of a block must call the
    functions in this order: `room` = `enter`(node); `put`(room, p, first, second) for each p = node
    + turn, turn < `turns`(node); `meet`(); then the line sums `along` of the first values and
    `across` of the second ones, (room, d, i, j).
    """
    count = len(kind.find(Register(wp.float64))())
    sizes = {"count": count, "apart": MOST_THREADS}

    @Register.func_native(source("shared_enter", block=name, size=2 * count * MOST_THREADS))
    def enter(node: int) -> wp.uint64: ...

    @Register.func_native(source("shared_turns", points=np_ * np_))
    def turns(node: int) -> int: ...

    @Register.func_native(source("shared_put", **sizes))
    def put(room: wp.uint64, p: int, first: kind, second: kind): ...

    @Register.func_native(source("shared_meet"))
    def meet(): ...

    def line_sum(row: int, factor: str, node: str) -> Any:
        """Return the sum over m of d at `factor` times the numbers at `node`, starting at a row."""
        given = sizes | {"np": np_, "begin": row * MOST_THREADS, "factor": factor, "node": node}

        @Register.func_native(source("shared_sum", **given))
        def shared_sum(room: wp.uint64, d: wp.array2d(dtype=real), i: int, j: int) -> kind: ...

        return shared_sum

    factors = [f"m * {np_} + {k}" if transposed else f"{k} * {np_} + m" for k in "ij"]
    along = line_sum(0, factors[0], f"m * {np_} + j")
    return enter, turns, put, meet, along, line_sum(count, factors[1], f"i * {np_} + m")
