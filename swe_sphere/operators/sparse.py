"""Discrete operators as sparse matrices: gradient, divergence, stiffness; others by probing.

The matrices of nodal fields equal the operators of the kernels entry by entry: block elimination of
the linearised equations must use these operators and not a compact Laplacian.
"""

from __future__ import annotations  # scipy.sparse is loaded where it is used

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import DTypeLike, NDArray

from swe_sphere.arrays import Array, Int32
from swe_sphere.mesh import Mesh
from swe_sphere.operators.diagnose import assemble

PART = 1024
"""Number of elements whose matrices are built at a time, so that they fit into the caches."""


@dataclass(frozen=True)
class ElementSpace:
    """Continuous functions, of which k are not zero on an element."""

    values: Array
    """(np*np, k) nodal values of the functions."""
    numbers: NDArray[np.int32]
    """(E, k) numbers of the functions."""

    def matrix(
        self, rows: NDArray[np.int32], values: NDArray[np.floating]
    ) -> scipy.sparse.coo_array:
        """Return the matrix of function values (E, np*np, k) in rows (E, np*np); duplicates add."""
        shape = (*rows.shape, self.numbers.shape[1])
        values = np.broadcast_to(values, shape)
        columns = np.broadcast_to(self.numbers[:, None, :], shape)
        used = values != 0.0
        index = (np.broadcast_to(rows[..., None], shape)[used], columns[used])
        shape = rows.max() + 1, self.numbers.max() + 1
        return scipy.sparse.coo_array((values[used], index), shape)


def gradient(mesh: Mesh) -> scipy.sparse.csr_array:
    """Return (2N, N) [m-1]: eastward and northward components of the gradient of a nodal field."""
    b, weight = mesh.basis, mesh.quadrature
    east = _derivatives(mesh, weight * b[..., 1, 1], -weight * b[..., 0, 1])
    north = _derivatives(mesh, -weight * b[..., 1, 0], weight * b[..., 0, 0])
    return scipy.sparse.vstack([east, north], format="csr")


def gradients(mesh: Mesh, space: ElementSpace, real: DTypeLike = float) -> scipy.sparse.csr_array:
    """Return (2N, V) [m-1], of the number type `real`: gradients of the functions."""
    rows = mesh.nodes.reshape(mesh.elements, -1)
    along_1, along_2 = _lines(mesh.derivative, np.eye(mesh.np)) @ space.values
    east, north = np.empty((2, *rows.shape, space.values.shape[1]), real)
    for begin in range(0, mesh.elements, PART):
        part = slice(begin, begin + PART)
        b = mesh.quadrature[..., None, None] * mesh.basis[part]
        b = b.reshape(-1, rows.shape[1], 1, 2, 2)
        east[part] = b[..., 1, 1] * along_1 - b[..., 0, 1] * along_2
        north[part] = b[..., 0, 0] * along_2 - b[..., 1, 0] * along_1
    both = (_over_area(mesh, space.matrix(rows, each).tocsr()) for each in (east, north))
    return scipy.sparse.vstack([*both], format="csr")


def divergence(mesh: Mesh) -> scipy.sparse.csr_array:
    """Return (N, 2N) [m-1]: divergence of a nodal wind; minus the adjoint of `gradient`.

    The discrete integration by parts <s, div V> = -<grad s, V> holds in the inner product weighted
    by the nodal areas (Taylor & Fournier 2010, doi:10.1016/j.jcp.2010.04.008, eq. 42).
    """
    area = scipy.sparse.diags_array(np.concatenate([mesh.area, mesh.area]))
    return _over_area(mesh, -(gradient(mesh).T @ area).tocsr())


