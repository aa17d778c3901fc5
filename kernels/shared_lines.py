"""What the threads of an element tell one another: the numbers that they all take line sums of.

Each of them is loaded and worked out once.  On a GPU a block has whole elements (`block_threads`),
and its threads meet in shared memory, where numbers of one kind follow one another, so that they
stand in different banks.  On a CPU the threads of an element run one after the other: the first
does it for all of them.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

MOST_THREADS = 256


def block_threads(nodes: int) -> int:
    """Threads of a block that has whole elements, of so many nodes each."""
    return max(1, MOST_THREADS // nodes) * nodes


def shared_lines(rows: type, real: type, np_: int, name: str) -> SimpleNamespace:
    """Warp functions by which the threads (..., element, node) share two `rows` a node.

    There is one room of a name in a kernel, and a thread enters it once: on a CPU the next thread
    comes when this one has ended.  All threads of a block have to call them, in this order: `room`
    = `enter`(node); `put`(room, p, first, second) for each p = node + turn, turn < `turns`(node);
    `meet`().  Then `along` and `across` (room, d, i, j) are sums over m of d[i, m] first[m, j] and
    of d[j, m] second[i, m], and `along_transposed` and `across_transposed` those with d[m, i] and
    d[m, j].
    """
    number, count = _numbers(rows, real)
    held = f"{number} {name}[{2 * count * MOST_THREADS}];"

    @wp.func_native(f"""
    #ifdef __CUDA_ARCH__
        __shared__ {held}
        __syncthreads();  // all have read what was here
        return wp::uint64({name} + threadIdx.x - node);
    #else
        static {held}
        return wp::uint64({name});
    #endif
    """)
    def enter(node: int) -> wp.uint64: ...

    @wp.func_native(f"""
    #ifdef __CUDA_ARCH__
        return 1;
    #else
        return node == 0 ? {np_ * np_} : 0;
    #endif
    """)
    def turns(node: int) -> int: ...

    @wp.func_native(f"""
        const auto to = reinterpret_cast<{number}*>(room) + p;
        #pragma unroll
        for (int k = 0; k < {count}; ++k) {{
            to[k * {MOST_THREADS}] = reinterpret_cast<const {number}*>(&first)[k];
            to[({count} + k) * {MOST_THREADS}] = reinterpret_cast<const {number}*>(&second)[k];
        }}
    """)
    def put(room: wp.uint64, p: int, first: rows, second: rows): ...

    @wp.func_native("""
    #ifdef __CUDA_ARCH__
        __syncthreads();
    #endif
    """)
    def meet(): ...

    return SimpleNamespace(
        enter=enter,
        turns=turns,
        put=put,
        meet=meet,
        along=_sum(rows, real, np_, 0, f"i * {np_} + m", f"m * {np_} + j"),
        across=_sum(rows, real, np_, count, f"j * {np_} + m", f"i * {np_} + m"),
        along_transposed=_sum(rows, real, np_, 0, f"m * {np_} + i", f"m * {np_} + j"),
        across_transposed=_sum(rows, real, np_, count, f"m * {np_} + j", f"i * {np_} + m"),
    )


def _sum(rows: type, real: type, np_: int, row: int, factor: str, node: str) -> Any:
    """Warp function (room, d, i, j): the sum over m of d at `factor` times the `rows` at `node`.

    They begin in that row of the room.  A statement has one operation, so that a CPU contracts
    none.
    """
    number, count = _numbers(rows, real)

    @wp.func_native(f"""
        const auto from = reinterpret_cast<const {number}*>(room) + {row * MOST_THREADS};
        {number} sums[{count}] = {{}};
        #pragma unroll
        for (int m = 0; m < {np_}; ++m) {{
            const auto a = d.data[{factor}];
            #pragma unroll
            for (int k = 0; k < {count}; ++k) {{
                const auto product = a * from[k * {MOST_THREADS} + {node}];
                sums[k] += product;
            }}
        }}
        {number if count == 1 else f"wp::vec_t<{count}, {number}>"} r;
        #pragma unroll
        for (int k = 0; k < {count}; ++k) reinterpret_cast<{number}*>(&r)[k] = sums[k];
        return r;
    """)
    def shared_sum(room: wp.uint64, d: wp.array2d(dtype=real), i: int, j: int) -> rows: ...

    return shared_sum


def _numbers(rows: type, real: type) -> tuple[str, int]:
    """What the rows of a node are made of, in C++, and how many there are."""
    size = wp.types.type_size_in_bytes
    return f"wp::{real.__name__}", size(rows) // size(real)
