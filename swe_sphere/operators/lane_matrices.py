"""Sparse matrices on the device with one row per SIMD lane, and the vectors they act on."""

from __future__ import annotations  # scipy.sparse is loaded where it is used

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels import Register
from swe_sphere.kernels.coarse import coarse_step, tall_parts, tall_product, tall_total
from swe_sphere.operators.device_mesh import DeviceMesh, Field


def vector(mesh: DeviceMesh, size: int) -> Field:
    """Return zeros (size,) in whole registers, with one register before and one behind."""
    return mesh.field(mesh.registers(np.zeros((-(-size // mesh.lanes) + 2, mesh.lanes)))[1:-1])


def _grouped(
    mesh: DeviceMesh, matrix: scipy.sparse.csr_array, shifted: bool
) -> tuple[wp.array, NDArray[np.int64], Array]:
    """Return the first entry of each group of `lanes` rows, then columns and lanes of entries.

    A group has one register for each column with an entry in the group. If `shifted`, columns are
    counted from the lane of the row, so that a diagonal of the group is one column.
    """
    (rows, columns), lanes, offsets = matrix.shape, mesh.lanes, matrix.indptr
    numbers, behind = matrix.indices, lanes - 1 if shifted else 0
    if shifted:
        lane = np.arange(rows, dtype=np.int32) % lanes
        numbers = numbers + np.repeat(behind - lane, np.diff(offsets))
    ends = np.append(offsets, np.full(-rows % lanes, offsets[-1]))
    shape = ends.size - 1, columns + behind
    blocks = scipy.sparse.csr_array((matrix.data, numbers, ends), shape).tobsr((lanes, 1))
    blocks.sort_indices()
    values = blocks.data[..., 0] if blocks.indices.size else np.zeros((1, lanes))
    starts = wp.array(blocks.indptr, dtype=wp.int32, device=mesh.device)
    return starts, blocks.indices - behind, values


MOST = 2**15 - 1
"""Largest entry of a `SlicedMatrix` in its unit."""


class SlicedMatrix:
    """A matrix in the lanes of a mesh, for vectors built by `vector`.

    Its entries are multiples of `unit`, from -MOST to MOST, in 16 bits: a step reads little else.

    Each group of `lanes` rows stores one register for each diagonal on which it has an entry. This
    register multiplies consecutive numbers of a vector, so that no numbers are gathered lane by
    lane, which takes longer; numberings that follow lines of the mesh have few diagonals.
    """

    def __init__(self, mesh: DeviceMesh, matrix: scipy.sparse.csr_array, unit: float) -> None:
        """Round the entries of a matrix to multiples of `unit`."""
        register = Register(mesh.real, mesh.lanes, whole=False)
        self._launch, (self._kernel,) = mesh.launch, mesh.launch.compile(register, coarse_step)
        self._groups = -(-matrix.shape[0] // mesh.lanes)
        starts, diagonals, values = _grouped(mesh, matrix, shifted=True)
        columns = wp.array(diagonals, dtype=wp.int32, device=mesh.device)
        rounded = np.rint(values / unit).astype(np.int16).ravel()
        self._entries = starts, columns, wp.array(rounded, device=mesh.device), unit

    def chebyshev_step(
        self, size: float, per_diagonal: Field, b: Field, x: Field, after: Field
    ) -> None:
        """Set after = x + size (b/diagonal - M x); `after` is not x."""
        vectors = b.values, x.flat, x.values, after.values
        inputs = *self._entries, per_diagonal.values, size, *vectors
        self._launch(self._kernel, self._groups, *inputs)


class TallMatrix:
    """A matrix of many rows and few columns in lanes; rows side by side share columns.

    Each group of `lanes` rows has one register for each column in which one of them has an entry: a
    `SlicedMatrix` would have one for each lane and column.
    """

    def __init__(self, mesh: DeviceMesh, matrix: scipy.sparse.csr_array) -> None:
        self._launch, register = mesh.launch, Register(mesh.real, mesh.lanes, whole=False)
        kernels = mesh.launch.compile(register, tall_product, tall_parts, tall_total)
        self._product, self._part, self._total = kernels
        rows, self._few = matrix.shape
        self._groups = -(-rows // mesh.lanes)
        self._at, column, values = _grouped(mesh, matrix, shifted=False)
        self._values = mesh.registers(values)
        ends = np.searchsorted(np.sort(column), np.arange(self._few + 1))
        self._columns, self._ends, self._listed = (
            wp.array(numbers, dtype=wp.int32, device=mesh.device)
            for numbers in (column, ends, np.argsort(column, kind="stable"))
        )
        self._parts = wp.zeros(column.size, dtype=mesh.real, device=mesh.device)

    def __call__(self, x: Field, out: Field) -> None:
        """Set out = M x."""
        entries = self._at, self._columns, self._values
        self._launch(self._product, self._groups, *entries, x.flat, out.values)

    def transposed(self, y: Field, out: Field) -> None:
        """Set out = M^T y; y may be longer than M has rows."""
        self._launch(self._part, self._groups, self._at, self._values, y.values, self._parts)
        self._launch(self._total, self._few, self._ends, self._listed, self._parts, out.flat)