def stiffness(
    mesh: Mesh, coefficient: Array, space: ElementSpace | None = None
) -> scipy.sparse.csr_array:
    """Return the integrals (N, N) of coefficient (N,) times grad phi . grad s of nodal functions.

    With a `space`: the integrals (V, V) of its functions. They then count as bilinear between GLL
    nodes, and the metric terms times the coefficient as well, so that functions on different cells
    do not couple.
    """
    along, at, weights = mesh.derivative, np.eye(mesh.np), mesh.gll_weights
    values, numbers = np.eye(mesh.np**2), mesh.nodes.reshape(mesh.elements, -1)
    if space is not None:
        along, at, weights = _between(mesh.gll_points)
        values, numbers = space.values, space.numbers
    lines = _lines(along, at) @ values
    means = np.outer(weights, weights).reshape(-1, 1) * np.kron(at, at)
    at_once = max(1, PART * mesh.np**2 // len(means))
    parts = [slice(e, e + at_once) for e in range(0, mesh.elements, at_once)]
    blocks = np.concatenate([_stiffness_of(mesh, coefficient, lines, means, p) for p in parts])
    sides, size = (numbers[:, :, None], numbers[:, None, :]), int(numbers.max()) + 1
    index = tuple(np.broadcast_to(side, blocks.shape).ravel() for side in sides)
    return scipy.sparse.coo_array((blocks.ravel(), index), (size, size)).tocsr()


def _stiffness_of(mesh: Mesh, coefficient: Array, lines: Array, means: Array, part: slice) -> Array:
    """Return element matrices (part of E, k, k) by quadrature at p points.

    lines: (2, p, k) derivatives of the functions; means: (p, np*np) interpolation times weights.
    """
    basis, jacobian = mesh.basis[part], mesh.jacobian[part]
    factor = jacobian * coefficient[mesh.nodes[part]]
    nodal = factor[..., None, None] * inverse_metric(basis, jacobian)
    metric = (means @ nodal.reshape(len(factor), -1, 4)).reshape(len(factor), -1, 2, 2)
    return np.asarray(np.einsum("apm,epab,bpn->emn", lines, metric, lines, optimize=True))


def inverse_metric(basis: Array, jacobian: Array) -> Array:
    """Return the inverse (e, np, np, 2, 2) [m-2] of the metric, whose determinant is jacobian^2."""
    metric = np.einsum("eijak,eijbk->eijab", basis, basis)
    adjugate = metric[..., ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.asarray(adjugate / jacobian[..., None, None] ** 2)


def _between(points: Array) -> tuple[Array, Array, Array]:
    """Return derivatives and values (p, np) of linear interpolation, and the weights (p,).

    The p points are two Gauss points in each interval between the `points`.
    """
    width, eye = np.repeat(np.diff(points), 2), np.repeat(np.eye(points.size), 2, axis=0)
    left, right = eye[:-2], eye[2:]
    share = np.tile(0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0), points.size - 1)[:, None]
    return (right - left) / width[:, None], left + share * (right - left), 0.5 * width


def _lines(along: Array, at: Array) -> Array:
    """Return derivatives (2, p*p, np*np) along xi1 and xi2 from derivatives and values (p, np)."""
    return np.stack([np.kron(along, at), np.kron(at, along)])


def _derivatives(mesh: Mesh, along_1: Array, along_2: Array) -> scipy.sparse.csr_array:
    """Return DSS (N, N) of along_1 D1 + along_2 D2, with weighted coefficients (E, np, np)."""
    d, nodes = mesh.derivative, mesh.nodes
    values = np.stack([along_1[..., None] * d[:, None], along_2[..., None] * d])
    lines = nodes.swapaxes(1, 2)[:, None], nodes[:, :, None]
    columns = np.stack([np.broadcast_to(line, values.shape[1:]) for line in lines])
    index = (np.broadcast_to(nodes[..., None], values.shape).ravel(), columns.ravel())
    found = scipy.sparse.coo_array((values.ravel(), index), (mesh.size, mesh.size))
    return _over_area(mesh, found.tocsr())


def _over_area(mesh: Mesh, matrix: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Return the matrix after dividing its rows by the nodal areas in place."""
    matrix.data *= np.repeat((1.0 / mesh.area).astype(matrix.dtype), np.diff(matrix.indptr))
    return matrix


Lines = tuple[NDArray[np.int32], Array]
"""Node numbers (..., np) line by line, and factors (2, ..., np) of D along the line."""


def column_squares(mesh: Mesh, weight: Array) -> Array:
    """Return (N,) sums over nodes m of weight_m |G_mn|^2, G the gradient with both components.

    An off-diagonal entry of the gradient after DSS belongs to one line of nodes: a line through an
    element, or an edge, where the entries of the elements on its two sides add up. So entries can
    be squared line by line, without the matrix; diagonal entries depend on all elements of a node.

    `weight` has shape (N,); the unit of the result is that of `weight` per m2.
    """
    b, weights = mesh.basis, mesh.quadrature
    first = weights * np.stack([b[..., 1, 1], -b[..., 1, 0]])
    second = weights * np.stack([-b[..., 0, 1], b[..., 0, 0]])
    # all lines of the elements in both directions, before summation
    across = [(mesh.nodes.swapaxes(1, 2), first.swapaxes(2, 3)), (mesh.nodes, second)]
    inside = [(nodes[:, 1:-1], factors[:, :, 1:-1]) for nodes, factors in across]
    others = (mesh.derivative * (1.0 - np.eye(mesh.np))) ** 2
    total = weight * _own(mesh, across)
    weight = weight / mesh.area**2
    for nodes, factors in (*inside, _edges(across)):
        squares = weight[nodes] * np.sum(factors**2, axis=0)
        total += np.bincount(nodes.ravel(), (squares @ others).ravel(), mesh.size)
    return total


def _edges(across: list[Lines]) -> Lines:
    """Return the edges (edges, np), each the sum of two elements, from the end of lower number."""
    nodes = np.concatenate([nodes[:, [0, -1]].reshape(-1, nodes.shape[-1]) for nodes, _ in across])
    ends = [factors[:, :, [0, -1]].reshape(2, -1, factors.shape[-1]) for _, factors in across]
    factors = np.concatenate(ends, axis=1)
    back = nodes[:, 0] > nodes[:, -1]
    nodes[back] = nodes[back, ::-1]
    factors[:, back] = -factors[:, back, ::-1]  # the derivative changes its sign
    first, second = np.lexsort((nodes[:, -1], nodes[:, 0])).reshape(-1, 2).T
    return nodes[first], factors[:, first] + factors[:, second]


def _own(mesh: Mesh, across: list[Lines]) -> Array:
    """Return the squares (N,) of the diagonal entries of both components [m-2]."""
    own = np.diagonal(mesh.derivative)
    (_, first), (_, second) = across
    entries = first.swapaxes(2, 3) * own[:, None] + second * own
    east, north = (assemble(mesh, component) for component in entries)
    return east**2 + north**2


class Probing:
    """Finds a sparse matrix from sums of columns that share no row (Curtis, Powell & Reid 1974)."""

    def __init__(self, mesh: Mesh) -> None:
        ones = np.ones(mesh.nodes.size, dtype=np.int8)
        rows = np.repeat(np.arange(mesh.elements), mesh.np**2)
        entries = ones, (rows, mesh.nodes.ravel())
        elements = scipy.sparse.csr_array(entries, (mesh.elements, mesh.size))
        near = (elements.T.astype(bool) @ elements.astype(bool)).tocsc()
        self.colours = _coloured((near @ near).tocsr())
        """(N,) colour of each node's columns."""
        columns = np.repeat(np.arange(mesh.size, dtype=np.int32), np.diff(near.indptr))
        order = np.argsort(self.colours[columns], kind="stable")
        self._rows, self._columns = near.indices[order], columns[order]
        self._ends = np.concatenate([[0], np.cumsum(np.bincount(self.colours[columns]))])

    def matrix(self, product: Callable[[Array], Array], fields: int) -> scipy.sparse.csr_array:
        """Return the matrix of `product` on (fields N,) that only couples nodes of an element."""
        n = self.colours.size
        found: list[tuple[Array, Int32, Int32]] = []
        for colour in range(self._ends.size - 1):
            part = slice(*self._ends[colour : colour + 2])
            rows = self._rows[part] + n * np.arange(fields, dtype=np.int32)[:, None]
            mine = self.colours == colour
            for field in range(fields):
                direction = np.zeros((fields, n))
                direction[field, mine] = 1.0
                values = product(direction.ravel())[rows]
                columns = np.broadcast_to(self._columns[part] + n * field, rows.shape)
                there = values != 0.0
                found.append((values[there], rows[there], columns[there]))
        values, rows, columns = (np.concatenate(each) for each in zip(*found, strict=True))
        return scipy.sparse.coo_array((values, (rows, columns)), (fields * n, fields * n)).tocsr()


def _coloured(conflicts: scipy.sparse.csr_array) -> Int32:
    """Return (N,) colours, each the least colour that no neighbour coloured before has."""
    colours = np.full(conflicts.shape[0], -1, dtype=np.int32)
    for node, (begin, end) in enumerate(zip(conflicts.indptr, conflicts.indptr[1:], strict=False)):
        taken = np.bincount(colours[conflicts.indices[begin:end]] + 1, minlength=2)
        free = np.flatnonzero(taken[1:] == 0)
        colours[node] = free[0] if free.size else taken.size - 1
    return colours
