"""The discrete gradient and divergence, DSS included, and weak Laplacians as sparse matrices.

They are the operators of the kernels, entry by entry: block elimination of the linearised equations
has to use these and not a compact Laplacian.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..mesh import Mesh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ElementSpace:
    """Continuous functions that have the same nodal values on every element."""

    values: Array
    """(np*np, k) nodal values of the k functions of an element."""
    numbers: NDArray[np.int32]
    """(E, k) their numbers."""


def gradient(mesh: Mesh) -> sp.csr_matrix:
    """(2N, N) [m-1]: eastward and northward components of the gradient of a nodal field."""
    b = mesh.basis
    weight = _weights(mesh)
    east = _derivatives(mesh, weight * b[..., 1, 1], -weight * b[..., 0, 1])
    north = _derivatives(mesh, -weight * b[..., 1, 0], weight * b[..., 0, 0])
    return sp.vstack([east, north], format="csr")


def divergence(mesh: Mesh) -> sp.csr_matrix:
    """(N, 2N) [m-1]: divergence of a nodal wind; minus the adjoint of `gradient`.

    The discrete integration by parts <s, div V> = -<grad s, V> in the inner product weighted by the
    nodal areas (Taylor & Fournier 2010, doi:10.1016/j.jcp.2010.04.008, eq. 42).
    """
    area = sp.diags_array(np.concatenate([mesh.area, mesh.area]))
    return _over_area(mesh, -(gradient(mesh).T @ area).tocsr())


def weak_laplacian(mesh: Mesh, coefficient: Array | None = None) -> sp.csr_matrix:
    """(N, N) [m-2]: compact div(coefficient grad), integrated by parts within the elements.

    `coefficient` (N,) is taken at the nodes, 1 by default.
    """
    laplacian = stiffness(mesh, np.ones(mesh.size) if coefficient is None else coefficient)
    return _over_area(mesh, -laplacian)


def stiffness(mesh: Mesh, coefficient: Array, space: ElementSpace | None = None) -> sp.csr_matrix:
    """(N, N) integral of coefficient grad phi . grad s, from the element matrices.

    With a `space` it is that of its functions, made without the large matrix on the nodes.
    """
    d, eye = mesh.derivative, np.eye(mesh.np)
    lines = np.stack([np.kron(d, eye), np.kron(eye, d)])
    numbers = mesh.nodes.reshape(mesh.elements, -1)
    if space is not None:
        lines, numbers = lines @ space.values, space.numbers
    inverse = np.linalg.inv(np.einsum("eijak,eijbk->eijab", mesh.basis, mesh.basis))
    factor = _weights(mesh) * mesh.jacobian * coefficient[mesh.nodes]
    metric = (factor[..., None, None] * inverse).reshape(mesh.elements, mesh.np**2, 2, 2)
    blocks = np.einsum("apm,epab,bpn->emn", lines, metric, lines, optimize=True)
    rows = np.broadcast_to(numbers[:, :, None], blocks.shape)
    columns = np.broadcast_to(numbers[:, None, :], blocks.shape)
    index = (rows.ravel(), columns.ravel())
    size = int(numbers.max()) + 1
    return sp.coo_array((blocks.ravel(), index), (size, size)).tocsr()


def _derivatives(mesh: Mesh, along_1: Array, along_2: Array) -> sp.csr_matrix:
    """(N, N) DSS of along_1 D1 + along_2 D2, mass-weighted coefficients (E, np, np)."""
    d, n = mesh.derivative, mesh.np
    shape = (2, mesh.elements, n, n, n)
    values, columns = np.empty(shape), np.empty(shape, dtype=np.int32)
    np.multiply(along_1[..., None], d[None, :, None, :], out=values[0])
    np.multiply(along_2[..., None], d[None, None, :, :], out=values[1])
    columns[0] = mesh.nodes.transpose(0, 2, 1)[:, None, :, :]
    columns[1] = mesh.nodes[:, :, None, :]
    index = (np.broadcast_to(mesh.nodes[..., None], shape).ravel(), columns.ravel())
    return _over_area(mesh, sp.coo_array((values.ravel(), index), (mesh.size, mesh.size)).tocsr())


def _over_area(mesh: Mesh, matrix: sp.csr_matrix) -> sp.csr_matrix:
    """The matrix, its rows divided by the nodal areas in place."""
    matrix.data *= np.repeat(1.0 / mesh.area, np.diff(matrix.indptr))
    return matrix


def _weights(mesh: Mesh) -> Array:
    return np.outer(mesh.gll_weights, mesh.gll_weights)
