"""Sparse factors of the whole Jacobian: its matrix, the order of nodes, Krylov counts."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from support import make_scene, random_state, tangent

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import dissection_order
from swe_sphere.operators.sparse import Probing
from swe_sphere.planet import HOUR
from swe_sphere.solvers.krylov import FlexibleGMRES
from swe_sphere.solvers.preconditioners import make_preconditioner
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers import get_stepper
from swe_sphere.steppers.stage_solver import energy_weights
from swe_sphere.testcases import get_scene

FLOW = make_scene("advection", "pressure", "rotation", "drag", "relaxation")


@pytest.mark.thorough
def test_probing_finds_the_matrix_of_all_effects_of_one_element() -> None:
    """Against one product for each column."""
    model = Model(Mesh.build(2, 3, stretch=1.4), FLOW)
    state = random_state(model)
    columns = np.stack([tangent(model, state, unit) for unit in np.eye(model.size)], axis=1)
    probing = Probing(model.mesh)
    found = probing.matrix(lambda d: tangent(model, state, d), 3)
    assert np.allclose(found.toarray(), columns, rtol=0.0, atol=1e-14 * np.abs(columns).max())
    assert np.count_nonzero(columns) == found.nnz
    assert probing.colours.max() < model.mesh.size // 2


@pytest.mark.parametrize("np_", [3, 4])
def test_factors_in_the_order_of_dissection_are_small(np_: int) -> None:
    """A third of those in the order of the mesh, for a matrix that couples nodes of one element."""
    mesh = Mesh.build(6, np_, stretch=1.5)
    order = dissection_order(mesh)
    assert np.array_equal(np.sort(order), np.arange(mesh.size))
    nodes = mesh.nodes.reshape(mesh.elements, -1)
    rows, columns = (
        np.broadcast_to(n, (*nodes.shape, np_**2)) for n in (nodes[..., None], nodes[:, None])
    )
    matrix = sp.coo_array((np.full(rows.size, -1e-3), (rows.ravel(), columns.ravel()))).tocsr()
    matrix += sp.eye_array(mesh.size)
    fill = [_fill(matrix[how][:, how]) for how in (order, np.arange(mesh.size))]
    assert fill[0] < 0.35 * fill[1]


def _fill(matrix: sp.csr_array) -> int:
    symmetric = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options=symmetric).nnz


@pytest.fixture(scope="module")
def jet() -> tuple[Model, np.ndarray]:
    """A mesh of long elements, a fast jet, and a state some hours on."""
    model = Model(Mesh.build(4, 4), get_scene("galewsky"))
    stepper = get_stepper("rk4")(model, 600.0)
    stepper.start(model.initial_state())
    for _ in range(6):
        stepper.step()
    return model, stepper.state


@pytest.mark.parametrize("courant", [5.0, 20.0, 80.0])
def test_counts_do_not_grow_with_the_advective_courant_number(jet, courant: float) -> None:
    """Also with factors of the state an hour before; without advection they do grow."""
    model, state = jet
    mesh, n = model.mesh, model.mesh.size
    u, v, _ = state.numpy().reshape(3, n)
    tau = 0.5 * courant / float((np.hypot(u, v) / np.sqrt(mesh.area)).max())
    fresh, kept = (_iterations(model, state, tau, made) for made in (state, model.initial_state()))
    assert fresh <= 2
    assert kept <= 15
    if courant >= 20.0:
        assert _iterations(model, state, tau, state, "helmholtz-direct") > 30


def _iterations(model, state, tau, made, name="jacobian-direct") -> int:
    """Krylov iterations for (I - tau J) d = tau F to 1e-2, prepared at the state `made`."""
    space = VectorSpace(energy_weights(model))
    preconditioner, jacobian = make_preconditioner(name, model), model.jacobian().update(state, 0.0)
    preconditioner.setup(made, tau)

    def operator(d, out) -> None:
        jacobian(d, out)
        space.axpby(1.0, d, -tau, out)

    rhs, d = space.zeros(), space.zeros()
    model.tendency(state, 0.0, rhs)
    return (
        FlexibleGMRES(space, 100)
        .solve(operator, rhs, d, preconditioner, rtol=1e-2, max_iterations=100)
        .iterations
    )


def test_a_steady_flow_is_stepped_over_five_days_at_once() -> None:
    model = Model(Mesh.build(6, 4), get_scene("williamson2"))
    stepper = get_stepper("tr-bdf2")(model, 120.0 * HOUR, preconditioner="jacobian-direct")
    start = model.initial_state()
    stepper.start(start)
    stepper.step()
    assert stepper.counters["rejected_steps"] == 0
    assert stepper.counters["krylov_iterations"] <= 8
    assert stepper.space.norm(stepper.state) == pytest.approx(stepper.space.norm(start), rel=1e-4)


@pytest.mark.thorough
def test_factors_beyond_all_memory_are_refused(monkeypatch) -> None:
    monkeypatch.setattr("swe_sphere.solvers.preconditioners.preconditioner.LARGEST_MEMORY", 1e5)
    with pytest.raises(ConfigError, match="choose the preconditioner helmholtz instead"):
        make_preconditioner("jacobian-direct", Model(Mesh.build(2, 4), FLOW))
