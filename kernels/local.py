"""Kernels over elements, in both launch shapes: mass-weighted results of each element, before DSS.

The shape "element" launches one thread per group of elements, the shape "node" (E, np*np) threads,
one per element node. Formulas, arguments and results (groups, np*np, fields) are the same.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.assembly import finish_rates
from swe_sphere.kernels.define import func, kernel, specialise, vector
from swe_sphere.kernels.dynamics import tangent, transport, vector_invariant
from swe_sphere.kernels.element import Finish, element_diffusion, element_sweep
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.node import node_diffusion, node_sweep
from swe_sphere.kernels.terms import KernelTypes, Terms, geometry, local, output


@functools.cache
def tendency_kernels(t: KernelTypes, finish_of: Any = finish_rates) -> list[Any]:
    """Return a list that ends with the kernel (begin, geometry, x, out, direct) of `t.terms`.

    The kernel handles the groups of elements from `begin` on, with x (unknowns*N,). With diffusion
    in the shape "node", the kernel (geometry, x), which fills `geometry.fluxes`, precedes it and
    runs over the same threads. With `t.point`, the shape "element" stores tendencies at nodes that
    no other element has, in the first `block_groups` groups, in `direct`, as after DSS. finish_of:
    function from t and a number of fields to the `Finish` of these nodes.
    """
    terms, formula, by_node = t.terms, _formula(t.terms), t.shape == "node"
    finish = functools.partial(finish_of, t) if t.point is not None else None
    _, sweep = _sweep(t, formula, finish and formula and finish(formula.fields))
    *fluxes, diffuse = [None]
    if terms.diffuses:
        *fluxes, diffuse = node_diffusion(t) if by_node else [element_diffusion(t, finish)]

    @func
    def source(geo: geometry, x: vector):
        """Return the prescribed wind, the base of linear terms, or otherwise x."""
        if wp.static(terms.passive and terms.dynamics):
            return geo.wind
        elif wp.static(terms.linear):
            return geo.base
        else:
            return x

    @func
    def add_terms(geo: geometry, x: vector, e: int, n: int, out: local, direct: output):
        if wp.static(terms.dynamics):
            sweep(geo, source(geo, x), x, 0, 0, e, n, out, direct)
        if wp.static(terms.diffuses):
            diffuse(geo, x, e, n, out, direct)

    # two kernels, because a thread index in two dimensions costs two divisions per element
    @kernel
    def tendency_of_groups(begin: int, geo: geometry, x: vector, out: local, direct: output):
        add_terms(geo, x, begin + wp.tid(), 0, out, direct)

    @kernel
    def tendency(begin: int, geo: geometry, x: vector, out: local, direct: output):
        e, n = wp.tid()
        add_terms(geo, x, begin + e, n, out, direct)

    return [specialise(made, t) for made in (*fluxes, tendency if by_node else tendency_of_groups)]


@functools.cache
def field_kernel(t: KernelTypes, formula: Formula, finish: Finish = None) -> Any:
    """Return the kernel (begin, geometry, a, x, first, count, out, direct) of a formula.

    The kernel handles the groups of elements from `begin` on, and `count` fields of x from the
    offset `first` on; only `finish` uses `direct`. Shape "node" has (E, count, np*np) threads.
    """
    by_node, (load_winds, sweep) = t.shape == "node", _sweep(t, formula, finish)

    @kernel
    def over_fields(
        begin: int, geo: geometry, a: vector, x: vector, first: int, count: int, out: local,
        direct: output,
    ):  # fmt: skip
        if wp.static(by_node):
            e, k, n = wp.tid()
            sweep(geo, a, x, first + k * geo.size, k, begin + e, n, out, direct)
        else:
            e = begin + wp.tid()
            load_winds(geo, a, x, e)
            for k in range(count):
                sweep(geo, a, x, first + k * geo.size, k, e, 0, out, direct)

    return specialise(over_fields, t)


def _sweep(t: KernelTypes, formula: Formula | None, finish: Finish) -> tuple[Any, Any]:
    """Return the functions of `element_sweep`; the shape "node" has none that loads winds."""
    if formula is None:
        return None, None
    if t.shape == "node":
        return None, node_sweep(t, formula)
    return element_sweep(t, formula, finish)


def _formula(terms: Terms) -> Formula | None:
    """Return the formula of all terms except diffusion."""
    if not terms.dynamics:
        return None
    if terms.passive:
        return transport(alone=True)
    return tangent(terms) if terms.tangent else vector_invariant(terms)
