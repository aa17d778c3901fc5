"""Continuity and momentum equations stepped in turn, by the kernels that compute their rates.

A field is stepped at a node once its rate is known. The kernels also store combinations of the time
levels that the elements differentiate next, which saves a pass over the levels. Nodes inside
elements need no DSS: on a CPU the kernels over elements step these nodes themselves. The other
nodes are stepped with DSS, singly or, on a CPU, in runs that fill a register.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import Placeholder, func, kernel, lanes, struct_of, vector
from swe_sphere.kernels.dynamics import transport
from swe_sphere.kernels.element import Finish
from swe_sphere.kernels.formulas import pair, row, single, two_rows
from swe_sphere.kernels.local import field_kernel, tendency_kernels
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import Places, gather, load, put
from swe_sphere.kernels.simd.stages import levels, step_of, triple
from swe_sphere.kernels.terms import KernelTypes, geometry


def _finish_mass(
    unknowns: int, geometry: Any, point: Any, damped: bool, shifted: bool = False
) -> Finish:
    """Return the function that steps the k-th mass; the depth is the first one.

    geometry: a Warp structure with at least N (`size`), `inverse_area` (N,) and `point`; point: its
    `PointwiseSum`; damped: rates include the `loss` of `levels_struct`; shifted: its `base` is
    subtracted from the stored combinations.
    """
    first, of_depth, step = unknowns - 1, point.depth, step_of(shifted)

    @func
    def finish(geo: geometry, x: vector, r: single, k: int, node: int, s: levels):
        rate = mul(load(geo.inverse_area, node), r[0])
        at = (first + k) * geo.size + node
        if k == 0:
            rate += of_depth(geo.point, node, geo.size, s.wind_mix, s.mass_mix)[0]
        if wp.static(damped):
            rate += load(s.loss, at)
        if wp.static(first > 0) and k == 0:  # before `out`, which may overwrite a level
            step(s.now, s.past, at, rate, s.tau, s.depth_weights, s.base, s.wind_mix, s.wind_mix)
        step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.out, s.mass_mix)

    return finish


def _finish_wind(geometry: Any, point: Any, damped: bool, shifted: bool = False) -> Finish:
    """Return the function that steps both winds; the arguments are those of `_finish_mass`.

    If `shifted`, `mass_mix` then holds the combinations of the winds too.
    """
    of_wind, step = point.wind, step_of(shifted)

    @func
    def finish(geo: geometry, x: vector, r: pair, k: int, node: int, s: levels):
        scale = load(geo.inverse_area, node)
        more = of_wind(geo.point, node, geo.size, s.wind_mix, s.wind_mix)
        for i in range(2):
            at = i * geo.size + node
            rate = mul(scale, r[i]) + more[i]
            if wp.static(damped):
                rate += load(s.loss, at)
            if wp.static(shifted):
                step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.mass_mix, s.mass_mix)
            step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.out, s.wind_mix)

    return finish


@functools.cache
def carrying_kernel(t: KernelTypes, damped: bool, alone: bool) -> Any:
    """Return the kernel (begin, geometry, a, x, first, count, out, levels) of `transport(alone)`.

    The kernel steps the masses at nodes inside the elements of the first `block_groups` groups.
    """
    finish = _finish_mass(t.terms.unknowns, geometry, t.point, damped)
    return field_kernel(t, transport(alone=alone), finish)


@functools.cache
def pushing_kernel(t: KernelTypes, damped: bool) -> Any:
    """Return the kernel (begin, geometry, x, out, levels) of momentum, which steps the winds."""
    (made,) = tendency_kernels(t, lambda *_: _finish_wind(geometry, t.point, damped))
    return made


@functools.cache
def run_kernels(unknowns: int, point: Pointwise, damped: bool) -> tuple[Any, Any, Any]:
    """Return two kernels that assemble and step runs of nodes, and a `Placeholder`, their geometry.

    The first kernel steps depth and tracers: from the node `begin` on, out = now + tau (rate +
    loss) in `count` blocks, with the rates of the pointwise terms at the masses `mass_mix` and the
    wind of `wind_mix`; then it stores the combinations of `levels_struct`. The second kernel steps
    both winds, with the rates at `wind_mix`. `loss` is read only if `damped`. If `point` is a
    tangent, `base` is subtracted from all combinations.
    """
    added, shifted = pointwise_sum(unknowns, point), point.tangent

    @Placeholder
    def geometry(of: Any) -> Any:
        point = added.structure.find(of)
        area = wp.array(dtype=of.real)
        return struct_of("Geometry", {"size": wp.int32, "inverse_area": area, "point": point})

    mass = _finish_mass(unknowns, geometry, added, damped, shifted)
    finish = _finish_wind(geometry, added, damped, shifted)

    @kernel
    def depth(
        begin: int, geo: geometry, places: Places, stride: int, count: int, local: vector, s: levels
    ):
        node = begin + lanes * wp.tid()
        for k in range(count):
            r = row(gather(local, places, node, k * stride))
            mass(geo, s.mass_mix, r, k, node, s)

    @kernel
    def wind(begin: int, geo: geometry, places: Places, stride: int, local: vector, s: levels):
        node = begin + lanes * wp.tid()
        r = two_rows(gather(local, places, node, 0), gather(local, places, node, stride))
        finish(geo, s.wind_mix, r, 0, node, s)

    return depth, wind, geometry


@functools.cache
def combine_levels_kernel(shifted: bool) -> Any:
    """Return the kernel (first, now, past, older, weights, base, out) that combines time levels.

    The kernel stores the weighted sum, less `base` if `shifted`, in `out` from offset `first` on.
    """

    @kernel
    def combine_levels(
        first: int, now: vector, past: vector, older: vector, weights: triple, base: vector,
        out: vector,
    ):  # fmt: skip
        k = first + wp.tid()
        total = weights[0] * load(now, k) + weights[1] * load(past, k) + weights[2] * load(older, k)
        if wp.static(shifted):
            total -= load(base, k)
        put(out, k, total)

    return combine_levels
