"""One thread an element node: the launch shape for GPUs.

Each thread works out what is differentiated at its own node, and sums up what the threads of its
element have along the two lines of nodes through it.  A weak Laplacian needs two nested line sums:
a first kernel writes the fluxes of every node, the tendency kernel takes their weak divergence.
"""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS
from swe_sphere.kernels.diffusion import Diffusion, diffusion
from swe_sphere.kernels.formulas import Formula, keep_fields
from swe_sphere.kernels.shared_lines import shared_lines


def node_sweep(t: SimpleNamespace, f: Formula) -> wp.Function:
    """Function (geometry, a, x, at, e, n, k, out, done): the formula at a node of an element."""
    geometry, vector, local, derivatives = t.geometry, t.vector, t.local, _derivatives(t, f)
    keep = keep_fields(t, f)

    @no_type_check
    @wp.func
    def sweep(
        geo: geometry,
        a: vector,
        x: vector,
        at: int,
        e: int,
        n: int,
        k: int,
        out: local,
        done: t.done,
    ):
        s1, s2 = derivatives(geo, a, x, at, e, n)
        keep(f.result(geo, f.wind(geo, a, x, e, n), s1, s2, e, n), e, n, k, out)

    return sweep


def _derivatives(t: SimpleNamespace, f: Formula) -> wp.Function:
    """Function (geometry, a, x, at, e, n): derivatives of the rows along each coordinate."""
    np_, lines = t.np, shared_lines(f.rows, t.real, t.np, "points")

    @no_type_check
    @wp.func
    def derivatives(geo: t.geometry, a: t.vector, x: t.vector, at: int, e: int, n: int):
        i = n // np_
        j = n % np_
        room = lines.enter(n)
        for turn in range(lines.turns(n)):
            p = n + turn
            point = f.read(geo, f.wind(geo, a, x, e, p), a, x, at, e, p)
            lines.put(room, p, f.first(geo, point, e, p), f.second(geo, point, e, p))
        lines.meet()
        s1 = lines.along(room, geo.derivative, i, j)
        s2 = lines.across(room, geo.derivative, i, j)
        return s1, s2

    return derivatives


def flux_kernel(t: SimpleNamespace) -> wp.Kernel:
    """Kernel (geometry, x): fluxes of the diffused fields at each element node.

    `geometry.fluxes` (E, np*np, 2 or 4) becomes the two contravariant fluxes of the height and,
    where the wind diffuses, w div V and w curl V.
    """
    of, moves = _diffusion(t), t.terms.unknowns == 3
    derivatives = _derivatives(t, of.formula)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def flux(geo: t.geometry, x: t.vector):
        e, n = wp.tid()
        s1, s2 = derivatives(geo, x, x, 0, e, n)
        r1, r2 = of.fluxes(geo, s1, s2, e, n)
        if wp.static(not moves):
            geo.fluxes[e, n, 0] = r1
            geo.fluxes[e, n, 1] = r2
        else:
            geo.fluxes[e, n, 0] = r1[0]
            geo.fluxes[e, n, 1] = r2[0]
            geo.fluxes[e, n, 2] = r1[1]
            geo.fluxes[e, n, 3] = r1[2]

    return flux


def node_diffusion(t: SimpleNamespace) -> wp.Function:
    """Function (geometry, x, e, n, out, done): the weak Laplacian from what `flux_kernel` left."""
    of, np_, moves = _diffusion(t), t.np, t.terms.unknowns == 3
    rows, keep = of.formula.rows, keep_fields(t, of.formula)
    lines = shared_lines(rows, t.real, np_, "fluxes")

    @no_type_check
    @wp.func
    def fluxes(geo: t.geometry, e: int, n: int, line: int):
        if wp.static(not moves):
            return geo.fluxes[e, n, line]
        else:
            return rows(geo.fluxes[e, n, line], geo.fluxes[e, n, 2], geo.fluxes[e, n, 3])

    @no_type_check
    @wp.func
    def diffuse(geo: t.geometry, x: t.vector, e: int, n: int, out: t.local, done: t.done):
        i = n // np_
        j = n % np_
        room = lines.enter(n)
        for turn in range(lines.turns(n)):
            p = n + turn
            lines.put(room, p, fluxes(geo, e, p, 0), fluxes(geo, e, p, 1))
        lines.meet()
        t1 = lines.along_transposed(room, geo.derivative, i, j)
        t2 = lines.across_transposed(room, geo.derivative, i, j)
        keep(of.result(geo, t1, t2, e, n, out), e, n, 0, out)

    return diffuse


def _diffusion(t: SimpleNamespace) -> Diffusion:
    return diffusion(t, height=True, wind=t.terms.unknowns == 3)
