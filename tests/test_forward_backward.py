"""Steppers that step depth and wind one after the other: formulas, order, limits, restart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support import make_scene, random_state, relative

from swe_sphere import Simulation
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.flow_limit import wind_share
from swe_sphere.steppers.forward_backward import STRONG, ForwardBackward, ForwardBackwardRK3
from swe_sphere.testcases import get_scene

SCENES = {
    "all": ("advection", "pressure", "rotation", "orography", "forcing", "drag", "relaxation"),
    "linear": ("pressure", "rotation", "linearised", "drag"),
    "whole elements at once": ("advection", "pressure", "rotation", "orography"),
}
NAMES = ("forward-backward", "fb-rk3")


class Plain:
    """Rates of both equations from whole right-hand sides of the model."""

    def __init__(self, model: Model) -> None:
        self.model, self.n = model, model.mesh.size

    def rate(self, wind: np.ndarray, depth: np.ndarray, t: float) -> np.ndarray:
        out = self.model.zeros()
        at = self.model.device_mesh.upload(np.concatenate([wind, depth]))
        self.model.conservative_tendency(at, t, out)
        return out.numpy()

    def loss(self, x: np.ndarray) -> np.ndarray:
        out = self.model.zeros()
        if self.model.dissipative:
            self.model.dissipative_tendency(self.model.device_mesh.upload(x), out)
        return out.numpy()

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[: 2 * self.n], x[2 * self.n :]


def ab(b: float, levels: list[np.ndarray]) -> np.ndarray:
    now, past, older = levels
    return (1.5 + b) * now - (0.5 + 2.0 * b) * past + b * older


@pytest.mark.parametrize("effects", SCENES.values(), ids=SCENES.keys())
@pytest.mark.thorough
def test_forward_backward_is_what_its_formulas_say(small_mesh, effects) -> None:
    """Shchepetkin & McWilliams (2005), from whole right-hand sides, after two steps of rk4."""
    model, dt = Model(small_mesh, make_scene(*effects)), 100.0
    plain, share = Plain(model), wind_share(model, model.initial_state())
    b_wind, b_mass, gamma = ForwardBackward.weights_in(share)
    stepper, starter = ForwardBackward(model, dt), STEPPERS["rk4"](model, dt)
    start = model.device_mesh.upload(random_state(model))
    stepper.start(start, 50.0)
    starter.start(start, 50.0)
    levels = [start.numpy()]
    for _ in range(2):
        starter.step()
        stepper.step()
        levels.insert(0, starter.state.numpy().copy())
    for k in range(2, 6):
        winds, depths = zip(*(plain.split(x) for x in levels), strict=True)
        t, loss = 50.0 + (k + 0.5) * dt, plain.split(plain.loss(levels[0]))
        rate = plain.rate(ab(b_wind, winds), ab(b_mass, depths), t)
        depth = depths[0] + dt * (plain.split(rate)[1] + loss[1])
        delta = 0.5 + gamma
        mixed = delta * depth + (1.0 - delta - gamma) * depths[0] + gamma * depths[1]
        rate = plain.rate(ab(b_wind, winds), mixed, t)
        wind = winds[0] + dt * (plain.split(rate)[0] + loss[0])
        levels = [np.concatenate([wind, depth]), *levels[:2]]
        stepper.step()
        assert relative(stepper.state.numpy(), levels[0], 3) < 1e-12


@pytest.mark.parametrize("effects", SCENES.values(), ids=SCENES.keys())
def test_fb_rk3_is_what_its_formulas_say(small_mesh, effects) -> None:
    """Lilly et al. (2023), from whole right-hand sides."""
    model, dt = Model(small_mesh, make_scene(*effects)), 300.0
    plain, (b1, b2, b3) = Plain(model), ForwardBackwardRK3.weights
    stepper, x = ForwardBackwardRK3(model, dt), random_state(model)
    stepper.start(model.device_mesh.upload(x), 50.0)
    for k in range(3):
        t, loss, (u0, h0) = 50.0 + k * dt, plain.loss(x), plain.split(x)
        u, h, offset = u0, h0, 0.0
        rows = (b1, 0.0, 1.0 - b1), (b2, 0.0, 1.0 - b2), (b3, 1.0 - 2.0 * b3, b3)
        for part, (of_new, of_last, of_start) in zip((1 / 3, 1 / 2, 1.0), rows, strict=True):
            at = t + offset * dt
            new = h0 + part * dt * plain.split(plain.rate(u, h, at) + loss)[1]
            mixed = of_new * new + of_last * h + of_start * h0
            u = u0 + part * dt * plain.split(plain.rate(u, mixed, at) + loss)[0]
            h, offset = new, part
        x = np.concatenate([u, h])
        stepper.step()
        assert relative(stepper.state.numpy(), x, 3) < 1e-12


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_both_launch_shapes_step_alike(name: str) -> None:
    """Dissipation and what acts at a point are added in registers too, inside whole groups."""
    effects = {"viscosity.nu": 1e5, "drag.linear": 1e-5, "drag.quadratic": 1e-8}
    ends = []
    for launch in ("node", "element"):
        sim = Simulation(
            "williamson4", ne=4, np=4, stepper=name, dt=300, effects=effects, launch=launch
        )
        for _ in range(5):
            sim.step()
        ends.append(sim.stepper.state.numpy())
    assert sim.model.device_mesh.block_groups > 0
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-13 * np.abs(ends[0]).max())


@pytest.mark.parametrize("name", NAMES)
def test_prescribed_wind_carries_depth_and_tracers(name: str) -> None:
    """Depth alone is stepped, to second order at least; a constant mixing ratio stays so."""
    scene = get_scene("deformational")
    model = Model(Mesh.build(3, 4), scene)
    state, ends = model.initial_state(), []
    for dt in (3600.0, 1800.0, 900.0, 450.0):
        stepper = STEPPERS[name](model, dt)
        stepper.start(state)
        for _ in range(round(86400.0 / dt)):
            stepper.step()
        ends.append(stepper.state.numpy().copy())
    coarse, fine, finest = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert np.log2(coarse / fine) > 1.8 and np.log2(fine / finest) > 1.8


@pytest.mark.parametrize("name", NAMES)
def test_limit_falls_with_the_wind(name: str) -> None:
    """Of the same spectral radius; on winds alone the limits are those of AB3 and of RK3."""
    cls = STEPPERS[name]
    limits = [cls.stable_dt(SpectralRadii(1.0, 0.0, wind)) for wind in (0.0, 0.15, 0.2)]
    assert limits[0] == cls.stable_dt(SpectralRadii(1.0))
    if name == "fb-rk3":  # rotation limits it at rest
        assert limits == pytest.approx([2.4, 2.4, 2.4], rel=1e-3)
        assert cls.stable_dt(SpectralRadii(1.0, 0.0, 0.1)) == pytest.approx(2.3, rel=5e-3)
    else:
        assert limits[2] < limits[1] < limits[0]
    alone = {"forward-backward": 0.724, "fb-rk3": 3.0**0.5}
    assert cls.stable_dt(SpectralRadii(1.0, 0.0, 1.0)) == pytest.approx(alone[name], rel=1e-2)


def test_coefficients_for_strong_winds_are_taken_where_they_allow_longer_steps() -> None:
    """At their border both sets have the same limit; beyond, the weak ones' falls below 1.25."""
    winds = (STRONG, STRONG + 1e-6)
    weak, strong = (ForwardBackward.stable_dt(SpectralRadii(1.0, 0.0, wind)) for wind in winds)
    assert weak == pytest.approx(strong, rel=1e-2)
    assert ForwardBackward.stable_dt(SpectralRadii(1.0, 0.0, 0.22)) > 1.35


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2, 0.3, 0.5])
def test_fb_rk3_amplifies_no_wave_in_winds_up_to_the_speed_of_waves(share: float) -> None:
    """Other published weights amplify some wave at any step in winds above 0.15 c."""
    limit = ForwardBackwardRK3.stable_dt(SpectralRadii(1.0, 0.0, share))
    for dt in limit * np.linspace(0.05, 0.99, 20):
        wave, wind = 1j * dt * (1.0 - share), 1j * dt * share * np.linspace(-1.0, 1.0, 21)
        steps = ForwardBackwardRK3.propagator(share, wave, wind[:, None], 0.0)
        assert np.abs(np.linalg.eigvals(steps)).max() < 1.0 + 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_limits_in_a_flow_are_neither_unsafe_nor_wasteful(name: str) -> None:
    """A jet of a sixth of the wave speed: 0.95 of the limit is stable for days, 1.15 is not."""
    model, cls = Model(Mesh.build(3, 4), get_scene("williamson2")), STEPPERS[name]
    limit = cls.stable_dt(cls.spectral_radii(model, model.initial_state()))
    assert departure(model, name, 0.95 * limit, 400) < 1e-2
    assert not departure(model, name, 1.15 * limit, 400) < 1e-1


def departure(model: Model, name: str, dt: float, steps: int) -> float:
    """Relative change of depth after so many steps from a steady flow and some noise."""
    start = model.initial_state().numpy()
    noise = 1e-4 * np.random.default_rng(0).standard_normal(start.size) * np.abs(start).max()
    noise[: 2 * model.mesh.size] *= 1e-3
    stepper = STEPPERS[name](model, dt)
    stepper.start(model.device_mesh.upload(start + noise))
    with np.errstate(all="ignore"):
        for _ in range(steps):
            stepper.step()
    end = stepper.state.numpy()
    return float(np.abs(end - start)[2 * model.mesh.size :].max() / np.abs(start).max())
