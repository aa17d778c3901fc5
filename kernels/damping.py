"""Damping of the modes of each element, which approximates a solve of implicit diffusion."""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import kernel, lanes, real, value, vector
from swe_sphere.kernels.metric import basis, covariant_wind, gradient
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import Places, converting, gather, load, load_given, nodes
from swe_sphere.kernels.terms import across, along, local, np_, side, state_vector

matrix, each = wp.array2d(dtype=real), wp.array2d(dtype=value)


@kernel
def damp(to_modes: matrix, to_nodes: matrix, factor: each, scale: each, x: local, out: local):
    """Multiply modes of an element by `factor` (groups, np*np), then nodal values by `scale`.

    `to_modes` and `to_nodes` (np, np) transform along one coordinate; runs over groups.
    """
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
def covariant(node: nodes, basis: basis, size: int, r: state_vector, first: local, second: local):
    """Store the covariant wind components of a state, with `KernelTypes.threads` of groups."""
    e, p, q = wp.tid()
    for i in range(p * side, p * side + side):
        for j in range(q * side, q * side + side):
            n = i * np_ + j
            u = load_given(r, 0, node[e, n])
            v = load_given(r, size, node[e, n])
            u1, u2 = covariant_wind(basis, e, n, u, v)
            first[e, n, 0] = u1
            second[e, n, 0] = u2


@kernel
def physical(weight: matrix, basis: basis, first: local, second: local, east: local, north: local):
    """Store W J times the wind with these covariant components; threads as in `covariant`."""
    e, p, q = wp.tid()
    for i in range(p * side, p * side + side):
        for j in range(q * side, q * side + side):
            n = i * np_ + j
            u, v = gradient(basis, e, n, first[e, n, 0], second[e, n, 0])
            east[e, n, 0] = weight[i, j] * u
            north[e, n, 0] = weight[i, j] * v


@functools.cache
def joined_kernel(given: Any) -> Any:
    """Return the kernel that applies DSS to one field, for a result of the number type `given`."""
    _, put_as = converting(given)

    @kernel
    def joined(
        begin: int, places: Places, inverse_area: vector, field: vector, first: int,
        out: wp.array(dtype=given),
    ):  # fmt: skip
        node = begin + lanes * wp.tid()
        put_as(out, first + node, mul(load(inverse_area, node), gather(field, places, node, 0)))

    return joined
