"""The matrix of an operator that couples nodes of one element alone, from products with it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh

Int = NDArray[np.int32]


class Probing:
    """Columns that meet in no row are found by one product (Curtis, Powell & Reid 1974)."""

    def __init__(self, mesh: Mesh) -> None:
        ones = np.ones(mesh.nodes.size, dtype=np.int8)
        rows = np.repeat(np.arange(mesh.elements), mesh.np**2)
        elements = scipy.sparse.csr_array(
            (ones, (rows, mesh.nodes.ravel())), (mesh.elements, mesh.size)
        )
        near = (elements.T.astype(bool) @ elements.astype(bool)).tocsc()
        self.colours = _coloured((near @ near).tocsr())
        """(N,) colour of each node's columns."""
        columns = np.repeat(np.arange(mesh.size, dtype=np.int32), np.diff(near.indptr))
        order = np.argsort(self.colours[columns], kind="stable")
        self._rows, self._columns = near.indices[order], columns[order]
        counts = np.bincount(self.colours[columns])
        self._ends = np.concatenate([[0], np.cumsum(counts)])

    def matrix(self, product: Callable[[Array], Array], fields: int) -> scipy.sparse.csr_array:
        """(fields N, fields N) matrix of `product`, which takes and returns (fields N,)."""
        n = self.colours.size
        found: list[tuple[Array, Int, Int]] = []
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


def _coloured(conflicts: scipy.sparse.csr_array) -> Int:
    """(N,) the least colour that no neighbour before has."""
    colours = np.full(conflicts.shape[0], -1, dtype=np.int32)
    for node, (begin, end) in enumerate(zip(conflicts.indptr, conflicts.indptr[1:], strict=False)):
        taken = np.bincount(colours[conflicts.indices[begin:end]] + 1, minlength=2)
        free = np.flatnonzero(taken[1:] == 0)
        colours[node] = free[0] if free.size else taken.size - 1
    return colours
