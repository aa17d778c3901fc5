"""Bounds on the mixing ratios of tracers that keep their masses: clip and assured sum.

A mass hq outside [lower h, upper h] is clipped; the excess, which is the mass that clipping adds or
removes, is distributed to all nodes in proportion to their room, the distance from the bound, so
that no node leaves its bounds again. The limiter works first within each element, whose nodes are
close together; an element whose mean is out of bounds is set to its mean. Then it works over the
whole sphere, on the excess of such elements (Bradley, Bosler, Guba, Taylor & Barnett 2019,
doi:10.1137/18M1165414, section 2.2). Sums are added in a fixed order, so that a run repeats bit by
bit; a tracer within its bounds keeps all its bits.
"""

import warp as wp

from swe_sphere.kernels.define import func, kernel, lanes, real, value, vector
from swe_sphere.kernels.metric import jacobian
from swe_sphere.kernels.simd.arithmetic import clip, div, mul, rooms
from swe_sphere.kernels.simd.memory import load, load_nodes, put
from swe_sphere.kernels.terms import geometry, local, np_

TINY = 1e-30
"""Least divisor in shares of room: far below any room, and representable in float32."""


@func
def node_area(geo: geometry, e: int, n: int):
    return geo.weight[n // np_, n % np_] * jacobian(geo.basis, e, n)


@func
def share_of(wanted: value, room: value):
    some = div(wp.max(wanted, value(real(0.0))), wp.max(room, value(real(TINY))))
    return wp.min(some, value(real(1.0)))


@func
def bounded(
    geo: geometry, x: vector, depth: int, at: int, lower: real, upper: real, e: int, n: int
):
    """Return the depth, the mass, its bounds and the clipped mass."""
    node = geo.nodes[e, n]
    h = load_nodes(x, depth, node)
    m = load_nodes(x, at, node)
    low = lower * h
    high = upper * h
    return h, m, low, high, clip(m, low, high)


@kernel
def limit_elements(
    begin: int, geo: geometry, x: vector, depth: int, first: int, count: int, lower: vector,
    upper: vector, out: local,
):  # fmt: skip
    """Limit within each element, over groups from `begin` on; the bounds have shape (count,).

    `depth` and `first` are the offsets of the depth and of the first tracer in the state x. `out`
    (groups, np*np, count) receives the mass-weighted change of each element node before DSS.
    """
    e = begin + wp.tid()
    for k in range(count):
        at = first + k * geo.size
        excess = value(real(0.0))
        above = value(real(0.0))
        below = value(real(0.0))
        volume = value(real(0.0))
        for n in range(np_ * np_):
            h, m, low, high, clipped = bounded(geo, x, depth, at, lower[k], upper[k], e, n)
            weight = node_area(geo, e, n)
            excess += mul(weight, m - clipped)
            above += mul(weight, high - clipped)
            below += mul(weight, clipped - low)
            volume += mul(weight, h)
        up = share_of(excess, above)
        down = share_of(-excess, below)
        left = div(excess - mul(up, above) + mul(down, below), volume)
        for n in range(np_ * np_):
            h, m, low, high, clipped = bounded(geo, x, depth, at, lower[k], upper[k], e, n)
            change = clipped - m + mul(up, high - clipped) - mul(down, clipped - low)
            change += mul(left, h)
            out[e, n, k] = mul(node_area(geo, e, n), change)


@kernel
def sum_rooms(
    area: wp.array(dtype=wp.float64), x: vector, depth: int, first: int, size: int,
    spans: wp.array3d(dtype=wp.int32), lower: vector, upper: vector,
    partial: wp.array2d(dtype=wp.vec3d),
):  # fmt: skip
    """Sum the excess and the room above and below (three numbers), over (count, blocks).

    Block b contains the nodes from spans[kind, b, 0] to spans[kind, b, 1] for all kinds.
    """
    k, block = wp.tid()
    total = wp.vec3d()
    for kind in range(spans.shape[0]):
        total += rooms(
            area, x, depth, first + k * size, spans[kind, block, 0], spans[kind, block, 1],
            lower[k], upper[k],
        )  # fmt: skip
    partial[block, k] = total


@kernel
def room_parts(partial: wp.array2d(dtype=wp.vec3d), blocks: int, part: wp.array(dtype=wp.vec2d)):
    """Store for each tracer the fractions `part` of its room above and below to fill (two)."""
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


@kernel
def limit_sphere(
    begin: int, depth: int, first: int, size: int, count: int, lower: vector, upper: vector,
    part: wp.array(dtype=wp.vec2d), x: vector,
):  # fmt: skip
    """Clip the masses and fill the fractions `part` of their room, at nodes from `begin` on."""
    node = begin + lanes * wp.tid()
    h = load(x, depth + node)
    for k in range(count):
        at = first + k * size + node
        low = lower[k] * h
        high = upper[k] * h
        clipped = clip(load(x, at), low, high)
        up = real(part[k][0]) * (high - clipped)
        put(x, at, clipped + up - real(part[k][1]) * (clipped - low))
