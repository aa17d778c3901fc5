"""Sparse matrices on the device against scipy's."""

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp

from swe_sphere.mesh import Mesh
from swe_sphere.operators import DeviceMesh
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.lane_matrices import SlicedMatrix, TallMatrix, vector

ROWS, COLUMNS = 61, 45


@pytest.fixture(scope="module", params=["element", "node"])
def mesh(request) -> DeviceMesh:
    return DeviceMesh(Mesh.build(1, 3), "cpu", wp.float32, request.param)


def dense(rows: int, columns: int) -> np.ndarray:
    """Entries in the corners, here and there, a full row and empty ones."""
    rng = np.random.default_rng(1)
    matrix = rng.standard_normal((rows, columns)) * (rng.random((rows, columns)) < 0.1)
    matrix[0, -1] = matrix[-1, 0] = matrix[-1, -1] = 2.0
    matrix[20], matrix[30:50] = rng.standard_normal(columns), 0.0
    return matrix


def filled(mesh: DeviceMesh, values: np.ndarray) -> Field:
    made = vector(mesh, values.size)
    mesh.write(values, made.flat)
    return made


def test_step_over_rows(mesh: DeviceMesh) -> None:
    rng = np.random.default_rng(3)
    unit = 1e-4
    matrix = sp.csr_array(np.rint(dense(ROWS, ROWS) / unit) * unit)
    given = per_diagonal, b, x = rng.standard_normal((3, ROWS))
    fields, after = [filled(mesh, values) for values in given], vector(mesh, ROWS)
    SlicedMatrix(mesh, matrix, unit).chebyshev_step(0.7, *fields, after)
    expected = x + 0.7 * (per_diagonal * b - matrix @ x)
    for found, values in zip((*fields, after), (*given, expected), strict=True):
        assert found.flat.numpy()[:ROWS] == pytest.approx(values, abs=1e-5)


def test_tall_matrix_and_its_transpose(mesh: DeviceMesh) -> None:
    """Of a vector that is longer than the matrix, what is behind does not count."""
    few, rng = 7, np.random.default_rng(4)
    matrix = dense(ROWS, COLUMNS)[:, :few]
    x, y = rng.standard_normal(few), rng.standard_normal(ROWS + 50)
    made = TallMatrix(mesh, sp.csr_array(matrix))
    source, out, back = filled(mesh, x), filled(mesh, y[:ROWS]), vector(mesh, few)
    made(source, out)
    assert out.flat.numpy()[:ROWS] == pytest.approx(matrix @ x, abs=1e-5)
    assert not out.flat.numpy()[ROWS:].any()
    made.transposed(filled(mesh, y), back)
    assert back.flat.numpy()[:few] == pytest.approx(y[:ROWS] @ matrix, abs=1e-5)
