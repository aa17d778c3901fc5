"""One thread an element node: the launch shape for GPUs.

Each thread computes what is differentiated at its own node, and sums up what the threads of its
element have along the two lines of nodes through it.  A weak Laplacian needs two nested line sums:
a first kernel writes the fluxes of every node, the tendency kernel takes their weak divergence.
"""

from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel
from swe_sphere.kernels.diffusion import diffusion
from swe_sphere.kernels.element import keep_fields
from swe_sphere.kernels.formulas import Formula
from swe_sphere.kernels.simd.shared_lines import shared_lines
from swe_sphere.kernels.terms import KernelTypes


def node_sweep(t: KernelTypes, f: Formula) -> Any:
    """Return the function (geometry, a, x, at, e, n, k, out): the formula at an element node."""
    derivatives, keep = _derivatives(t, f), keep_fields(t, f.fields)

    @func
    def sweep(
        geo: t.geometry, a: t.vector, x: t.vector, at: int, e: int, n: int, k: int, out: t.local
    ):
        s1, s2 = derivatives(geo, a, x, at, e, n)
        w = f.winds()
        if wp.static(f.turns):
            w = f.wind(geo, a, x, e, n)
        keep(f.result(geo, w, s1, s2, e, n), e, n, k, out)

    return sweep


def node_kernel(t: KernelTypes, formula: Formula) -> wp.Kernel:
    """Return the kernel (geometry, a, x, first, count, out, done), over (E, count, np*np) threads.

    It is for `count` fields of x from the offset `first` on; `done` is not used.
    """
    sweep = node_sweep(t, formula)

    @kernel
    def over_nodes(
        geo: t.geometry, a: t.vector, x: t.vector, first: int, count: int, out: t.local,
        done: t.done,
    ):  # fmt: skip
        e, k, n = wp.tid()
        sweep(geo, a, x, first + k * geo.size, e, n, k, out)

    return over_nodes


def _derivatives(t: KernelTypes, f: Formula) -> Any:
    """Return the function (geometry, a, x, at, e, n): derivatives along each coordinate."""
    np_, lines = t.np, shared_lines(f.rows, t.real, t.np, "points")

    @func
    def derivatives(geo: t.geometry, a: t.vector, x: t.vector, at: int, e: int, n: int):
        i = n // np_
        j = n % np_
        room = lines.enter(n)
        for turn in range(lines.turns(n)):
            p = n + turn
            r1, r2 = f.slopes(geo, f.wind(geo, a, x, e, p), a, x, at, e, p)
            lines.put(room, p, r1, r2)
        lines.meet()
        s1 = lines.along(room, geo.derivative, i, j)
        s2 = lines.across(room, geo.derivative, i, j)
        return s1, s2

    return derivatives


def flux_kernel(t: KernelTypes) -> wp.Kernel:
    """Return the kernel (geometry, x): fluxes of the diffused fields at each element node.

    `geometry.fluxes` (E, np*np, 2 or 4) becomes the two contravariant fluxes of the height and,
    where the wind diffuses, w div V and w curl V.
    """
    moves = t.terms.unknowns == 3
    formula = diffusion(t, height=True, wind=moves)
    derivatives, fluxes = _derivatives(t, formula), formula.fluxes

    @kernel
    def flux(geo: t.geometry, x: t.vector):
        e, n = wp.tid()
        s1, s2 = derivatives(geo, x, x, 0, e, n)
        r1, r2 = fluxes(geo, s1, s2, e, n)
        geo.fluxes[e, n, 0] = r1[0]
        geo.fluxes[e, n, 1] = r2[0]
        if wp.static(moves):
            geo.fluxes[e, n, 2] = r1[1]
            geo.fluxes[e, n, 3] = r1[2]

    return flux


def node_diffusion(t: KernelTypes) -> Any:
    """Return the function (geometry, x, e, n, out): the Laplacian from what `flux_kernel` left."""
    np_, moves = t.np, t.terms.unknowns == 3
    formula = diffusion(t, height=True, wind=moves)
    rows, result, keep = formula.rows, formula.result, keep_fields(t, formula.fields)
    lines = shared_lines(rows, t.real, np_, "fluxes")

    @func
    def fluxes(geo: t.geometry, e: int, n: int, line: int):
        r = rows()
        r[0] = geo.fluxes[e, n, line]
        if wp.static(moves):
            r[1] = geo.fluxes[e, n, 2]
            r[2] = geo.fluxes[e, n, 3]
        return r

    @func
    def diffuse(geo: t.geometry, x: t.vector, e: int, n: int, out: t.local):
        i = n // np_
        j = n % np_
        room = lines.enter(n)
        for turn in range(lines.turns(n)):
            p = n + turn
            lines.put(room, p, fluxes(geo, e, p, 0), fluxes(geo, e, p, 1))
        lines.meet()
        t1 = lines.along_transposed(room, geo.derivative, i, j)
        t2 = lines.across_transposed(room, geo.derivative, i, j)
        keep(result(geo, t1, t2, e, n, out), e, n, 0, out)

    return diffuse
