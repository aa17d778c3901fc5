"""Sparse gradient, divergence and Laplacian against the kernels, `diagnose` and theory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support import harmonic, make_scene, relative, tangent

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.operators import diagnose, sparse
from swe_sphere.solvers.preconditioners.coarse import smooth_functions

MESHES = {
    "ne2np4": Mesh.build(2, 4),
    "ne3np3": Mesh.build(3, 3, spin=57.0),
    "ne1np8": Mesh.build(1, 8),
    "stretched": Mesh.build(2, 4, stretch=3.0, centre=(115.0, -46.0), spin=29.0),
}


@pytest.fixture(params=MESHES, ids=str)
def mesh(request):
    return MESHES[request.param]


def rough(mesh, fields: int, seed: int = 3) -> np.ndarray:
    """Random nodal values of that many fields."""
    return np.random.default_rng(seed).standard_normal(fields * mesh.size)


@pytest.mark.parametrize("shape", ["element", "node"])
def test_they_are_the_operators_of_the_kernels(mesh, shape: str) -> None:
    """The tangent at rest about unit depth is (-g G h, -D V)."""
    model = Model(mesh, make_scene("pressure"), shape=shape)
    rest = np.concatenate([np.zeros(2 * mesh.size), np.ones(mesh.size)])
    d = rough(mesh, 3)
    wind, depth = np.split(d, [2 * mesh.size])
    rates = np.split(tangent(model, rest, d), [2 * mesh.size])
    slope = -model.scene.planet.gravity * (sparse.gradient(mesh) @ depth)
    assert relative(slope, rates[0], 2) < 1e-13
    assert relative(-(sparse.divergence(mesh) @ wind), rates[1]) < 1e-13


def test_divergence_and_curl_of_the_diagnostics(mesh) -> None:
    """Vorticity is minus the divergence of k x V."""
    wind = rough(mesh, 2)
    u, v = wind.reshape(2, -1)
    matrix = sparse.divergence(mesh)
    assert relative(matrix @ wind, diagnose.divergence(mesh, u, v)) < 1e-13
    turned = np.concatenate([-v, u])
    assert relative(-(matrix @ turned), diagnose.vorticity(mesh, u, v)) < 1e-13


def test_gradient_is_minus_the_adjoint_of_the_divergence(mesh) -> None:
    """<s, D V> = -<G s, V> for two random fields: D is built from G, so the kernels' is asked."""
    s, wind = rough(mesh, 1, 4), rough(mesh, 2, 5)
    left = mesh.area * s * diagnose.divergence(mesh, *wind.reshape(2, -1))
    right = np.tile(mesh.area, 2) * (sparse.gradient(mesh) @ s) * wind
    assert abs(left.sum() + right.sum()) < 1e-13 * np.abs(left).sum()


def harmonic_errors(ne: int, name: str) -> np.ndarray:
    """Relative l2 errors of gradient and Laplacian of a harmonic, and of its Rayleigh quotient."""
    mesh = Mesh.build(ne, 4, centre=(40.0, 23.0), spin=17.0)
    degree, value, gradient, _ = harmonic(mesh, name)
    eigenvalue = -degree * (degree + 1) / mesh.radius**2
    slope = sparse.gradient(mesh) @ value
    curvature = -(sparse.stiffness(mesh, np.ones(mesh.size)) @ value) / mesh.area
    quotient = value @ (mesh.area * curvature) / (value @ (mesh.area * value))
    return np.array(
        [
            np.linalg.norm(slope - gradient.ravel()) / np.linalg.norm(gradient),
            np.linalg.norm(curvature / eigenvalue - value) / np.linalg.norm(value),
            abs(quotient / eigenvalue - 1.0),
        ]
    )


@pytest.mark.parametrize("name", ["xyz", "tall"])
def test_harmonics_converge(name: str) -> None:
    """Laplacian with eigenvalue -l (l + 1)/a²; np 4: order 3, 2.5 and, of the eigenvalue, 6."""
    errors = [harmonic_errors(ne, name) for ne in (4, 8, 16)]
    assert np.all(errors[-1] < (4e-4, 5e-4, 1e-7))
    for coarse, fine in pairwise(errors):
        assert np.all(np.log2(coarse / fine) > (2.85, 2.4, 5.7))


def test_laplacian_is_symmetric_and_blind_to_constants(mesh) -> None:
    coefficient = 1.0 + rough(mesh, 1) ** 2
    stiffness = sparse.stiffness(mesh, coefficient)
    scale = abs(stiffness).max()
    assert abs(stiffness - stiffness.T).max() < 1e-13 * scale
    assert np.abs(stiffness.sum(axis=1)).max() < 1e-12 * scale
    assert np.linalg.eigvalsh(stiffness.toarray())[1] > 1e-6 * scale


def test_stiffness_is_the_energy_of_the_gradient(mesh) -> None:
    """s^T K s is the integral of |grad s|², on the unit sphere 8 pi/3 for s = z."""
    z = mesh.xyz[:, 2]
    energy = z @ (sparse.stiffness(mesh, np.ones(mesh.size)) @ z)
    assert energy == pytest.approx(8.0 * np.pi / 3.0, rel=1e-3)


@pytest.mark.parametrize("np_", [4, 5, 8])
def test_smooth_functions_couple_with_their_neighbours_only(np_: int) -> None:
    """A function couples with eight others at most; its energy is that of the gradient.

    Constants have no energy.
    """
    mesh = Mesh.build(6, np_)
    space = smooth_functions(mesh)
    matrix = sparse.stiffness(mesh, np.ones(mesh.size), space)
    scale = abs(matrix).max()
    assert ((abs(matrix) > 1e-12 * scale).sum(axis=1) <= 9).all()
    assert abs(matrix - matrix.T).max() < 1e-13 * scale
    assert np.abs(matrix.sum(axis=1)).max() < 1e-12 * scale
    z = np.empty(space.numbers.max() + 1)
    at_own = np.argmax(space.values, axis=0)  # each function is 1 at its own node
    z[space.numbers] = mesh.xyz[mesh.nodes.reshape(mesh.elements, -1)[:, at_own], 2]
    assert z @ matrix @ z == pytest.approx(8.0 * np.pi / 3.0, rel=2e-2)
