"""Viscosity and hyperviscosity stepped apart: their own method, and what it leaves of a stepper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from manufactured import DURATION, MESH, answer, manufactured, tight
from numpy.polynomial import legendre
from support import (
    EXPLICIT,
    EXPONENTIAL,
    IMEX,
    IMPLICIT,
    advance,
    make_scene,
    random_state,
    relative,
    tendency,
)

from swe_sphere.equations.effects import Hyperviscosity
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.adaptive import AdaptiveSteps
from swe_sphere.steppers.leapfrog import Leapfrog
from swe_sphere.steppers.split_diffusion import Diffusion, legendre_stages
from swe_sphere.testcases import get_scene

NU = 1e19
"""Damps fast enough for the splitting to make the largest errors."""
SOME = ("rk4", "ars343", "leapfrog", "semi-implicit")
"""Of each way to have diffusion stepped."""
FIRST_ORDER = ("forward-backward", "leapfrog", "semi-implicit")
"""With it; the latter two because of their filter."""


@pytest.fixture(scope="module")
def damped() -> Model:
    """With a known solution in time."""
    return Model(MESH, manufactured("pressure", "hyperviscosity", nu=NU))


def decayed(modes: np.ndarray, reach: float, order: int) -> np.ndarray:
    """What is left of modes (n,), rates times step, after a step of RKL2 (Meyer et al., eq. 15).

    Of Euler's, where first order will do and no mode changes its sign by much.
    """
    if order == 1 and reach <= 1.24:
        return 1.0 - modes
    stages = 2
    while 0.75 * (stages**2 + stages - 2) / 2 < reach:
        stages += 1
    b = (stages**2 + stages - 2) / (2 * stages * (stages + 1))
    ends = 1.0 - 4.0 * modes / (stages**2 + stages - 2)
    return 1.0 - b + b * legendre.legval(ends, np.eye(stages + 1)[stages])


@pytest.mark.parametrize(("reach", "order"), [(0.5, 2), (2.5, 2), (40.0, 2), (1.2, 1), (1.3, 1)])
def test_every_mode_decays_by_the_polynomial_of_the_method(reach: float, order: int) -> None:
    """And so by e^-z where z is small, by a fifth at least where it is the largest."""
    model = Model(Mesh.build(1, 4), make_scene("pressure", "hyperviscosity"))
    dt = reach / model.diffusion_radius
    rates, result = np.empty((2, model.size, model.size))
    method, out = Diffusion(model, dt, order), model.zeros()
    for column, unit in enumerate(np.eye(model.size)):
        state = model.device_mesh.upload(unit)
        model.diffusion(state, out)
        rates[:, column] = out.numpy()
        method.act(state)
        result[:, column] = state.numpy()
    values, modes = np.linalg.eig(-dt * rates)
    expected = (modes * decayed(values, reach, order)) @ np.linalg.inv(modes)
    assert np.abs(result - expected).max() < 1e-10
    slow = np.abs(values) < 0.02
    left = decayed(values, reach, order)
    assert np.abs(left - np.exp(-values))[slow].max() < (2e-4 if reach == 1.2 else 1e-5)
    assert np.abs(left)[np.abs(values) > 0.5 * reach].max() < 0.8


@pytest.mark.parametrize("reach", [4e5, 1e25, np.inf, np.nan])
def test_coefficients_that_no_step_would_end_with_are_refused(reach: float) -> None:
    with pytest.raises(ConfigError, match=r"stages a step: take a smaller coefficient"):
        legendre_stages(reach)


@pytest.mark.parametrize("name", [*SOME, "tr-bdf2"])
def test_steppers_are_of_second_order_with_it(damped: Model, name: str, monkeypatch) -> None:
    """Exact in time is known; the filters switched off."""
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    exact, scale = answer(DURATION), np.repeat([10.0, 10.0, 100.0], MESH.size)
    errors = []
    for dt in (225.0, 112.5):
        options = tight(name, 1e-6) | ({"diffusion": "apart"} if name in IMPLICIT else {})
        last = advance(name, damped, damped.initial_state(), dt, DURATION, **options)
        errors.append(float(np.abs((last.state.numpy() - exact) / scale).max()))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)
    assert STEPPERS[name].order_in(damped, **options) == 2


@pytest.mark.parametrize("name", ["leapfrog", "semi-implicit"])
def test_leapfrog_leaves_a_steady_state_alone_whatever_the_step(name: str) -> None:
    """Where diffusion and all else cancel; but its first step, which another method takes."""
    thick = make_scene("pressure", "forcing", "hyperviscosity").with_effect(Hyperviscosity(NU))
    thick = replace(thick, forcing=lambda lon, lat, t: np.split(balance, 3), steady_forcing=True)
    state, balance = random_state(Model(MESH, make_scene("pressure")), 3), np.zeros(3 * MESH.size)
    balance = -tendency(Model(MESH, thick), state)
    stepper = STEPPERS[name](Model(MESH, thick), 1200.0, **tight(name))
    stepper.start(stepper.model.device_mesh.upload(state))
    stepper.step()
    stepper.load_state_dict(stepper.state_dict() | {"state": state, "previous": state}, 1)
    for _ in range(20):
        stepper.step()
    assert relative(stepper.state.numpy(), state, 3) < 1e-10


@pytest.mark.parametrize("name", SOME)
def test_mass_is_kept_to_round_off(name: str) -> None:
    scene = make_scene("pressure", "hyperviscosity").with_effect(Hyperviscosity(NU))
    model = Model(MESH, scene)
    state = model.device_mesh.upload(random_state(model))
    last = advance(name, model, state, 300.0, 60000.0).state.numpy()
    masses = [np.sum(MESH.area * x[-MESH.size :]) for x in (state.numpy(), last)]
    assert abs(masses[1] / masses[0] - 1.0) < 1e-13


@pytest.mark.parametrize("name", [*EXPLICIT, *IMEX])
@pytest.mark.thorough
def test_it_limits_no_step(name: str) -> None:
    """The limit is that without it, and dynamics are compiled without its terms."""
    scene = make_scene("pressure")
    plain, kind = Model(MESH, scene), STEPPERS[name]
    thick = Model(MESH, scene.with_effect(Hyperviscosity(100.0 * NU)))
    state = plain.device_mesh.upload(random_state(plain))
    found = kind.spectral_radii(thick, state)
    assert found == kind.spectral_radii(plain, state)
    assert kind.order_in(thick) == (1 if name in FIRST_ORDER else 2)
    stepper = kind(thick, 0.9 * kind.stable_dt(found))
    assert len(stepper.diffusion.stages) > 5
    (operation,) = stepper.model.tendency.operations
    assert not {"nu", "nu4"} & {*operation.operator.geometry._cls.vars}
    rest = np.concatenate([np.zeros(2 * MESH.size), np.full(MESH.size, 1000.0)])
    noise = 1e-3 * (random_state(thick) - random_state(thick, 2))
    stepper.start(thick.device_mesh.upload(rest + noise))
    for _ in range(50):
        stepper.step()
    assert np.abs(stepper.state.numpy() - rest).max() < 2.0 * np.abs(noise).max()


@pytest.mark.parametrize("name", [*IMPLICIT, *EXPONENTIAL])
def test_other_steppers_have_it_in_their_stages(name: str) -> None:
    """Steps that adapt too: it does not act once more beside them."""
    model = Model(MESH, make_scene("pressure", "hyperviscosity"))
    stepper = STEPPERS[name](model, 900.0)
    assert stepper.diffusion is None and stepper.model is model
    assert stepper.order_in(model) == stepper.order
    if name in IMPLICIT:
        assert stepper.order_in(model, diffusion="apart") == min(stepper.order, 2)
    if stepper.estimate_order is not None:
        twin, state = STEPPERS[name](model, 900.0), model.initial_state()
        adaptive = AdaptiveSteps(stepper, 1.0)
        for one in (adaptive, twin):
            one.start(state)
        adaptive.next_dt = 900.0
        adaptive.step()
        assert twin.attempt(0.0, 900.0) is None
        twin.accept(900.0)
        np.testing.assert_array_equal(adaptive.state.numpy(), twin.state.numpy())


def test_in_the_stages_of_an_explicit_stepper_it_limits_the_step() -> None:
    """The automatic step of rk4 is stable with diffusion in its stages."""
    kind = type("InStages", (STEPPERS["rk4"],), {"name": "in-stages", "splits_diffusion": False})
    scene = get_scene("williamson5").with_effect(Hyperviscosity(3e19))
    sim = Simulation(scene, stepper=kind, ne=3, np=4)
    apart = Simulation(scene, stepper="rk4", ne=3, np=4)
    assert sim.stable_dt() < 0.1 * apart.stable_dt()
    sim.run(days=0.05)
    assert sim.diagnostics["max_wind"] < 40.0


@pytest.mark.thorough
def test_apart_it_costs_an_implicit_stepper_no_iterations() -> None:
    """Counts are those without it; taken whole, which the preconditioner knows, half again."""
    mesh, plain = Mesh.build(4, 4), get_scene("williamson5")
    thick = plain.with_effect(Hyperviscosity())
    counts = []
    for scene, how in ((plain, "whole"), (thick, "apart"), (thick, "whole")):
        model = Model(mesh, scene)
        stepper = advance("tr-bdf2", model, model.initial_state(), 21600.0, 129600.0, diffusion=how)
        counts.append(stepper.counters["krylov_iterations"])
    assert counts[1] <= counts[0] + 12 and counts[2] <= 1.5 * counts[0], counts


def test_what_cannot_have_it_apart_says_so() -> None:
    model = Model(MESH, make_scene("pressure", "hyperviscosity"))
    with pytest.raises(ConfigError, match="use diffusion=whole"):
        STEPPERS["bdf2"](model, 900.0, diffusion="apart")
    with pytest.raises(ConfigError, match="use diffusion=whole"):
        AdaptiveSteps(STEPPERS["tr-bdf2"](model, 900.0, diffusion="apart"), 1e-3)
    with pytest.raises(ConfigError, match="diffusion must be one of whole, apart, got 'lagged'"):
        Simulation("williamson2", ne=2, stepper="tr-bdf2", options={"diffusion": "lagged"})
