"""The multilevel cycle: what it leaves of an error."""

import numpy as np
import pytest
import scipy.sparse.linalg as sla

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.solvers.preconditioners import make_preconditioner
from swe_sphere.testcases import get_scene


@pytest.mark.parametrize(
    ("ne", "np_", "tau"),
    [(16, 3, 3000.0), (11, 4, 3000.0), (8, 5, 3000.0), (5, 8, 3000.0), (20, 4, 6000.0),
     (15, 8, 4000.0)],
)  # fmt: skip
def test_cycle_reduces_every_error(ne: int, np_: int, tau: float) -> None:
    """An error that it left alone would be one that no Krylov method removes.

    In long steps on fine meshes these are long waves of computational modes.
    """
    model = Model(Mesh.build(ne, np_), get_scene("williamson5"))
    made = make_preconditioner("helmholtz", model)
    made.setup(model.initial_state(), tau)
    operator = made.operator
    d, b, x = (operator.field() for _ in range(3))

    def left(error: np.ndarray) -> np.ndarray:
        operator.put(error.ravel(), d)
        operator.apply(d, b)
        made.solve(b, x)
        return error.ravel() - operator.fetch(x)

    size = (model.mesh.size, model.mesh.size)
    of_cycle = sla.LinearOperator(size, matvec=left, dtype=np.float64)
    start = np.random.default_rng(0).standard_normal(model.mesh.size)
    largest = sla.eigs(of_cycle, 1, v0=start, tol=3e-2, return_eigenvectors=False)
    assert np.abs(largest).max() < 0.7
