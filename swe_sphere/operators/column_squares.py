"""Column sums of the squared gradient, without the matrix.

An entry of the DSS'd gradient off its diagonal belongs to one line of nodes: a line through an
element, or an edge, where those of the elements on its two sides add up.  So entries can be squared
line by line; only the own entries of the nodes take in all elements around.
"""

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.operators.diagnose import assemble

Lines = tuple[NDArray[np.int32], Array]
"""Node numbers (..., np) line by line, and what D of the line is multiplied by, (2, ..., np)."""


def column_squares(mesh: Mesh, weight: Array) -> Array:
    """(N,) sum over the nodes m of weight_m |G_mn|^2, G the gradient with both its components.

    `weight` (N,); the result is in its unit over m2.
    """
    across = [_across(mesh, direction) for direction in (1, 2)]
    inside = [(nodes[:, 1:-1], factors[:, :, 1:-1]) for nodes, factors in across]
    others = (mesh.derivative * (1.0 - np.eye(mesh.np))) ** 2
    total = weight * _own(mesh, across)
    weight = weight / mesh.area**2
    for nodes, factors in (*inside, _edges(across)):
        squares = weight[nodes] * np.sum(factors**2, axis=0)
        total += np.bincount(nodes.ravel(), (squares @ others).ravel(), mesh.size)
    return total


def _across(mesh: Mesh, direction: int) -> Lines:
    """All lines of the elements (E, np, np) in that direction, not yet added up."""
    b, weights = mesh.basis, mesh.quadrature
    if direction == 2:
        return mesh.nodes, weights * np.stack([-b[..., 0, 1], b[..., 0, 0]])
    factors = weights * np.stack([b[..., 1, 1], -b[..., 1, 0]])
    return mesh.nodes.swapaxes(1, 2), factors.swapaxes(2, 3)


def _edges(across: list[Lines]) -> Lines:
    """The edges (edges, np), each the sum of two elements; from its end of the lower number."""
    nodes = np.concatenate([nodes[:, [0, -1]].reshape(-1, nodes.shape[-1]) for nodes, _ in across])
    factors = np.concatenate(
        [factors[:, :, [0, -1]].reshape(2, -1, factors.shape[-1]) for _, factors in across], axis=1
    )
    back = nodes[:, 0] > nodes[:, -1]
    nodes[back] = nodes[back, ::-1]
    factors[:, back] = -factors[:, back, ::-1]  # the derivative changes its sign
    first, second = np.lexsort((nodes[:, -1], nodes[:, 0])).reshape(-1, 2).T
    return nodes[first], factors[:, first] + factors[:, second]


def _own(mesh: Mesh, across: list[Lines]) -> Array:
    """(N,) squares of the entries on the diagonals of both components [m-2]."""
    own = np.diagonal(mesh.derivative)
    (_, first), (_, second) = across
    entries = first.swapaxes(2, 3) * own[:, None] + second * own
    east, north = (assemble(mesh, component) for component in entries)
    return east**2 + north**2
