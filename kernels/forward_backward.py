"""Continuity and momentum stepped one after the other, by the kernels that compute their rates.

A field is stepped at a node once its rate is known, and combinations of the time levels are left
for the elements to differentiate next, so that no level is read for that alone.  Nodes inside
elements need no DSS: on a CPU the kernels over elements step these nodes themselves.  Other nodes
are stepped with DSS, one by one or on a CPU in runs that fill a register.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, struct_of
from swe_sphere.kernels.dynamics import transport
from swe_sphere.kernels.element import Finish, element_kernel
from swe_sphere.kernels.local import kernels_of
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum
from swe_sphere.kernels.simd.arithmetic import product_of
from swe_sphere.kernels.simd.memory import Contributors, entry_of, gather_of, put_of, run_of
from swe_sphere.kernels.simd.register import Register, lanes_of
from swe_sphere.kernels.simd.stages import levels_struct, step_of
from swe_sphere.kernels.terms import ElementKernel, KernelTypes, Terms


def _finish_mass(
    register: Register, unknowns: int, geometry: Any, point: Any, damped: bool,
    shifted: bool = False,
) -> Finish:  # fmt: skip
    """Return the function that steps the k-th mass, the depth first.

    register: a node, or nodes that fill a register; geometry: a Warp structure with at least N
    (`size`), `inverse_area` (N,) and `point`; point: the `PointwiseSum` of the nodes; damped: the
    loss of `levels_struct` is added to all rates; shifted: its base is subtracted from all
    combinations.
    """
    first, of_depth, vector = unknowns - 1, point.depth, wp.array(dtype=register.real)
    load, mul, step = run_of(register), product_of(register), step_of(register, shifted)
    levels = levels_struct(register.real)

    @func
    def finish(geo: geometry, x: vector, r: register.rows(1), k: int, node: int, s: levels):
        rate = mul(load(geo.inverse_area, node), r[0])
        at = (first + k) * geo.size + node
        if k == 0:
            rate += of_depth(geo.point, node, geo.size, s.pushed, s.carried)[0]
        if wp.static(damped):
            rate += load(s.loss, at)
        if wp.static(first > 0) and k == 0:  # first, as `out` may be a level, which is gone then
            step(s.now, s.past, at, rate, s.tau, s.mixes, s.base, s.pushed, s.pushed)
        step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.out, s.carried)

    return finish


def _finish_wind(
    register: Register, geometry: Any, point: Any, damped: bool, shifted: bool = False
) -> Finish:
    """Return the function that steps both winds; arguments as for `_finish_mass`.

    If `shifted`, `carried` then holds the combinations of the winds too.
    """
    real, of_wind = register.real, point.wind
    vector, levels = wp.array(dtype=real), levels_struct(real)
    load, mul, step = run_of(register), product_of(register), step_of(register, shifted)

    @func
    def finish(geo: geometry, x: vector, r: register.rows(2), k: int, node: int, s: levels):
        scale = load(geo.inverse_area, node)
        more = of_wind(geo.point, node, geo.size, s.pushed, s.pushed)
        for i in range(2):
            at = i * geo.size + node
            rate = mul(scale, r[i]) + more[i]
            if wp.static(damped):
                rate += load(s.loss, at)
            if wp.static(shifted):
                step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.carried, s.carried)
            step(s.now, s.past, at, rate, s.tau, s.weights, s.base, s.out, s.pushed)

    return finish


def _types(terms: Terms, np_: int, real: Any, point: Pointwise) -> KernelTypes:
    added = pointwise_sum(terms.unknowns, Register(real, lanes_of(real)), point)
    return KernelTypes(np_, real, "element", terms, added, steps=True)


@functools.cache
def carrying_kernel(
    np_: int, unknowns: int, real: Any, point: Pointwise, damped: bool
) -> ElementKernel:
    """Return the kernel (geometry, a, x, first, count, out, levels) of `transport`.

    It steps the masses at nodes inside the elements of the first `whole` groups.
    """
    t = _types(Terms(wind=unknowns == 1, still=True), np_, real, point)
    finish = _finish_mass(t.register, unknowns, t.geometry, t.point, damped)
    return ElementKernel(element_kernel(t, transport(t), finish), t.geometry, t.value)


@functools.cache
def pushing_kernel(
    terms: Terms, np_: int, real: Any, point: Pointwise, damped: bool
) -> ElementKernel:
    """Return the kernel (geometry, x, out, levels) of the momentum equation, which steps winds."""
    t = _types(terms, np_, real, point)
    return kernels_of(t, lambda t, _: _finish_wind(t.register, t.geometry, t.point, damped))


@dataclass(frozen=True)
class RunKernels:
    """Kernels over runs of nodes that sum up what elements left, and step it."""

    depth: wp.Kernel
    """(begin, geometry, places, stride, count, local, levels): from the node `begin` on, out = now
    + tau (rate + loss) in the `count` blocks of depth and tracers, with the rates of the pointwise
    terms at the masses `carried` and the wind of `pushed`; then the combinations of
    `levels_struct`."""
    wind: wp.Kernel | None
    """(begin, geometry, places, stride, local, levels): the same for both winds, with the rates at
    `pushed`."""
    geometry: Any


@functools.cache
def run_kernels(unknowns: int, real: Any, point: Pointwise, damped: bool, lanes: int) -> RunKernels:
    """Return the kernels for runs of `lanes` nodes.

    `loss` is only read where `damped`.  Where `point` is a tangent, all combinations are shifted by
    `base`.
    """
    register, vector = Register(real, lanes), wp.array(dtype=real)
    added = pointwise_sum(unknowns, register, point)
    members = {"size": wp.int32, "inverse_area": vector, "point": added.structure}
    geometry, levels = struct_of("Geometry", members), levels_struct(real)
    mass = _finish_mass(register, unknowns, geometry, added, damped, point.tangent)
    finish = _finish_wind(register, geometry, added, damped, point.tangent)
    place, gather = wp.array(dtype=Contributors), gather_of(register)
    single, pair = register.rows(1), register.rows(2)

    @kernel
    def depth(
        begin: int, geo: geometry, places: place, stride: int, count: int, local: vector, s: levels
    ):
        node = begin + lanes * wp.tid()
        for k in range(count):
            r = single()
            r[0] = gather(local, places, node, k * stride)
            mass(geo, s.carried, r, k, node, s)

    @kernel
    def wind(begin: int, geo: geometry, places: place, stride: int, local: vector, s: levels):
        node = begin + lanes * wp.tid()
        r = pair()
        r[0] = gather(local, places, node, 0)
        r[1] = gather(local, places, node, stride)
        finish(geo, s.pushed, r, 0, node, s)

    return RunKernels(depth, wind if unknowns == 3 else None, geometry)


@functools.cache
def combine_levels_kernel(real: Any, shifted: bool) -> wp.Kernel:
    """Return the kernel (first, now, past, older, weights, base, out), for the first passes.

    out is the sum of the levels with these weights, from the offset `first` on; less `base`, where
    it is `shifted`.
    """
    vector, triple = wp.array(dtype=real), wp.types.vector(3, real)
    entry, put = entry_of(real), put_of(Register(real))

    @kernel
    def combine_levels(
        first: int, now: vector, past: vector, older: vector, weights: triple, base: vector,
        out: vector,
    ):  # fmt: skip
        k = first + wp.tid()
        value = (
            weights[0] * entry(now, k) + weights[1] * entry(past, k) + weights[2] * entry(older, k)
        )
        if wp.static(shifted):
            value -= entry(base, k)
        put(out, k, value)

    return combine_levels
