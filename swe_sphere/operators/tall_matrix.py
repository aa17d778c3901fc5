"""Sparse matrices of many rows and few columns, of which rows that stand together share some."""

from __future__ import annotations

import numpy as np
import scipy
import warp as wp

from swe_sphere.kernels.coarse import tall_kernels
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.field import Field
from swe_sphere.operators.launch import Launcher


class TallMatrix:
    """In the number type and the lanes of a mesh, for vectors made by `sliced_matrix.vector`.

    Each group of `lanes` rows has a register for each column in which one of them has an entry:
    a `SlicedMatrix` would have one for each lane and column.
    """

    def __init__(self, mesh: DeviceMesh, launch: Launcher, matrix: scipy.sparse.csr_array) -> None:
        self._launch, self._kernels = launch, tall_kernels(mesh.real, mesh.shape)
        launch.load(self._kernels.product, self._kernels.parts, self._kernels.total)
        (rows, self._few), lanes = matrix.shape, mesh.lanes
        self._groups = -(-rows // lanes)
        group, lane = np.divmod(np.repeat(np.arange(rows), np.diff(matrix.indptr)), lanes)
        pairs, slot = np.unique(group * self._few + matrix.indices, return_inverse=True)
        values = np.zeros((max(pairs.size, 1), lanes), mesh.numpy_real)
        values[slot, lane] = matrix.data
        of_group, column = np.divmod(pairs, self._few)
        self._at, self._columns, self._ends, self._listed = (
            wp.array(numbers, dtype=wp.int32, device=mesh.device)
            for numbers in (
                np.searchsorted(of_group, np.arange(self._groups + 1)),
                column,
                np.searchsorted(np.sort(column), np.arange(self._few + 1)),
                np.argsort(column, kind="stable"),
            )
        )
        self._values = mesh.registers(values)
        self._parts = wp.zeros(pairs.size, dtype=mesh.real, device=mesh.device)

    def __call__(self, x: Field, out: Field, add: bool = False) -> None:
        """out = M x, or out + M x."""
        self._launch(
            self._kernels.product, self._groups, self._at, self._columns, self._values, x.flat,
            int(add), out.values,
        )  # fmt: skip

    def transposed(self, y: Field, out: Field) -> None:
        """out = M' y; y may be longer than M has rows."""
        kernels, parts = self._kernels, self._parts
        self._launch(kernels.parts, self._groups, self._at, self._values, y.values, parts)
        self._launch(kernels.total, self._few, self._ends, self._listed, parts, out.flat)
