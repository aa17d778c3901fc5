"""Loads and stores in C++, where Warp's own would check and compute more than is needed.

An index of Warp's may be negative, and an array may be strided; both cost instructions in a gather.
A register of `lanes` elements is loaded at once where their nodes follow one another in memory:
such a node vector has the complement of its first number in the first place, which is negative.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.registers import run_type


@functools.cache
def entry_of(real: type) -> Any:
    """Warp function (x, i): x[i] of a contiguous array, i not negative."""

    @wp.func_native("return x.data[i];")
    def entry(x: wp.array(dtype=real), i: int) -> real: ...

    return entry


@functools.cache
def run_of(value: type, real: type, lanes: int) -> Any:
    """Warp function (x, i): the run of `lanes` numbers from x[i] on, likewise."""
    if lanes == 1:
        return entry_of(real)
    kind, register = run_type(real, lanes)

    @wp.func_native(f"""
        {register}
        const run r = *reinterpret_cast<const run*>(x.data + i);
        wp::vec_t<{lanes}, {kind}> v;
        __builtin_memcpy(&v, &r, sizeof v);
        return v;
    """)
    def load(x: wp.array(dtype=real), i: int) -> value: ...

    return load


@functools.cache
def put_of(real: type, value: type | None = None, lanes: int = 1) -> Any:
    """Warp function (x, i, v): x[i] = v, or a run of `lanes` numbers from there on, likewise."""
    body = "x.data[i] = v;" if lanes == 1 else "__builtin_memcpy(x.data + i, &v, sizeof v);"

    @wp.func_native(body)
    def put(x: wp.array(dtype=real), i: int, v: value or real): ...

    return put


@functools.cache
def bring_of(real: type, back: bool, one: bool) -> Any:
    """Warp function (i, x, places (n,), packed (n,)): packed = x[places], or `back`, the reverse.

    Of `one` number i, or of all.
    """
    to, of = "packed.data[i]", "x.data[places.data[i]]"
    bring_it = f"{of} = {to};" if back else f"{to} = {of};"

    @wp.func_native(bring_it if one else f"for (; i < places.shape[0]; ++i) {bring_it}")
    def bring(
        i: int, x: wp.array(dtype=real), places: wp.array(dtype=wp.int32),
        packed: wp.array(dtype=real),
    ): ...  # fmt: skip

    return bring


@functools.cache
def address_of(value: type) -> Any:
    """Warp function (x, i): the address of the i-th entry of a contiguous array (k, m, n)."""

    @wp.func_native("return wp::uint64(x.data + i);")
    def address(x: wp.array3d(dtype=value), i: int) -> wp.uint64: ...

    return address


@functools.cache
def lanes_access(value: type, index: type, real: type, lanes: int) -> tuple[Any, Any]:
    """Warp functions (x, offset, node): load, and load of a run of nodes.

    The branch chooses between registers and not, as Warp's would, between `lanes` numbers each.
    """
    kind, register = run_type(real, lanes)
    begin = "x.data + (offset + ~node.c[0])"
    each = ", ".join(f"at[node.c[{lane}]]" for lane in range(lanes))
    answer = f"wp::vec_t<{lanes}, {kind}> v; __builtin_memcpy(&v, &r, sizeof v); return v;"
    vector = wp.array(dtype=real)

    @wp.func_native(f"""
        {register}
        const auto at = x.data + offset;
        const run r = node.c[0] < 0 ? *reinterpret_cast<const run*>({begin}) : run{{{each}}};
        {answer}
    """)
    def load(x: vector, offset: int, node: index) -> value: ...

    @wp.func_native(f"{register} const run r = *reinterpret_cast<const run*>({begin}); {answer}")
    def load_run(x: vector, offset: int, node: index) -> value: ...

    return load, load_run


@functools.cache
def step_run(value: type, real: type, lanes: int, shifted: bool) -> Any:
    """Warp function (now, past, at, rate, tau, weights, base, out, mixed): a run's own step.

    out = now + tau rate and mixed = the weights' sum of (out, now, past), of which any may be one
    array; less `base`, where it is `shifted`.  A statement has one operation, so that none are
    contracted.
    """
    _, register = run_type(real, lanes)
    vector, triple = wp.array(dtype=real), wp.types.vector(3, real)
    took = "change = rate;" if lanes == 1 else "__builtin_memcpy(&change, &rate, sizeof rate);"
    shift = "sum -= *reinterpret_cast<const run*>(base.data + at);" if shifted else ""

    @wp.func_native(f"""
        {register}
        run change, sum, more;
        {took}
        const run first = *reinterpret_cast<const run*>(now.data + at);
        const run second = *reinterpret_cast<const run*>(past.data + at);
        change *= tau;
        change += first;
        sum = change * weights.c[0];
        more = first * weights.c[1];
        sum += more;
        more = second * weights.c[2];
        sum += more;
        {shift}
        *reinterpret_cast<run*>(out.data + at) = change;
        *reinterpret_cast<run*>(mixed.data + at) = sum;
    """)
    def step(
        now: vector, past: vector, at: int, rate: value, tau: real, weights: triple, base: vector,
        out: vector, mixed: vector,
    ): ...  # fmt: skip

    return step


@functools.cache
def gather_run(value: type, place: type, real: type, lanes: int) -> Any:
    """Warp function (local, places, first, offset): the sum of DSS at a run of nodes from `first`.

    place: what the array `places` holds for a node.
    """
    kind, register = run_type(real, lanes)
    each = ", ".join(f"sum({lane})" for lane in range(lanes))
    answer = f"wp::vec_t<{lanes}, {kind}> v; __builtin_memcpy(&v, &r, sizeof v); return v;"

    vector, array = wp.array(dtype=real), wp.array(dtype=place)

    @wp.func_native(f"""
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
        {register}
        const run r = {{{each}}};
        {answer if lanes > 1 else "return r;"}
    """)
    def gather(local: vector, places: array, first: int, offset: int) -> value: ...

    return gather


@functools.cache
def converting_load(value: type, index: type, given: type, real: type, lanes: int) -> Any:
    """Warp function (x, offset, node): load from a vector of `given` into registers of `real`."""
    kind, vector = f"wp::{real.__name__}", wp.array(dtype=given)
    body = f"return {kind}(x.data[offset + node]);"
    if lanes > 1:
        body = f"""
            const auto at = x.data + offset;
            const auto first = ~node.c[0];
            wp::vec_t<{lanes}, {kind}> v;
            for (int i = 0; i < {lanes}; ++i)
                v.c[i] = {kind}(first >= 0 ? at[first + i] : at[node.c[i]]);
            return v;
        """

    @wp.func_native(body)
    def load(x: vector, offset: int, node: index) -> value: ...

    return load


def scratch(np_: int, *kinds: type) -> list[wp.uint64]:
    """Offsets [bytes] in a group's room for work arrays (np, np) of these types.

    An array of a kernel's own would be set to zero and lie across cache lines.
    """
    sizes = [np_ * np_ * wp.types.type_size_in_bytes(kind) for kind in kinds]
    offsets = [sum(sizes[:i]) for i in range(len(sizes) + 1)]
    assert offsets[-1] <= room(np_)
    return [wp.uint64(offset) for offset in offsets]


def room(np_: int) -> int:
    """Bytes of that room: what 16 registers a node take up."""
    return 16 * 64 * np_ * np_
