"""Nodal steps of the block elimination of the linearised equations, fused with DSS.

With tau the implicit step, T = (I + tau f k x)^-1 and the depth H, elimination of the wind leaves
S = I - tau^2 g D H T G for the depth, with the discrete, DSS'd gradient G and divergence D.
"""

import functools
from types import SimpleNamespace

import warp as wp

OPTIONS = {"max_unroll": 1}


@functools.cache
def elimination_kernels(real: type, given: type) -> SimpleNamespace:
    """Kernels over the N nodes; `real` is the type inside, `given` that of the vectors given.

    The structure `nodal` holds `offsets`, `entries_2`, `entries_1` (contributors in local tendencies
    of two fields and of one), `stride`, `size` = N, `inverse_area`, `depth` H [m], `turn_same` and
    `turn_cross` (the entries 1/(1 + tau^2 f^2) and tau f/(1 + tau^2 f^2) of T) and `inverse_diagonal`
    (of S).
    """
    real_1 = wp.array(dtype=real)
    given_1 = wp.array(dtype=given)
    members = {
        "offsets": wp.array(dtype=wp.int32),
        "entries_1": wp.array(dtype=wp.int32),
        "entries_2": wp.array(dtype=wp.int32),
        "stride": wp.int32,
        "size": wp.int32,
        "inverse_area": real_1,
        "depth": real_1,
        "turn_same": real_1,
        "turn_cross": real_1,
        "inverse_diagonal": real_1,
    }
    nodal = wp.struct(type("Nodal", (), {"__annotations__": members}))

    @wp.func
    def total_1(nod: nodal, local: real_1, node: int):
        r = real(0.0)
        for k in range(nod.offsets[node], nod.offsets[node + 1]):
            r += local[nod.entries_1[k]]
        return r * nod.inverse_area[node]

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def turned_flux(nod: nodal, r: given_1, flux: real_1):
        node = wp.tid()
        u = real(r[node])
        v = real(r[nod.size + node])
        same = nod.turn_same[node]
        cross = nod.turn_cross[node]
        flux[node] = nod.depth[node] * (same * u + cross * v)
        flux[nod.size + node] = nod.depth[node] * (same * v - cross * u)

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def eliminated(nod: nodal, local: real_1, r: given_1, tau: real, b: real_1):
        node = wp.tid()
        b[node] = real(r[2 * nod.size + node]) - tau * total_1(nod, local, node)

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def gradient_flux(nod: nodal, local: real_1, flux: real_1):
        node = wp.tid()
        u = real(0.0)
        v = real(0.0)
        for k in range(nod.offsets[node], nod.offsets[node + 1]):
            at = nod.entries_2[k]
            u += local[at]
            v += local[at + nod.stride]
        scale = nod.depth[node] * nod.inverse_area[node]
        same = scale * nod.turn_same[node]
        cross = scale * nod.turn_cross[node]
        flux[node] = same * u + cross * v
        flux[nod.size + node] = same * v - cross * u

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def substituted(nod: nodal, local: real_1, r: given_1, h: real_1, tau_g: real, out: given_1):
        node = wp.tid()
        u = real(0.0)
        v = real(0.0)
        for k in range(nod.offsets[node], nod.offsets[node + 1]):
            at = nod.entries_2[k]
            u += local[at]
            v += local[at + nod.stride]
        scale = tau_g * nod.inverse_area[node]
        u = real(r[node]) - scale * u
        v = real(r[nod.size + node]) - scale * v
        same = nod.turn_same[node]
        cross = nod.turn_cross[node]
        out[node] = given(same * u + cross * v)
        out[nod.size + node] = given(same * v - cross * u)
        out[2 * nod.size + node] = given(h[node])

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def chebyshev(
        nod: nodal,
        local: real_1,
        tau_tau_g: real,
        keep: real,
        take: real,
        beta: real,
        r: real_1,
        d: real_1,
        x: real_1,
    ):
        node = wp.tid()
        residual = r[node] - (d[node] - tau_tau_g * total_1(nod, local, node))
        step = keep * d[node] + take * nod.inverse_diagonal[node] * residual
        r[node] = residual
        d[node] = step
        x[node] += beta * step

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def schur(nod: nodal, local: real_1, tau_tau_g: real, d: real_1, out: real_1):
        node = wp.tid()
        out[node] = d[node] - tau_tau_g * total_1(nod, local, node)

    return SimpleNamespace(
        nodal=nodal,
        turned_flux=turned_flux,
        eliminated=eliminated,
        gradient_flux=gradient_flux,
        substituted=substituted,
        chebyshev=chebyshev,
        schur=schur,
    )
