"""Damping of each element's own modes: a cheap stand-in for the inverse of implicit diffusion."""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel
from swe_sphere.kernels.element import line_sums
from swe_sphere.kernels.simd.memory import Contributors, gather_of, load_of
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.terms import KernelTypes


@dataclass(frozen=True)
class DampingKernels:
    """Kernels over (groups, np*np / `share`) threads, `damp` over groups, `joined` over nodes."""

    damp: wp.Kernel
    """Multiplies the modes of an element by `factor` (groups, np*np): `to_modes` and `to_nodes`
    (np, np) act along one coordinate; the result is multiplied by `scale` (groups, np*np)."""
    covariant: wp.Kernel
    """Covariant components of the wind of a state."""
    physical: wp.Kernel
    """The wind of covariant components, with the weights of DSS."""
    joined: wp.Kernel
    """DSS of one field."""
    share: int


@functools.cache
def damping_kernels(np_: int, real: Any, given: Any, shape: str) -> DampingKernels:
    """Return the kernels for fields of `real` and states of `given`."""
    t = KernelTypes(np_, real, shape)
    value, field, on_nodes, state = t.value, t.local, wp.array(dtype=real), wp.array(dtype=given)
    mul, covariant_wind, gradient = t.metric.mul, t.metric.covariant_wind, t.metric.gradient
    share = np_ * np_ if shape == "element" else 1
    matrix, each, load = wp.array2d(dtype=real), wp.array2d(dtype=value), load_of(t.register, given)
    gather, (along, across, _, _) = gather_of(Register(real)), line_sums(t.register, np_, value)

    @kernel
    def damp(to_modes: matrix, to_nodes: matrix, factor: each, scale: each, x: field, out: field):
        e = wp.tid()
        a = wp.zeros(shape=(np_, np_), dtype=value)
        b = wp.zeros(shape=(np_, np_), dtype=value)
        for i in range(np_):
            for j in range(np_):
                b[i, j] = x[e, i * np_ + j, 0]
        for i in range(np_):
            for j in range(np_):
                a[i, j] = along(to_modes, b, i, j)
        for i in range(np_):
            for j in range(np_):
                b[i, j] = mul(factor[e, i * np_ + j], across(to_modes, a, i, j))
        for i in range(np_):
            for j in range(np_):
                a[i, j] = along(to_nodes, b, i, j)
        for i in range(np_):
            for j in range(np_):
                out[e, i * np_ + j, 0] = mul(scale[e, i * np_ + j], across(to_nodes, a, i, j))

    @kernel
    def covariant(
        nodes: wp.array2d(dtype=t.index), basis: wp.array3d(dtype=value), size: int, r: state,
        first: field, second: field,
    ):  # fmt: skip
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            u = load(r, 0, nodes[e, n])
            v = load(r, size, nodes[e, n])
            u1, u2 = covariant_wind(basis, e, n, u, v)
            first[e, n, 0] = u1
            second[e, n, 0] = u2

    @kernel
    def physical(
        weight: matrix, basis: wp.array3d(dtype=value), first: field, second: field, east: field,
        north: field,
    ):  # fmt: skip
        e, part = wp.tid()
        for n in range(part * share, part * share + share):
            w = weight[n // np_, n % np_]
            u, v = gradient(basis, e, n, first[e, n, 0], second[e, n, 0])
            east[e, n, 0] = w * u
            north[e, n, 0] = w * v

    @kernel
    def joined(
        places_1: wp.array(dtype=Contributors), inverse_area: on_nodes, local: on_nodes,
        first: int, out: state,
    ):  # fmt: skip
        node = wp.tid()
        out[first + node] = given(inverse_area[node] * gather(local, places_1, node, 0))

    return DampingKernels(damp, covariant, physical, joined, share)
