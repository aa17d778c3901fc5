"""Implicit steppers: what their coefficients promise, and the order found on an unsteady flow."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support import IMPLICIT, advance, make_scene

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS, gauss
from swe_sphere.steppers.dirk import DiagonallyImplicit
from swe_sphere.testcases import get_scene

DIAGONAL = tuple(name for name, cls in STEPPERS.items() if issubclass(cls, DiagonallyImplicit))
TABLEAUS = (*DIAGONAL, "gauss-legendre")
EMBEDDED = {"tr-bdf2": 3, "esdirk4": 3}
DAMPING = ("implicit-euler", "tr-bdf2", "sdirk3", "esdirk4")
STEPS = {"bdf2": 450.0, "sdirk3": 900.0}
"""Longest step [s] from which the order shows, 1800 s for the others."""
HOURS = 2.0


def tableau(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A and b of a Runge-Kutta method."""
    if name == "gauss-legendre":
        return np.array(gauss.A), np.array(gauss.B)
    cls = STEPPERS[name]
    a = np.zeros((len(cls.b), len(cls.b)))
    for i, row in enumerate(cls.a):
        a[i, : len(row)] = row
    return a, np.array(cls.b)


def order_defect(a: np.ndarray, b: np.ndarray, order: int) -> float:
    """Largest error of the conditions of all rooted trees up to that order (Butcher)."""
    c, d = a.sum(axis=1), np.diag(a.sum(axis=1))
    conditions = [
        [b.sum() - 1.0],
        [b @ c - 1 / 2],
        [b @ c**2 - 1 / 3, b @ a @ c - 1 / 6],
        [b @ c**3 - 1 / 4, b @ d @ a @ c - 1 / 8, b @ a @ c**2 - 1 / 12, b @ a @ a @ c - 1 / 24],
    ]
    return max(abs(x) for group in conditions[:order] for x in group)


@pytest.mark.parametrize("name", TABLEAUS)
def test_tableaus_satisfy_their_order_conditions(name: str) -> None:
    """And none of the order above, except where that is all there is to check."""
    a, b = tableau(name)
    order = STEPPERS[name].order
    assert order_defect(a, b, order) <= 1e-13
    if order < 4:
        assert order_defect(a, b, order + 1) > 1e-3


@pytest.mark.parametrize("name", ["tr-bdf2", "esdirk4"])
def test_embedded_weights_satisfy_their_order_conditions(name: str) -> None:
    a, b = tableau(name)
    embedded = np.array(STEPPERS[name].embedded)
    assert order_defect(a, embedded, EMBEDDED[name]) <= 1e-13
    assert np.abs(b - embedded).max() > 1e-3


@pytest.mark.parametrize("name", DIAGONAL)
def test_amplification_of_the_fastest_waves(name: str) -> None:
    """R(oo) = 0 where the method is called L-stable, |R(iy)| = 1 where it does not damp."""
    a, b = tableau(name)

    def amplification(z: complex) -> complex:
        one = np.ones(len(b))
        return 1.0 + z * b @ np.linalg.solve(np.eye(len(b)) - z * a, one)

    along = np.array([abs(amplification(1j * y)) for y in np.logspace(-1, 6, 60)])
    assert along.max() <= 1.0 + 1e-9
    if name in DAMPING:
        assert abs(amplification(-1e9)) < 1e-7
        assert abs(amplification(1e9j)) < 1e-7
    else:
        np.testing.assert_allclose(along, 1.0, atol=1e-9)


@pytest.mark.parametrize("name", ["implicit-midpoint", "gauss-legendre"])
def test_symplectic_methods_keep_quadratic_invariants(name: str) -> None:
    a, b = tableau(name)
    product = b[:, None] * a
    assert np.abs(product + product.T - np.outer(b, b)).max() < 1e-15


def test_gauss_splits_its_matrix() -> None:
    """A = (LD) U with the lower triangle the preconditioner inverts; nodes are the row sums."""
    a = np.array(gauss.A)
    lower = np.array([[gauss.DIAGONAL[0], 0.0], [a[1, 0], gauss.DIAGONAL[1]]])
    upper = np.linalg.solve(lower, a)
    np.testing.assert_allclose(upper, [[1.0, upper[0, 1]], [0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(gauss.DIAGONAL, [1 / 4, 1 / 3], rtol=1e-15)
    np.testing.assert_allclose(a.sum(axis=1), gauss.C, rtol=1e-15)


@pytest.fixture(scope="module")
def moving():
    """The unsteady flow of Läuter, its state, and the state after two hours in tiny steps."""
    model = Model(Mesh.build(2, 4), get_scene("lauter"))
    state = model.initial_state()
    return model, state, advance("rk4", model, state, 30.0, HOURS * 3600.0).state.numpy()


@pytest.mark.parametrize("name", IMPLICIT)
@pytest.mark.thorough
def test_temporal_order_over_three_halvings(moving, name: str) -> None:
    model, state, reference = moving
    scale = np.repeat(np.abs(reference).reshape(3, -1).max(axis=1), model.mesh.size)
    weight = np.tile(model.mesh.area, 3) / scale**2
    errors = []
    for halving in range(4):
        dt = STEPS.get(name, 1800.0) / 2**halving
        last = advance(name, model, state, dt, HOURS * 3600.0, tolerance=1e-9)
        errors.append(np.sqrt(np.sum(weight * (last.state.numpy() - reference) ** 2)))
        assert last.counters["rejected_steps"] == 0
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(STEPPERS[name].order, abs=0.15)


@pytest.mark.parametrize("name", EMBEDDED)
def test_error_estimate_goes_with_the_lower_order(moving, name: str) -> None:
    """One step from the same state: an error of order p + 1, p the lower of the two orders."""
    model, state, _ = moving
    estimates = []
    for dt in (900.0, 450.0, 225.0):
        estimates.append(advance(name, model, state, dt, dt, tolerance=1e-9).error_estimate())
    order = min(STEPPERS[name].order, EMBEDDED[name])
    for coarse, fine in pairwise(estimates):
        assert np.log2(coarse / fine) == pytest.approx(order + 1.0, abs=0.25)


def test_error_estimate_is_near_the_error(moving) -> None:
    """The method embedded in tr-bdf2 is more accurate than it, so the difference is its error."""
    model, state, _ = moving
    exact = advance("rk4", model, state, 50.0, 900.0).state
    stepper = advance("tr-bdf2", model, state, 900.0, 900.0, tolerance=1e-9)
    estimate = stepper.error_estimate()
    stepper.space.axpy(-1.0, stepper.state, exact)
    assert estimate == pytest.approx(stepper.space.norm(exact), rel=0.2)


@pytest.mark.parametrize("name", IMPLICIT)
def test_time_dependent_wind_keeps_the_order(name: str) -> None:
    """With a prescribed wind that changes in time."""
    model = Model(Mesh.build(2, 4), make_scene("wind"))
    rng = np.random.default_rng(0)
    state = model.device_mesh.upload(1000.0 + 100.0 * rng.standard_normal(model.size))
    reference = advance("rk4", model, state, 0.03125, 4.0).state.numpy()
    errors = [
        np.abs(advance(name, model, state, dt, 4.0, tolerance=0.0).state.numpy() - reference).max()
        for dt in (0.5, 0.25)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(STEPPERS[name].order, abs=0.3)
