"""Multirate steppers: formulas, order, limits, tracers, what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support import make_scene, random_state, relative

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.multirate import MIS3C
from swe_sphere.testcases import get_scene

from .test_tracers import CONSTANT, with_tracers

NAMES = ("mis2", "mis3c")


@pytest.fixture(scope="module")
def lauter():
    """Unsteady flow, its start, and its end after four hours in tiny steps."""
    model = Model(Mesh.build(2, 4), get_scene("lauter"))
    return model, model.initial_state(), after(model, "rk4", 100.0)


def after(model: Model, name: str, dt: float, **options) -> np.ndarray:
    stepper = STEPPERS[name](model, dt, **options)
    stepper.start(model.initial_state())
    for _ in range(round(14400.0 / dt)):
        stepper.step()
    return stepper.state.numpy().copy()


class Waves:
    """The fast part, by whole right-hand sides of linearised dynamics without wind."""

    def __init__(self, mesh: Mesh, depth: np.ndarray) -> None:
        scene = make_scene("pressure", "linearised")
        rest = lambda lon, lat: (0.0 * lon, 0.0 * lon, depth if lon.shape == depth.shape else 1e3)  # noqa: E731
        self.model = Model(mesh, replace(scene, base=rest))
        self.base = np.concatenate([np.zeros(2 * mesh.size), depth])

    def __call__(self, d: np.ndarray) -> np.ndarray:
        out = self.model.zeros()
        self.model.tendency(self.model.device_mesh.upload(self.base + d), 0.0, out)
        return out.numpy()


@pytest.mark.parametrize("name", NAMES)
def test_steps_are_what_the_formulas_say(small_mesh, name: str) -> None:
    """Knoth & Wensch (2014), eqs. 1 and 9, the slow part a difference of right-hand sides."""
    effects = "advection", "pressure", "rotation", "orography", "forcing", "drag", "relaxation"
    model, cls, dt = Model(small_mesh, make_scene(*effects)), STEPPERS[name], 900.0
    x, n, t, out = random_state(model), model.mesh.size, 50.0, model.zeros()
    waves, winds = Waves(small_mesh, x[2 * n :]), slice(0, 2 * n)

    def slow(y: np.ndarray, at: float) -> np.ndarray:
        model.tendency(model.device_mesh.upload(y), at, out)
        return out.numpy() - waves(y)

    changes, slopes, times = [], [slow(x, t)], []
    rows = zip(((), *cls.alpha), cls.beta, ((), *cls.gamma), strict=True)
    for alpha, beta, gamma in rows:
        d = sum(beta)
        z = x + sum(a * c for a, c in zip(alpha, changes, strict=True))
        rate = sum(b * f for b, f in zip(beta, slopes, strict=True)) / d
        rate = rate + sum(g / dt * c for g, c in zip(gamma, changes, strict=True)) / d
        times.append(d + sum((a + g) * c for a, g, c in zip(alpha, gamma, times, strict=True)))
        steps = max(1, math.ceil(12 * d))
        tau = d * dt / steps
        z[winds] += 0.5 * tau * (waves(z) + rate)[winds]
        for step in range(steps):
            z[2 * n :] += tau * (waves(z) + rate)[2 * n :]
            z[winds] += (tau if step + 1 < steps else 0.5 * tau) * (waves(z) + rate)[winds]
        changes.append(z - x)
        slopes.append(slow(z, t + times[-1] * dt))
    stepper = STEPPERS[name](model, dt, substeps=12)
    stepper.start(model.device_mesh.upload(x), t)
    stepper.step()
    assert times[-1] == pytest.approx(1.0)
    assert relative(stepper.state.numpy(), z, 3) < 1e-12


@pytest.mark.parametrize("name", NAMES)
def test_of_second_order(lauter, name: str) -> None:
    model, _, exact = lauter
    scale = np.repeat(np.abs(exact).reshape(3, -1).max(axis=1), model.mesh.size)
    ends = (after(model, name, dt) for dt in (400.0, 200.0, 100.0))
    errors = [float(np.abs((end - exact) / scale).max()) for end in ends]
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.25)


def test_mis3c_is_of_third_order_where_all_is_slow() -> None:
    """Under a prescribed wind that changes in time no waves are left."""
    model, ends = Model(Mesh.build(2, 4), get_scene("deformational")), []
    ends = [after(model, "mis3c", dt) for dt in (3600.0, 1800.0, 900.0, 450.0)]
    changes = [np.abs(a - b).max() for a, b in pairwise(ends)]
    for coarse, fine in pairwise(changes):
        assert np.log2(coarse / fine) == pytest.approx(3.0, abs=0.25)


def test_limits_are_neither_unsafe_nor_wasteful() -> None:
    """Over a mountain, in winds of up to an eighth of the wave speed."""
    model = Model(Mesh.build(8, 4), get_scene("williamson5"))
    start = model.initial_state()
    spectrum = MIS3C.spectral_radii(model, start)
    limit, ends = MIS3C.stable_dt(spectrum), []
    assert limit * spectrum.wave > 12.0
    noise = 1e-3 * (random_state(model) - random_state(model, 2))
    for part in (0.95, 1.4):
        stepper = MIS3C(model, part * limit)
        stepper.start(model.device_mesh.upload(start.numpy() + noise))
        with np.errstate(all="ignore"):
            for _ in range(70):
                stepper.step()
        ends.append(float(np.abs(stepper.state.numpy()[: 2 * model.mesh.size]).max()))
    assert ends[0] < 60.0 and not ends[1] < 100.0


@pytest.mark.parametrize("name", NAMES)
def test_limits_of_the_analysis(name: str) -> None:
    """Winds bound steps as the Runge-Kutta method would be, waves hardly; mis2 grows in any wind.

    1.73 is the limit of third-order methods with three stages; without wind every step is stable.
    """
    cls = STEPPERS[name]
    assert cls.stable_dt(SpectralRadii(1.0)) == pytest.approx(cls.reach, rel=1e-3)
    alone = cls.stable_dt(SpectralRadii(1.0, 0.0, 0.05))
    assert 0.05 * alone == pytest.approx({"mis2": 0.23, "mis3c": 3.0**0.5}[name], rel=0.05)
    assert cls.stable_dt(SpectralRadii(1.0, 0.0, 0.3)) < 3.0


def test_constant_tracers_stay_so_and_masses_stay() -> None:
    model = Model(Mesh.build(3, 4), with_tracers(get_scene("williamson5")))
    stepper, area = MIS3C(model, 2400.0), model.mesh.area
    stepper.start(model.initial_state())
    start = model.fields(stepper.state)
    for _ in range(10):
        stepper.step()
    end = model.fields(stepper.state)
    assert np.abs(end["q_even"] / CONSTANT - 1.0).max() < 1e-13
    for name in ("h", "hq_wave"):
        assert area @ end[name] == pytest.approx(area @ start[name], rel=1e-13)
    assert np.abs(end["q_wave"] - start["q_wave"]).max() > 1e-2


def test_substeps_follow_from_the_waves_or_are_given(small_mesh) -> None:
    model = Model(small_mesh, make_scene("advection", "pressure", "rotation"))
    counts = []
    for dt, options in ((300.0, {}), (90000.0, {}), (300.0, {"substeps": 30})):
        stepper = MIS3C(model, dt, **options)
        stepper.start(model.initial_state())
        stepper.step()
        counts.append(model.counters["fast_steps"])
    assert counts[1] > 5 * counts[0] and counts[2] == 36
    with pytest.raises(ConfigError, match="substeps: must be 0 or more, got -1"):
        MIS3C(model, 300.0, substeps=-1)
