"""Numbers of which all threads of an element take line sums, shared by these threads.

Each number is loaded and computed once.  On a GPU a block has whole elements (`block_threads`), and
its threads meet in shared memory, where numbers of one kind follow one another, so that they are in
different banks.  On a CPU the threads of an element run one after the other, and the first one
computes the numbers of all.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from swe_sphere.kernels.simd.register import Register

MOST_THREADS = 256


def block_threads(nodes: int) -> int:
    """Return the number of threads of a block of whole elements with so many nodes each."""
    return max(1, MOST_THREADS // nodes) * nodes


def shared_lines(rows: Any, real: Any, np_: int, name: str) -> SimpleNamespace:
    """Return Warp functions by which the threads (..., element, node) share two rows a node.

    rows: their type, of numbers `real`.  There is one room of a name in a kernel, and a thread
    enters it once: on a CPU the next thread comes when this one has ended.  All threads of a block
    have to call them, in this order: `room` = `enter`(node); `put`(room, p, first, second) for each
    p = node + turn, turn < `turns`(node); `meet`(); then any of the line sums (room, d, i, j).
    """
    size, register = wp.types.type_size_in_bytes, Register(real)
    count = size(rows) // size(real)
    held = f"number {name}[{2 * count * MOST_THREADS}];"

    @register.func_native(f"""
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

    @register.func_native(f"""
        const auto to = reinterpret_cast<number*>(room) + p;
        #pragma unroll
        for (int k = 0; k < {count}; ++k) {{
            to[k * {MOST_THREADS}] = first.c[k];
            to[({count} + k) * {MOST_THREADS}] = second.c[k];
        }}
    """)
    def put(room: wp.uint64, p: int, first: rows, second: rows): ...

    @wp.func_native("""
    #ifdef __CUDA_ARCH__
        __syncthreads();
    #endif
    """)
    def meet(): ...

    def line_sum(row: int, factor: str, node: str) -> Any:
        """Return the sum over m of d at `factor` times the numbers at `node`, from a row on."""

        @register.func_native(f"""
            const auto from = reinterpret_cast<const number*>(room) + {row * MOST_THREADS};
            number sums[{count}] = {{}};
            #pragma unroll
            for (int m = 0; m < {np_}; ++m) {{
                const auto a = d.data[{factor}];
                #pragma unroll
                for (int k = 0; k < {count}; ++k) {{
                    const auto product = a * from[k * {MOST_THREADS} + {node}];
                    sums[k] += product;
                }}
            }}
            wp::vec_t<{count}, number> r;
            #pragma unroll
            for (int k = 0; k < {count}; ++k) r.c[k] = sums[k];
            return r;
        """)
        def shared_sum(room: wp.uint64, d: wp.array2d(dtype=real), i: int, j: int) -> rows: ...

        return shared_sum

    return SimpleNamespace(
        enter=enter,
        turns=turns,
        put=put,
        meet=meet,
        along=line_sum(0, f"i * {np_} + m", f"m * {np_} + j"),
        across=line_sum(count, f"j * {np_} + m", f"i * {np_} + m"),
        along_transposed=line_sum(0, f"m * {np_} + i", f"m * {np_} + j"),
        across_transposed=line_sum(count, f"m * {np_} + j", f"i * {np_} + m"),
    )
