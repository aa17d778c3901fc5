"""Bounds on the mixing ratios of tracers that keep their masses: clip and assured sum.

A mass hq outside [lower h, upper h] is clipped; what that adds or takes is given back to the other
nodes, to each in proportion to the room it has to its bound, so that none leaves it again.  First
within each element, where the nodes are close; an element whose mean is out of bounds is only made
even.  Then over the whole sphere, for what such elements leave (Bradley, Bosler, Guba, Taylor &
Barnett 2019, doi:10.1137/18M1165414, section 2.2).  Sums are added in a fixed order, so that a run
repeats bit by bit; a tracer within its bounds is left as it is, to the last bit.
"""

import functools
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from swe_sphere.kernels.access import put_of, run_of
from swe_sphere.kernels.assembly import OPTIONS
from swe_sphere.kernels.registers import clip_of, run_type
from swe_sphere.kernels.stages import node_types
from swe_sphere.kernels.terms import kernel_types

TINY = 1e-30
"""Room below which nothing is put: far below any depth, and a number in float32 too."""


@functools.cache
def element_limiter(np_: int, real: type, shape: str) -> SimpleNamespace:
    """Kernel `limit` over groups of elements, with the structure `geometry` it reads.

    (geometry, x, depth, first, count, lower (count,), upper (count,), out (groups, np*np, count)):
    the mass-weighted change of each element node, before DSS.  `depth` and `first` are the offsets
    of the depth and of the first tracer in the state x.
    """
    t = kernel_types(np_, real, shape)
    value, geometry, vector, local = t.value, t.geometry, t.vector, t.local
    mul, load, wedge = t.ops.mul, t.ops.load, t.ops.wedge
    div = wp.cw_div if t.lanes > 1 else wp.div
    clip = clip_of(value, real, t.lanes)

    @no_type_check
    @wp.func
    def mass(geo: geometry, e: int, n: int):
        w = geo.weight[n // np_, n % np_]
        area = wedge(geo.basis[e, n, 0], geo.basis[e, n, 1], geo.basis[e, n, 2], geo.basis[e, n, 3])
        return w * area

    @no_type_check
    @wp.func
    def part(wanted: value, room: value):
        some = div(wp.max(wanted, value(real(0.0))), wp.max(room, value(real(TINY))))
        return wp.min(some, value(real(1.0)))

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def limit(
        geo: geometry,
        x: vector,
        depth: int,
        first: int,
        count: int,
        lower: vector,
        upper: vector,
        out: local,
    ):
        e = wp.tid()
        for k in range(count):
            at = first + k * geo.size
            excess = value(real(0.0))
            above = value(real(0.0))
            below = value(real(0.0))
            air = value(real(0.0))
            for n in range(np_ * np_):
                node = geo.nodes[e, n]
                h = load(x, depth, node)
                m = load(x, at, node)
                low = lower[k] * h
                high = upper[k] * h
                clipped = clip(m, low, high)
                weight = mass(geo, e, n)
                excess += mul(weight, m - clipped)
                above += mul(weight, high - clipped)
                below += mul(weight, clipped - low)
                air += mul(weight, h)
            up = part(excess, above)
            down = part(-excess, below)
            left = div(excess - mul(up, above) + mul(down, below), air)
            for n in range(np_ * np_):
                node = geo.nodes[e, n]
                h = load(x, depth, node)
                m = load(x, at, node)
                low = lower[k] * h
                high = upper[k] * h
                clipped = clip(m, low, high)
                change = clipped - m + mul(up, high - clipped) - mul(down, clipped - low)
                change += mul(left, h)
                out[e, n, k] = mul(mass(geo, e, n), change)

    return SimpleNamespace(limit=limit, geometry=geometry, value=value)


@functools.cache
def sphere_limiter(real: type, lanes: int) -> SimpleNamespace:
    """Kernels for the whole sphere, in the order in which they run, on a CPU with whole registers.

    sums over (count, blocks): (area (N,), x, depth, first, N, spans (kinds, blocks, 2), lower,
    upper, partial (blocks, count) of three numbers): excess and room above and below of the nodes
    from spans[k, block, 0] to spans[k, block, 1], all k.
    parts over (count,): (partial, blocks, part (count,) of two numbers).
    limit_of(lanes) over runs of so many nodes: (begin, depth, first, N, count, lower, upper, part,
    x), from the node `begin` on.
    """
    vector, rooms = wp.array(dtype=real), _rooms(real, lanes)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def sums(
        area: wp.array(dtype=wp.float64),
        x: vector,
        depth: int,
        first: int,
        size: int,
        spans: wp.array3d(dtype=wp.int32),
        lower: vector,
        upper: vector,
        partial: wp.array2d(dtype=wp.vec3d),
    ):
        k, block = wp.tid()
        total = wp.vec3d()
        for kind in range(spans.shape[0]):
            total += rooms(
                area, x, depth, first + k * size, spans[kind, block, 0], spans[kind, block, 1],
                lower[k], upper[k],
            )  # fmt: skip
        partial[block, k] = total

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def parts(partial: wp.array2d(dtype=wp.vec3d), blocks: int, part: wp.array(dtype=wp.vec2d)):
        k = wp.tid()
        total = wp.vec3d()
        for block in range(blocks):
            total += partial[block, k]
        none = wp.float64(0.0)
        one = wp.float64(1.0)
        least = wp.float64(TINY)
        up = wp.max(total[0], none) / wp.max(total[1], least)
        down = wp.max(-total[0], none) / wp.max(total[2], least)
        part[k] = wp.vec2d(wp.min(up, one), wp.min(down, one))

    return SimpleNamespace(sums=sums, parts=parts, limit_of=functools.partial(_limit, real))


def _rooms(real: type, lanes: int) -> Any:
    """Warp function (area, x, depth, first, begin, end, low, high): sums over those nodes.

    Of what is out of bounds, and of the room above and below; a number is added to the sum of its
    place after the beginning, wherever in memory that is.
    """
    _, register = run_type(real, lanes)
    _, doubles = run_type(wp.float64, lanes)
    wide = doubles.replace(" run ", " wide ")
    as_wide = "__builtin_convertvector(r, wide)" if lanes > 1 else "wide(r)"
    vector, triple = wp.array(dtype=real), wp.types.vector(3, wp.float64)

    @wp.func_native(f"""
        {register}
        {wide}
        wide sums[3] = {{}};
        const auto add = [&](auto mass, auto air, auto space, auto to) {{
            const auto least = low * air, most = high * air;
            auto clipped = mass > least ? mass : least;
            clipped = clipped < most ? clipped : most;
            const auto over = mass - clipped, above = most - clipped, below = clipped - least;
            to(0, over, space); to(1, above, space); to(2, below, space);
        }};
        int i = begin;
        for (; i + {lanes} <= end; i += {lanes})
            add(*(const run*)(x.data + first + i), *(const run*)(x.data + depth + i),
                *(const wide*)(area.data + i),
                [&](int s, run r, wide a) {{ sums[s] += a * {as_wide}; }});
        double left[3] = {{}};
        for (; i < end; ++i)
            add(x.data[first + i], x.data[depth + i], area.data[i],
                [&](int s, auto r, double a) {{ left[s] += a * double(r); }});
        wp::vec3d total;
        for (int s = 0; s < 3; ++s) {{
            total[s] = left[s];
            for (int lane = 0; lane < {lanes}; ++lane)
                total[s] += reinterpret_cast<const double*>(&sums[s])[lane];
        }}
        return total;
    """)
    def rooms(
        area: wp.array(dtype=wp.float64), x: vector, depth: int, first: int, begin: int, end: int,
        low: real, high: real,
    ) -> triple: ...  # fmt: skip

    return rooms


@functools.cache
def _limit(real: type, lanes: int) -> wp.Kernel:
    value, _ = node_types(real, lanes)
    vector, load, put = wp.array(dtype=real), run_of(value, real, lanes), put_of(real, value, lanes)
    clip = clip_of(value, real, lanes)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def limit(
        begin: int,
        depth: int,
        first: int,
        size: int,
        count: int,
        lower: vector,
        upper: vector,
        part: wp.array(dtype=wp.vec2d),
        x: vector,
    ):
        node = begin + lanes * wp.tid()
        h = load(x, depth + node)
        for k in range(count):
            at = first + k * size + node
            low = lower[k] * h
            high = upper[k] * h
            clipped = clip(load(x, at), low, high)
            up = real(part[k][0]) * (high - clipped)
            put(x, at, clipped + up - real(part[k][1]) * (clipped - low))

    return limit
