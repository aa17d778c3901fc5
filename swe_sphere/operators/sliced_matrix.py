"""Sparse matrices on the device, a row in each SIMD lane, and the vectors they act on."""

from __future__ import annotations

import numpy as np
import scipy
import warp as wp

from swe_sphere.kernels.coarse import sweep_kernel
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.field import Field
from swe_sphere.operators.launch import Launcher


class SlicedMatrix:
    """A matrix in the number type and the lanes of a mesh, for vectors made by `vector`.

    Each group of `lanes` rows has its diagonals: the registers of a vector, beginning anywhere,
    that hold an entry of one of its rows in the lane of that row.  Nothing is gathered lane by
    lane, which takes ten times as long; numberings that follow the elements have few diagonals.
    """

    def __init__(self, mesh: DeviceMesh, launch: Launcher, matrix: scipy.sparse.csr_array) -> None:
        self._launch, self._kernel = launch, sweep_kernel(mesh.real, mesh.shape)
        launch.load(self._kernel)
        rows = np.arange(matrix.shape[0], dtype=np.int32)
        group, lane = np.divmod(np.repeat(rows, np.diff(matrix.indptr)), mesh.lanes)
        width, self._groups = matrix.shape[1] + mesh.lanes, -(-matrix.shape[0] // mesh.lanes)
        place = group * np.int64(width)
        place += matrix.indices + (mesh.lanes - 1) - lane
        del group  # entries are many, and set-ups are when most memory is taken
        diagonals, slot = np.unique(place, return_inverse=True)
        values = np.zeros((diagonals.size, mesh.lanes), mesh.numpy_real)
        values[slot, lane] = matrix.data
        starts = np.searchsorted(diagonals, np.arange(self._groups + 1) * width)
        self._entries = (
            wp.array(starts, dtype=wp.int32, device=mesh.device),
            wp.array(diagonals % width - (mesh.lanes - 1), dtype=wp.int32, device=mesh.device),
            mesh.registers(values),
        )

    def sweep(
        self,
        coefficients: tuple[float, float, float],
        per_diagonal: wp.array,
        r: Field,
        directions: tuple[Field, Field],
        before: Field,
        x: Field,
    ) -> None:
        """r -= M d; new = keep d + take r/diagonal; x = before + beta new, with directions d, new.

        coefficients: keep, take and beta, as `chebyshev_coefficients` has them.
        """
        d, new = directions
        self._launch(
            self._kernel, self._groups, *self._entries, per_diagonal, *coefficients,
            d.flat, d.values, r.values, before.values, new.values, x.values,
        )  # fmt: skip


def vector(mesh: DeviceMesh, size: int) -> Field:
    """Zeros (size,) for `SlicedMatrix`, in whole registers, with one before and one behind."""
    values = mesh.registers(np.zeros((-(-size // mesh.lanes) + 2, mesh.lanes)))[1:-1]
    return Field(values, mesh.flat(values))
