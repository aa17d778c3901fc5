"""Viscosity and hyperviscosity against the eigenvalues of the sphere."""

from __future__ import annotations

import numpy as np
import pytest
from support import SMOOTH, harmonic, make_scene, tendency

from swe_sphere.equations.effects import Hyperviscosity, Viscosity, hyperviscosity_default
from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh

NU = 1e6


def rates(scene, mesh, name: str, turned: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """Tendency of (gradient or turned gradient, Y), that state, and l (l + 1)/a²."""
    model = Model(mesh, scene)
    degree, value, gradient, rotated = harmonic(mesh, name)
    scale = mesh.radius if not turned else -mesh.radius
    state = np.concatenate([*(scale * (rotated if turned else gradient)), value])
    return tendency(model, state), state, degree * (degree + 1) / mesh.radius**2


def error(scene, mesh, factor, power: int, name: str, turned: bool) -> float:
    rate, state, eigenvalue = rates(scene, mesh, name, turned)
    weight = np.tile(mesh.area, 3)
    expected = factor * eigenvalue**power * state
    return float(np.sqrt(np.sum(weight * (rate - expected) ** 2) / np.sum(weight * expected**2)))


@pytest.mark.parametrize("turned", [False, True], ids=["gradient", "rotated"])
@pytest.mark.parametrize("name", SMOOTH)
def test_viscosity_has_the_eigenvalues_of_the_laplacian(name: str, turned: bool) -> None:
    """∇²Y = -l(l+1)/a² Y, and the same for the vectors ∇Y and k×∇Y under the Hodge Laplacian."""
    scene = make_scene("viscosity").with_effect(Viscosity(NU))
    errors = [error(scene, Mesh.build(2, np_), -NU, 1, name, turned) for np_ in (5, 8, 12)]
    assert errors[-1] < 3e-6
    assert errors[1] < errors[0] / 20 and errors[2] < errors[1] / 20


@pytest.mark.parametrize("turned", [False, True], ids=["gradient", "rotated"])
@pytest.mark.thorough
def test_hyperviscosity_squares_the_eigenvalues(turned: bool) -> None:
    nu = 1e17
    scene = make_scene("hyperviscosity").with_effect(Hyperviscosity(nu))
    errors = [error(scene, Mesh.build(2, np_), -nu, 2, "xyz", turned) for np_ in (6, 9, 13)]
    assert errors[-1] < 3e-4
    assert errors[1] < errors[0] / 10 and errors[2] < errors[1] / 10


def test_hyperviscosity_by_default_goes_with_the_mesh() -> None:
    mesh = Mesh.build(2, 5)
    given = make_scene("hyperviscosity").with_effect(Hyperviscosity(None))
    spelled = given.with_effect(Hyperviscosity(hyperviscosity_default(2, 5)))
    ours, state, _ = rates(given, mesh, "xyz", False)
    np.testing.assert_array_equal(ours, rates(spelled, mesh, "xyz", False)[0])
    assert np.sum(np.tile(mesh.area, 3) * state * ours) < 0.0


@pytest.mark.parametrize("np_", [3, 4, 7, 13])
def test_hyperviscosity_by_default_is_ten_times_less_for_half_the_spacing(np_: int) -> None:
    """And the same on meshes that have as many nodes along a line, in few elements or in many."""
    of_30_4 = hyperviscosity_default(30, 4)
    assert 30.0 * of_30_4 == pytest.approx(1e15)
    assert hyperviscosity_default(60, np_) == pytest.approx(hyperviscosity_default(30, np_) / 10.0)
    assert hyperviscosity_default(90, np_) == pytest.approx(
        hyperviscosity_default(30 * (np_ - 1), 4)
    )


@pytest.mark.parametrize("effect", ["viscosity", "hyperviscosity"])
def test_diffusion_is_of_the_surface_and_not_of_depth(effect: str) -> None:
    """A flat surface over orography is left alone; a flat depth is not."""
    mesh = Mesh.build(2, 6)
    model = Model(mesh, make_scene("orography", effect))
    still, flat = np.zeros(2 * mesh.size), np.full(mesh.size, 1000.0)
    surface = tendency(model, np.concatenate([still, flat - model.bottom]))
    depth = tendency(model, np.concatenate([still, flat]))
    assert np.abs(surface).max() < 1e-9 * np.abs(depth).max()
