"""What the discrete equations keep exactly: mass, energy, total vorticity, a lake at rest."""

from __future__ import annotations

import numpy as np
import pytest
from support import make_scene, random_state, tendency

from swe_sphere.equations.effects import Hyperviscosity, Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import Snapshot
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.testcases import get_scene

FULL = ("advection", "pressure", "rotation", "orography")
MESHES = {
    "ne2np4": Mesh.build(2, 4),
    "ne3np3": Mesh.build(3, 3, spin=57.0),
    "ne1np7": Mesh.build(1, 7),
    "stretched": Mesh.build(2, 4, stretch=3.0, centre=(115.0, -46.0), spin=29.0),
}


def part_of_all(values: np.ndarray) -> float:
    """A sum that should vanish, over the sum of absolute values."""
    return abs(values.sum()) / np.abs(values).sum()


@pytest.fixture(params=MESHES, ids=str)
def mesh(request):
    return MESHES[request.param]


@pytest.mark.parametrize("shape", ["element", "node"])
def test_mass_and_energy_tendencies_vanish(mesh, shape) -> None:
    """E = sum of area (h |V|²/2 + g (h + b)²/2); dE/dt = 0 but for round-off at any state."""
    model = Model(mesh, make_scene(*FULL), shape=shape)
    g = model.scene.planet.gravity
    for seed in range(3):
        state = random_state(model, seed)
        u, v, h = state.reshape(3, -1)
        du, dv, dh = tendency(model, state).reshape(3, -1)
        assert part_of_all(mesh.area * dh) < 1e-13
        potential = mesh.area * (0.5 * (u**2 + v**2) + g * (h + model.bottom)) * dh
        kinetic = np.concatenate([mesh.area * h * u * du, mesh.area * h * v * dv])
        assert part_of_all(np.concatenate([potential, kinetic])) < 1e-13


@pytest.mark.parametrize("names", [("wind",), ("viscosity",), ("hyperviscosity", "orography")])
@pytest.mark.thorough
def test_mass_is_kept_by_transport_and_diffusion(mesh, names) -> None:
    model = Model(mesh, make_scene(*names))
    dh = tendency(model, random_state(model))[-mesh.size :]
    assert np.abs(dh).max() > 0.0
    assert part_of_all(mesh.area * dh) < 1e-13


def test_total_vorticity_and_divergence_vanish(mesh) -> None:
    model = Model(mesh, make_scene(*FULL))
    fields = Snapshot(model, model.device_mesh.upload(random_state(model)), 0.0).all_fields
    for field in (fields["vorticity"], fields["divergence"]):
        assert np.abs(field).max() > 1e-6
        assert part_of_all(mesh.area * field) < 1e-13


def test_pressure_work_is_the_transpose_of_divergence(mesh) -> None:
    """sum area (s div V + V . grad s) = 0: linearise at rest about unit depth."""
    model = Model(mesh, make_scene("pressure"))
    rest = np.concatenate([np.zeros(2 * mesh.size), np.ones(mesh.size)])
    direction = random_state(model, 5)
    jacobian = model.jacobian().update(model.device_mesh.upload(rest), 0.0)
    out = model.zeros()
    jacobian(model.device_mesh.upload(direction), out)
    u, v, s = direction.reshape(3, -1)
    slope_u, slope_v, spread = out.numpy().reshape(3, -1)
    g = model.scene.planet.gravity
    work = mesh.area * np.stack([s * spread, u * slope_u / g, v * slope_v / g])
    assert part_of_all(work) < 1e-13


@pytest.mark.parametrize("names", [("viscosity",), ("hyperviscosity",)])
def test_dissipation_is_symmetric_and_never_gains(mesh, names) -> None:
    model = Model(mesh, make_scene(*names))
    a, b = random_state(model, 1), random_state(model, 2)
    weight = np.tile(mesh.area, 3)
    rate_a, rate_b = tendency(model, a), tendency(model, b)
    products = np.concatenate([weight * b * rate_a, -weight * a * rate_b])
    assert part_of_all(products) < 1e-12
    for x, rate in ((a, rate_a), (b, rate_b)):
        for block in np.split(weight * x * rate, [2 * mesh.size]):
            assert block.sum() < 0.0


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("cone", [True, False], ids=["cone", "smooth"])
def test_lake_stays_at_rest_bit_for_bit(cone: bool, precision: str) -> None:
    """Bottoms are measured from the surface: what is level has no slope, not even by rounding."""
    assert still_after_a_day(get_scene("lake-at-rest", cone=cone), precision) == 0.0


@pytest.mark.parametrize("cone", [True, False], ids=["cone", "smooth"])
def test_diffusion_leaves_a_lake_at_rest(cone: bool) -> None:
    scene = get_scene("lake-at-rest", cone=cone)
    scene = scene.with_effect(Viscosity(1e6)).with_effect(Hyperviscosity(1e17))
    assert still_after_a_day(scene, "float64") < 1e-10


def still_after_a_day(scene, precision: str) -> float:
    """Largest wind [m s-1] after a day of rk4."""
    model = Model(Mesh.build(6, 4), scene, precision=precision)
    stepper = RK4(model, 900.0)
    stepper.start(model.initial_state())
    for _ in range(round(DAY / stepper.dt)):
        stepper.step()
    fields = model.fields(stepper.state)
    surface = fields["h"] + model.bottom
    assert np.abs(surface - 5960.0).max() < (1e-8 if precision == "float64" else 2e-3)
    return float(np.hypot(fields["u"], fields["v"]).max())
