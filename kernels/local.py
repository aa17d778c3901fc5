"""Kernels over elements, in both launch shapes: mass-weighted results of each element, before DSS.

The shape "element" launches a thread for each group of elements, "node" (E, np*np) threads, one an
element node.  Formulas, arguments and results (groups, np*np, fields) are the same.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.assembly import finish_rates
from swe_sphere.kernels.define import func, kernel
from swe_sphere.kernels.dynamics import (
    gradient,
    skew,
    state,
    tangent,
    transport,
)
from swe_sphere.kernels.element import (
    Finish,
    element_diffusion,
    element_kernel,
    element_sweep,
)
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.node import flux_kernel, node_diffusion, node_kernel, node_sweep
from swe_sphere.kernels.pointwise import NO_POINTWISE, Pointwise, pointwise_sum
from swe_sphere.kernels.simd.register import Register, lanes_of
from swe_sphere.kernels.terms import ElementKernel, KernelTypes, Terms


@functools.cache
def tendency_kernel(
    terms: Terms, np_: int, real: Any, shape: str, direct: bool = False,
    point: Pointwise = NO_POINTWISE,
) -> ElementKernel:  # fmt: skip
    """Return the kernel (geometry, x (unknowns*N,), out, done (unknowns*N,)) of these terms.

    Where `direct`, in the shape "element", the tendencies at nodes inside the first `whole` groups
    go to `done` as DSS would leave them, with the rates of `point`; else `done` is not written.
    """
    added = None
    if direct:
        added = pointwise_sum(terms.unknowns, Register(real, lanes_of(real)), point)
    return kernels_of(KernelTypes(np_, real, shape, terms, added))


def kernels_of(t: KernelTypes, finish_of: Any = finish_rates) -> ElementKernel:
    """Return the kernel for the tendencies of `t.terms`.

    finish_of: makes, from t and a number of fields, what finishes nodes inside elements.
    """
    finish = functools.partial(finish_of, t) if t.point is not None else None
    made = _element_tendency(t, finish) if t.shape == "element" else _node_tendency(t)
    flux = flux_kernel(t) if t.terms.diffuses and t.shape == "node" else None
    return ElementKernel(made, t.geometry, t.value, flux)


def _formula(t: KernelTypes) -> Formula | None:
    """Return the formula of the terms but diffusion."""
    if not t.terms.dynamics:
        return None
    if t.terms.wind:
        return transport(t)
    if t.terms.poisson:
        return skew(t)
    return tangent(t) if t.terms.tangent else state(t)


def _element_tendency(t: KernelTypes, finish_of: Any) -> wp.Kernel:
    terms, formula, source = t.terms, _formula(t), _source(t)
    finish: Finish = finish_of(formula.fields) if formula and finish_of else None
    load_winds, sweep = element_sweep(t, formula, finish) if formula else (None, None)
    diffuse = element_diffusion(t, finish_of) if terms.diffuses else None

    @kernel
    def over_elements(geo: t.geometry, x: t.vector, out: t.local, done: t.done):
        e = wp.tid()
        if wp.static(terms.dynamics):
            load_winds(geo, source(geo, x), x, e)
            sweep(geo, source(geo, x), x, 0, 0, e, out, done)
        if wp.static(terms.diffuses):
            diffuse(geo, x, e, out, done)

    return over_elements


def _node_tendency(t: KernelTypes) -> wp.Kernel:
    terms, formula, source = t.terms, _formula(t), _source(t)
    sweep = node_sweep(t, formula) if formula else None
    diffuse = node_diffusion(t) if terms.diffuses else None

    @kernel
    def over_nodes(geo: t.geometry, x: t.vector, out: t.local, done: t.done):
        e, n = wp.tid()
        if wp.static(terms.dynamics):
            sweep(geo, source(geo, x), x, 0, e, n, 0, out)
        if wp.static(terms.diffuses):
            diffuse(geo, x, e, n, out)

    return over_nodes


def _source(t: KernelTypes) -> Any:
    """Return the function (geometry, x): the vector of the prescribed wind or of the base."""

    @func
    def source(geo: t.geometry, x: t.vector):
        if wp.static(t.terms.wind and t.terms.dynamics):
            return geo.wind
        elif wp.static(t.terms.linear):
            return geo.base
        else:
            return x

    return source


@dataclass(frozen=True)
class FieldKernels:
    """Kernels (geometry, a, x, first, count, out, done) for fields of x from the offset `first` on.

    The shape "node" launches (E, count, np*np) threads.
    """

    gradient: wp.Kernel
    """Gradient of one field, to two; a is not read."""
    transport: wp.Kernel
    """-div(m V) of `count` masses m with the wind V in front of a."""
    tangent: wp.Kernel
    """Derivative of the transport at the state a along x, both with winds in front."""
    geometry: Any
    value: Any


@functools.cache
def field_kernels(np_: int, real: Any, shape: str) -> FieldKernels:
    """Return the kernels on fields."""
    t = KernelTypes(np_, real, shape)
    made: Any = element_kernel if shape == "element" else node_kernel
    of_mass, of_tangent = made(t, transport(t)), made(t, transport(t, tangent=True))
    return FieldKernels(made(t, gradient(t)), of_mass, of_tangent, t.geometry, t.value)
