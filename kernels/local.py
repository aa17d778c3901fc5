"""Kernels over elements, in both launch shapes: mass-weighted results of each element, before DSS.

The shape "element" launches a thread for each group of elements, "node" (E, np*np)
threads, one an element node.  Formulas, arguments and results (groups, np*np, fields) are the same.
"""

import functools
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS
from swe_sphere.kernels.dynamics import gradient, shallow_water, transport
from swe_sphere.kernels.element import (
    element_diffusion,
    element_divergence,
    element_gradient,
    element_sweep,
)
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.node import flux_kernel, node_diffusion, node_sweep
from swe_sphere.kernels.pointwise import NO_POINTWISE, Pointwise, pointwise_sum
from swe_sphere.kernels.terms import Terms, kernel_types, lanes_of


@functools.cache
def tendency_kernel(
    terms: Terms,
    np_: int,
    real: type,
    shape: str,
    direct: bool = False,
    point: Pointwise = NO_POINTWISE,
    done: type | None = None,
    damped: bool = False,
) -> SimpleNamespace:
    """Kernel (geometry, x (unknowns*N,), out, done (unknowns*N,)): tendencies of those terms.

    Where `direct`, in the shape "element", the tendencies at nodes inside the first `whole` groups
    go to `done` as DSS would leave them, with the rates of `point`; else `done` is not written.  Of
    the type `levels_struct` it has the nodes stepped, with a loss where `damped`.
    With the types `geometry` and `value`.  With diffusion in the shape "node", `flux_kernel`
    (geometry, x) goes before it over the same threads and fills `geometry.fluxes`, else it is None.
    """
    at_points = pointwise_sum(terms.unknowns, real, point, lanes_of(real)) if direct else None
    t = kernel_types(np_, real, shape, terms, direct, done, point=at_points, damped=damped)
    sweep, diffuses = _drivers(shape)
    dynamics = diffuse = None
    if terms.dynamics:
        dynamics = sweep(t, transport(t) if terms.wind else shallow_water(t))
    if terms.diffuses:
        diffuse = diffuses(t)

    @no_type_check
    @wp.func
    def local_tendency(geo: t.geometry, x: t.vector, e: int, n: int, out: t.local, done: t.done):
        if wp.static(terms.dynamics and terms.wind):
            dynamics(geo, geo.wind, x, 0, e, n, 0, out, done)
        elif wp.static(terms.dynamics and (terms.tangent or terms.poisson)):
            dynamics(geo, geo.base, x, 0, e, n, 0, out, done)
        elif wp.static(terms.dynamics):
            dynamics(geo, x, x, 0, e, n, 0, out, done)
        if wp.static(terms.diffuses):
            diffuse(geo, x, e, n, out, done)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def over_elements(geo: t.geometry, x: t.vector, out: t.local, done: t.done):
        e = wp.tid()
        local_tendency(geo, x, e, 0, out, done)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def over_nodes(geo: t.geometry, x: t.vector, out: t.local, done: t.done):
        e, n = wp.tid()
        local_tendency(geo, x, e, n, out, done)

    kernel = over_elements if shape == "element" else over_nodes
    flux = flux_kernel(t) if terms.diffuses and shape == "node" else None
    return SimpleNamespace(kernel=kernel, flux_kernel=flux, geometry=t.geometry, value=t.value)


@functools.cache
def field_kernels(np_: int, real: type, shape: str) -> SimpleNamespace:
    """Kernels (geometry, a, x, first, count, out) for fields of x from the offset `first` on.

    `gradient` of one field, to two, with any a, and -div(m V) of `count` masses: `transport` by the
    wind V in front of a, and `tangent`, its derivative at the state a along x, both with winds in
    front.  The shape "node" launches (E, count, np*np) threads.  With the types `geometry` and
    `value`.
    """
    t = kernel_types(np_, real, shape)
    kinds = {"transport": "mass", "tangent": "tangent"}
    if shape == "element":
        made = {name: element_divergence(t, kind) for name, kind in kinds.items()}
        made["gradient"] = element_gradient(t)
    else:
        made = {name: _field_kernel(t, transport(t, kind)) for name, kind in kinds.items()}
        made["gradient"] = _field_kernel(t, gradient(t))
    return SimpleNamespace(**made, geometry=t.geometry, value=t.value)


def _field_kernel(t: SimpleNamespace, formula: Formula) -> wp.Kernel:
    geometry, vector, local, sweep = t.geometry, t.vector, t.local, node_sweep(t, formula)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def over_nodes(geo: geometry, a: vector, x: vector, first: int, count: int, out: local):
        e, k, n = wp.tid()
        sweep(geo, a, x, first + k * geo.size, e, n, k, out, x)

    return over_nodes


def _drivers(shape: str) -> tuple[Any, Any]:
    """What applies a formula, and a diffusion, in that launch shape."""
    if shape == "element":
        return element_sweep, element_diffusion
    return node_sweep, node_diffusion
