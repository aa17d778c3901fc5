"""Loads and stores in C++, where Warp's own check and compute more than is needed.

An index of Warp may be negative and an array may be strided; both cost instructions in a gather.
A register of `lanes` elements is loaded at once where their nodes follow one another in memory:
such a node vector has the complement of its first number in the first place, which is negative.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel
from swe_sphere.kernels.simd.register import Register

CONTRIBUTORS = 4
Contributors = wp.types.vector(CONTRIBUTORS, wp.int32)
"""Places of a node's first field in the local tendencies, -1 for a contributor that it lacks."""


@functools.cache
def entry_of(kind: Any) -> Any:
    """Return the Warp function (x, i): x[i] of a contiguous array, i not negative."""

    @wp.func_native("return x.data[i];")
    def entry(x: wp.array(dtype=kind), i: int) -> kind: ...

    return entry


@functools.cache
def run_of(register: Register) -> Any:
    """Return the Warp function (x, i): the register that begins at x[i]."""
    if register.lanes == 1:
        return entry_of(register.real)

    @register.func_native("return as_value(*runs(x.data + i));")
    def load(x: wp.array(dtype=register.real), i: int) -> register.value: ...

    return load


@functools.cache
def put_of(register: Register) -> Any:
    """Return the Warp function (x, i, v): x[i] = v, or a register from there on."""

    @register.func_native("*reinterpret_cast<value*>(x.data + i) = v;")
    def put(x: wp.array(dtype=register.real), i: int, v: register.value): ...

    return put


@functools.cache
def packing_kernel(real: Any, back: bool, in_threads: bool) -> wp.Kernel:
    """Kernel (x, places (n,), packed (n,)): packed = x[places], or the reverse if `back`.

    Of n threads, for a GPU, or of one, for a CPU: there a thread for each number takes longer than
    to bring it.
    """
    vector, numbers = wp.array(dtype=real), wp.array(dtype=wp.int32)
    to, of = "packed.data[i]", "x.data[places.data[i]]"
    bring_it = f"{of} = {to};" if back else f"{to} = {of};"

    @wp.func_native(bring_it if in_threads else f"for (; i < places.shape[0]; ++i) {bring_it}")
    def bring(i: int, x: vector, places: numbers, packed: vector): ...

    @kernel
    def pack(x: vector, places: numbers, packed: vector):
        bring(wp.tid(), x, places, packed)

    return pack


@functools.cache
def address_of(value: Any) -> Any:
    """Return the Warp function (x, i): address of the i-th entry of a contiguous 3-d array."""

    @wp.func_native("return wp::uint64(x.data + i);")
    def address(x: wp.array3d(dtype=value), i: int) -> wp.uint64: ...

    return address


@functools.cache
def load_of(register: Register, given: Any = None) -> Any:
    """Return the Warp function (x, offset, node): the numbers of x at a register of nodes.

    The branch chooses between registers and not, as Warp's would, between `lanes` numbers each.
    given: the number type of x, where it is not that of the register.
    """
    lanes = register.lanes
    code = f"""
        const auto at = x.data + offset;
        const run r = node.c[0] < 0 ? *runs(x.data + (offset + ~node.c[0]))
            : run{{{", ".join(f"at[node.c[{lane}]]" for lane in range(lanes))}}};
        return as_value(r);
    """
    if given not in (None, register.real):
        code = f"""
            const auto at = x.data + offset;
            const auto first = ~node.c[0];
            value v;
            for (int i = 0; i < {lanes}; ++i)
                v.c[i] = number(first >= 0 ? at[first + i] : at[node.c[i]]);
            return v;
        """

    @register.func_native(code if lanes > 1 else "return number(x.data[offset + node]);")
    def load(
        x: wp.array(dtype=given or register.real), offset: int, node: register.index
    ) -> register.value: ...

    return load


@functools.cache
def gather_of(register: Register) -> Any:
    """Return the Warp function (local, places, first, offset): DSS of the nodes from `first` on.

    places: the `Contributors` of each node.
    """
    each = ", ".join(f"sum({lane})" for lane in range(register.lanes))

    @register.func_native(f"""
        const auto sum = [&](int lane) {{
            const auto at = places.data[first + lane];
            auto total = local.data[at.c[0] + offset];
            if (at.c[1] >= 0) {{
                total += local.data[at.c[1] + offset];
                if (at.c[2] >= 0)
                    total += local.data[at.c[2] + offset] + local.data[at.c[3] + offset];
            }}
            return total;
        }};
        return as_value(run{{{each}}});
    """)
    def gather(
        local: wp.array(dtype=register.real), places: wp.array(dtype=Contributors), first: int,
        offset: int,
    ) -> register.value: ...  # fmt: skip

    return gather
