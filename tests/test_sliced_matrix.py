"""Sparse matrices on the device against scipy's."""

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp

from swe_sphere.mesh import Mesh
from swe_sphere.operators import DeviceMesh, Launcher
from swe_sphere.operators.field import Field
from swe_sphere.operators.sliced_matrix import SlicedMatrix, vector

ROWS, COLUMNS = 61, 45


@pytest.fixture(scope="module", params=["element", "node"])
def mesh(request) -> DeviceMesh:
    return DeviceMesh(Mesh.build(1, 3), "cpu", wp.float32, request.param)


def dense(rows: int, columns: int) -> np.ndarray:
    """Entries in the corners, diagonals, a full row and empty ones."""
    rng = np.random.default_rng(1)
    matrix = rng.standard_normal((rows, columns)) * (rng.random((rows, columns)) < 0.1)
    matrix[0, -1] = matrix[-1, 0] = matrix[-1, -1] = 2.0
    matrix[20], matrix[30:50] = rng.standard_normal(columns), 0.0
    return matrix


def filled(mesh: DeviceMesh, values: np.ndarray) -> Field:
    made = vector(mesh, values.size)
    mesh.write(values, made.flat)
    return made


def test_products(mesh: DeviceMesh) -> None:
    matrix, rng = dense(ROWS, COLUMNS), np.random.default_rng(2)
    x, y = rng.standard_normal(COLUMNS), rng.standard_normal(ROWS)
    made = SlicedMatrix(mesh, Launcher("cpu"), sp.csr_array(matrix))
    source, out = filled(mesh, x), filled(mesh, y)
    made(source, out, add=True)
    assert out.flat.numpy()[:ROWS] == pytest.approx(y + matrix @ x, abs=1e-5)
    made(source, out)
    assert out.flat.numpy()[:ROWS] == pytest.approx(matrix @ x, abs=1e-5)
    assert not out.flat.numpy()[ROWS:].any()


def test_sweep(mesh: DeviceMesh) -> None:
    rng = np.random.default_rng(3)
    matrix = sp.csr_array(dense(ROWS, ROWS))
    per_diagonal, r, d, before = rng.standard_normal((4, ROWS))
    vectors = [filled(mesh, values) for values in (per_diagonal, r, d, before)]
    new, x = vector(mesh, ROWS), vector(mesh, ROWS)
    scale, residual, direction, start = vectors
    made = SlicedMatrix(mesh, Launcher("cpu"), matrix)
    made.sweep((0.3, 0.7, 1.2), scale.values, residual, (direction, new), start, x)
    left = r - matrix @ d
    step = 0.3 * d + 0.7 * per_diagonal * left
    for found, expected in ((residual, left), (new, step), (x, before + 1.2 * step)):
        assert found.flat.numpy()[:ROWS] == pytest.approx(expected, abs=1e-5)
