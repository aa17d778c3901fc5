"""One thread an element node: the launch shape for GPUs.

Each thread sums along the two lines of nodes through its own node.  Neighbouring threads read the
same lines, so the repeated loads come from the cache.  A weak Laplacian needs two nested line sums:
a first kernel writes the fluxes of every node, the tendency kernel takes their weak divergence.
"""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS
from swe_sphere.kernels.diffusion import Diffusion, diffusion
from swe_sphere.kernels.formulas import Formula, keep_fields


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
    np_, rows, real = t.np, f.rows, t.real

    @no_type_check
    @wp.func
    def derivatives(geo: t.geometry, a: t.vector, x: t.vector, at: int, e: int, n: int):
        i = n // np_
        j = n % np_
        s1 = rows(real(0.0))
        s2 = rows(real(0.0))
        for m in range(np_):
            p = m * np_ + j
            point = f.read(geo, f.wind(geo, a, x, e, p), a, x, at, e, p)
            s1 += geo.derivative[i, m] * f.first(geo, point, e, p)
            p = i * np_ + m
            point = f.read(geo, f.wind(geo, a, x, e, p), a, x, at, e, p)
            s2 += geo.derivative[j, m] * f.second(geo, point, e, p)
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
    rows, real, keep = of.formula.rows, t.real, keep_fields(t, of.formula)

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
        t1 = rows(real(0.0))
        t2 = rows(real(0.0))
        for m in range(np_):
            t1 += geo.derivative[m, i] * fluxes(geo, e, m * np_ + j, 0)
            t2 += geo.derivative[m, j] * fluxes(geo, e, i * np_ + m, 1)
        keep(of.result(geo, t1, t2, e, n, out), e, n, 0, out)

    return diffuse


def _diffusion(t: SimpleNamespace) -> Diffusion:
    return diffusion(t, height=True, wind=t.terms.unknowns == 3)
