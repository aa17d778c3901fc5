"""Coarse spaces for the smooth and for the spurious waves of collocated spectral elements.

Along a line of elements the assembled gradient is zero not only for constants: the polynomial
P_{np-1} has no slope at the interior GLL nodes, and opposite slopes on the two sides of an element
boundary when its sign alternates from element to element, which average to zero. Times a slowly
varying envelope these patterns are slow waves too, however fine the mesh: no smoother damps them
and compact Laplacians do not contain them. In addition to the bilinear hats for the smooth waves
there is therefore a coarse function hat x pattern along each of the two directions, and one along
both: four spaces, nearly orthogonal to each other.
"""

from __future__ import annotations  # scipy.sparse is loaded where it is used

import numpy as np
import scipy
from numpy.polynomial import legendre
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.operators.sparse import ElementSpace

Int = NDArray[np.int32]
CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))
"""Element corners (end along xi1, end along xi2)."""


def coarse_spaces(mesh: Mesh) -> list[ElementSpace]:
    """Return functions of V = 6 ne^2 + 2 vertices: smooth, both patterns, each pattern.

    The two directions are paired across element boundaries around each vertex. At the eight cube
    corners, where three elements meet, they cannot be distinguished: there the third space contains
    both and the fourth has no function (V - 8 in all).
    """
    ends = np.array(CORNERS) * (mesh.np - 1)
    _, number = np.unique(mesh.nodes[:, ends[:, 0], ends[:, 1]], return_inverse=True)
    vertices = number.reshape(mesh.elements, 4).astype(np.int32)
    hat = 0.5 * (1.0 - mesh.gll_points)
    pattern = hat * legendre.legval(-mesh.gll_points, np.eye(mesh.np)[-1])
    along_either = np.concatenate([_products(pattern, hat), _products(hat, pattern)], axis=1)
    turned, corner = _turned(vertices), np.bincount(vertices.ravel())[vertices] == 3
    renumbered = np.cumsum(np.bincount(vertices.ravel()) != 3, dtype=np.int32) - 1
    belongs = np.concatenate([~turned | corner, turned | corner], axis=1)
    numbers, fewer = np.tile(vertices, 2), np.tile(renumbered[vertices], 2)
    return [
        smooth_functions(mesh),
        ElementSpace(_products(pattern, pattern), vertices),
        ElementSpace(along_either, np.where(belongs, numbers, -1)),
        ElementSpace(along_either, np.where(belongs, -1, fewer)),
    ]


def smooth_functions(mesh: Mesh) -> ElementSpace:
    """Return bilinear hats for the smooth waves on the cells between about every third GLL node.

    One hat per element would burden the smoother too much if an edge has more than four nodes.
    """
    cells = -(-(mesh.np - 1) // 3)
    cells += mesh.np % 2 == 0 and cells % 2 == 0  # there is no middle node to separate them
    targets = np.linspace(-1.0, 1.0, cells + 1)
    kept = np.abs(mesh.gll_points[:, None] - targets).argmin(axis=0)
    kept[cells // 2 + 1 :] = mesh.np - 1 - kept[: cells - cells // 2][::-1]
    hats = np.stack(
        [np.interp(mesh.gll_points, mesh.gll_points[kept], h) for h in np.eye(cells + 1)]
    )
    hats = 0.5 * (hats + hats[::-1, ::-1])  # the same bits from either end
    values = np.einsum("pi,qj->ijpq", hats, hats).reshape(mesh.np**2, -1)
    corners = mesh.nodes[:, kept][:, :, kept].reshape(mesh.elements, -1)
    _, number = np.unique(corners, return_inverse=True)
    return ElementSpace(values, number.reshape(corners.shape).astype(np.int32))


def _products(along_1: Array, along_2: Array) -> Array:
    """Return the products (np*np, 4) of two functions of the distance from each corner."""
    sides = [np.outer(along_1[:: 1 - 2 * p], along_2[:: 1 - 2 * q]).ravel() for p, q in CORNERS]
    return np.stack(sides, axis=1)


def _turned(vertices: Int) -> NDArray[np.bool_]:
    """Return (E, 4) flags: direction 1 of the element is the second one of its corner's vertex.

    The first direction of a vertex is direction 1 of the first element there. Around a vertex of
    four elements the directions of the edges alternate, so the anticlockwise order of the two
    changes from an element to its neighbour; neighbours share an edge, given by its far end. All
    elements are right-handed: at a corner with equal ends direction 1 comes first.
    """
    far_1, far_2 = vertices[:, [2, 3, 0, 1]].ravel(), vertices[:, [1, 0, 3, 2]].ravel()
    _, first, inverse = np.unique(vertices.ravel(), return_index=True, return_inverse=True)
    first = first[inverse]
    leads = np.tile([p == q for p, q in CORNERS], len(vertices))
    neighbour = np.zeros(leads.size, dtype=bool)
    for mine in (far_1, far_2):
        neighbour |= (mine == far_1[first]) | (mine == far_2[first])
    turned: NDArray[np.bool_] = np.where(neighbour, leads == leads[first], leads != leads[first])
    turned[first] = False
    return turned.reshape(-1, 4)


def interpolation(mesh: Mesh, space: ElementSpace) -> scipy.sparse.csr_matrix:
    """Return the nodal values (N, V) of the functions.

    Both elements at a boundary node give it the same value.
    """
    rows = mesh.nodes.reshape(mesh.elements, -1)
    total = space.matrix(rows, space.values).tocsr()
    total.data *= np.repeat(1.0 / np.diff(mesh.gather_offsets), np.diff(total.indptr))
    return total
