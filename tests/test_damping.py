"""Implicit diffusion in the preconditioner: element by element, and in the elimination."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support import make_scene, relative

from swe_sphere.equations.effects import EFFECTS
from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.operators import sparse
from swe_sphere.operators.schur import Damping, SchurOperator

TAU, GRAVITY, SHARE = 3000.0, 9.8, 0.4
SHAPES = ("element", "node")


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(2, 4, stretch=1.5, centre=(40.0, 23.0), spin=17.0)


def rough(size: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(size)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_element_is_solved_for_itself(mesh, shape: str) -> None:
    """Against (I + tau nu L^2)^-1 with the matrix of the weak Laplacian of its mean rectangle."""
    model = Model(mesh, make_scene("pressure"), shape=shape)
    nu = 1e16
    operator = SchurOperator(
        model.device_mesh, GRAVITY, model.coriolis, wp.float64, lambda k2: nu * k2**2
    )
    x, values = operator.field(), rough(mesh.size, 1)
    operator.put(values, x)
    operator.damping.configure(TAU)
    out = operator.damping.damp_twice(x)
    groups = out.values.numpy()[: model.device_mesh.groups].reshape(-1, 16, model.device_mesh.lanes)
    ours = groups.swapaxes(1, 2).reshape(-1, 16)[: mesh.elements]
    weights, d = np.diag(mesh.gll_weights), mesh.derivative
    stiffness, mass = d.T @ weights @ d, np.kron(weights, weights)
    for element in range(mesh.elements):
        a = mesh.basis[element]
        g = np.linalg.inv(a @ a.swapaxes(-1, -2)).mean(axis=(0, 1))
        weak = g[0, 0] * np.kron(stiffness, weights) + g[1, 1] * np.kron(weights, stiffness)
        laplacian = np.linalg.solve(mass, weak)
        system = np.eye(16) + TAU * nu * laplacian @ laplacian
        once = np.linalg.solve(system, values[mesh.nodes[element].ravel()])
        assert relative(ours[element], np.linalg.solve(system, once)) < 1e-10


@pytest.mark.parametrize("shape", SHAPES)
def test_elimination_with_one_rate_for_all_waves(mesh, shape: str) -> None:
    """Where F is a number it commutes with everything, and matrices tell what must come out."""
    model, n = Model(mesh, make_scene("pressure"), shape=shape), mesh.size
    coriolis = 3e-4 * np.sin(2.0 * mesh.lat + mesh.lon)
    damping = SHARE / TAU
    operator = SchurOperator(
        model.device_mesh, GRAVITY, coriolis, wp.float64,
        lambda k2: np.full_like(k2, damping),
    )  # fmt: skip
    depth, f = 1000.0 + 300.0 * np.cos(mesh.lat), 1.0 / (1.0 + SHARE)
    operator.configure(TAU, depth)
    angle = TAU * coriolis
    turn = np.array([[1.0 + 0.0 * angle, angle], [-angle, 1.0 + 0.0 * angle]]) / (1 + angle**2)

    def turned(wind: np.ndarray) -> np.ndarray:
        return np.einsum("abn,bn->an", turn, wind.reshape(2, -1)).ravel()

    gradient, divergence = sparse.gradient(mesh), sparse.divergence(mesh)
    r, h = rough(3 * n, 2), 100.0 * rough(n, 3)
    b, x, image, out = operator.field(), operator.field(), operator.field(), model.zeros()
    operator.eliminate(wp.array(r), b)
    inflow = divergence @ (np.tile(depth, 2) * turned(f * r[: 2 * n]))
    assert relative(operator.fetch(b), r[2 * n :] - TAU * inflow) < 1e-12
    operator.put(h, x)
    operator.apply(x, image)
    product = h - TAU**2 * GRAVITY * f**2 * divergence @ (np.tile(depth, 2) * turned(gradient @ h))
    assert relative(operator.fetch(image), product) < 1e-12
    operator.substitute(wp.array(r), x, out)
    wind = turned(f * r[: 2 * n] - TAU * GRAVITY * f**2 * (gradient @ h))
    assert relative(out.numpy(), np.concatenate([wind, f * h])) < 1e-12


def test_the_longest_steps_damp_as_shorter_ones_do(mesh) -> None:
    """Nothing changes any more once the shortest waves are damped by MOST."""
    model = Model(mesh, make_scene("pressure"))
    damping = Damping(model.device_mesh, lambda k2: 1e16 * k2**2, wp.float64)
    states = []
    for tau in (1e3, 1e7, 1e8):
        damping.configure(tau)
        states.append(damping.damp_wind(wp.array(rough(3 * mesh.size, 4))).numpy().copy())
    assert relative(states[1], states[2]) < 1e-12
    assert relative(states[0], states[1]) > 1e-3


def test_rates_of_the_effects(mesh) -> None:
    squares = np.array([0.0, 1e-12, 4e-12])
    viscosity, hyper = EFFECTS["viscosity"](1e5), EFFECTS["hyperviscosity"](1e15)
    assert viscosity.damping(mesh, squares) == pytest.approx(1e5 * squares)
    assert hyper.damping(mesh, squares) == pytest.approx(1e15 * squares**2)
    assert EFFECTS["pressure-gradient"]().damping(mesh, squares) == 0.0
