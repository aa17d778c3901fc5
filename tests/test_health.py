"""Runs end as soon as their state makes no sense, and only then."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
import pytest

from swe_sphere import Scene, Simulation
from swe_sphere.equations import effects
from swe_sphere.equations.effects import DYNAMICS, MASSES, PointwiseEffect, Relaxation, Rotation
from swe_sphere.errors import ConfigError, Unstable
from swe_sphere.io.runfile import RunFile
from swe_sphere.simulation.diagnostics import Snapshot
from swe_sphere.simulation.observers import LOST_MASS, RUNAWAY, Callback, HealthCheck
from swe_sphere.steppers import get_stepper, list_steppers
from swe_sphere.steppers.stepper import Stepper

from .support import Leak, thorough

SMALL = {"ne": 2, "np": 4, "dt": 900.0}


@dataclass(frozen=True)
class Rain(PointwiseEffect):
    """Adds depth everywhere at a rate [m s-1]."""

    name = "rain"
    rate: float = 1e-6

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return c.rate

    @staticmethod
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        return dh - dh


@dataclass(frozen=True)
class FalseRain(Rain):
    """Declares that it adds none."""

    name = "false-rain"
    conserves = MASSES


@dataclass(frozen=True)
class Mixing(Rain):
    """Adds depth in the east and removes as much in the west."""

    name = "mixing"
    conserves = MASSES

    def coefficients(self, mesh):
        return {"rate": self.rate, "side": np.sin(mesh.lon) * np.cos(mesh.lat)}

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return c.rate * c.side[i]


@dataclass(frozen=True)
class Shallows(PointwiseEffect):
    """Removes depth at a rate that is NaN where the water is deeper than a limit."""

    name = "shallows"
    limit: float = 300.0
    rate: float = 1e-9

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return -c.rate * sqrt(c.limit - h)

    @staticmethod
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        return dh - dh


def basin(depth: float = 200.0, **attributes) -> Scene:
    """Water at rest."""
    values = {"effects": (*DYNAMICS, Rotation()), "initial": lambda lon, lat: (0.0, 0.0, depth)}
    return Scene(**{"name": "basin", **values, **attributes})


def set_state(sim: Simulation, change) -> None:
    """Replace the state by a function of its values."""
    sim.stepper.state.assign(change(sim.stepper.state.numpy()))
    sim.release()


def depth_of(sim: Simulation) -> slice:
    n = sim.model.device_mesh.size
    return slice(2 * n, 3 * n)


@pytest.mark.parametrize(
    ("lowest", "complaint"),
    [(np.nan, "is NaN"), (np.inf, "is NaN"), (-1e-9, "not positive"), (-0.0, "not positive"),
     (0.0, "not positive"), (1e-9, None)],
)  # fmt: skip
def test_depth_is_checked_from_both_sides_of_zero(lowest, complaint):
    sim = Simulation("williamson2", **SMALL)
    sim.begin()
    check = HealthCheck(sim)

    def at_one_node(values):
        values[depth_of(sim)][7] = lowest
        return values

    set_state(sim, at_one_node)
    if complaint is None:
        check._conserves = False  # the depth of a node has gone
        check.observe(sim.snapshot)
        return
    with pytest.raises(Unstable, match=complaint):
        check.observe(sim.snapshot)


def test_energy_is_checked_from_both_sides_of_its_bound():
    sim = Simulation("williamson1", **SMALL)
    sim.begin()
    check, start = HealthCheck(sim), sim.stepper.state.numpy().copy()
    check._conserves = False
    for factor, is_sound in ((0.999, True), (1.001, False)):
        set_state(sim, lambda _, factor=factor: np.sqrt(factor * RUNAWAY) * start)
        if is_sound:
            check.observe(sim.snapshot)
        else:
            with pytest.raises(Unstable, match="energy has grown 10 times"):
                check.observe(sim.snapshot)


def test_mass_is_checked_from_both_sides_of_its_bound():
    sim = Simulation(basin(), **SMALL)
    sim.begin()
    check, start = HealthCheck(sim), sim.stepper.state.numpy().copy()
    for factor, is_sound in ((0.99, True), (1.01, False), (-0.99, True), (-1.01, False)):
        set_state(sim, lambda _, factor=factor: start * (1.0 + factor * LOST_MASS))
        if is_sound:
            check.observe(sim.snapshot)
        else:
            with pytest.raises(Unstable, match=r"total mass has changed by 0\.101 %"):
                check.observe(sim.snapshot)


def test_relaxation_may_fill_a_basin():
    """The energy grows 25 times; without the effect such a growth is an explosion."""
    scene = replace(basin(), effects=(*basin().effects, Relaxation(time=3600.0)),
                    equilibrium=lambda lon, lat: 1000.0 + 0.0 * lat)  # fmt: skip
    summary = Simulation(scene, **SMALL).run(days=0.5)
    assert summary.completed, summary.reason
    assert summary["mass_drift"] > 3.9


def test_forcing_may_fill_a_basin():
    rate = 800.0 / 43200.0
    scene = replace(basin(), effects=(*basin().effects, effects.Forcing()), steady_forcing=True,
                    forcing=lambda lon, lat, t: (0.0, 0.0, rate))  # fmt: skip
    summary = Simulation(scene, **SMALL).run(days=0.5)
    assert summary.completed, summary.reason
    assert summary["mass_drift"] == pytest.approx(4.0)


def test_what_forcing_can_add_does_not_excuse_more():
    scene = replace(basin(), effects=(*basin().effects, effects.Forcing()),
                    forcing=lambda lon, lat, t: (0.0, 0.0, 1e-3))  # fmt: skip
    sim = Simulation(scene, **SMALL)
    sim.begin()
    check = HealthCheck(sim)
    set_state(sim, lambda values: 4.0 * values)
    with pytest.raises(Unstable, match="energy has grown 16 times"):
        check.observe(sim.snapshot)


def test_what_forcing_can_add_is_the_same_however_often_the_state_is_checked():
    scene = replace(basin(), effects=(*basin().effects, effects.Forcing()),
                    forcing=lambda lon, lat, t: (0.0, 0.0, 1e-3))  # fmt: skip
    sim = Simulation(scene, **SMALL)
    sim.begin()
    check, state = HealthCheck(sim), sim.stepper.state
    for step in range(1, 49):
        check.observe(Snapshot(sim.model, state, 900.0 * step, step, sim))
    set_state(sim, lambda values: 5.0 * values)
    with pytest.raises(Unstable, match=r"energy has grown 1\d\.\d times"):
        check.observe(Snapshot(sim.model, state, 43200.0, 48, sim))


def test_user_defined_effects_may_add_energy_and_the_user_may_limit_it():
    scene = replace(basin(), effects=(*basin().effects, Rain(rate=800.0 / 43200.0)))
    assert Simulation(scene, **SMALL).run(days=0.5).completed
    summary = Simulation(scene, **SMALL, energy_growth=4.0).run(days=0.5)
    assert summary.status == "unstable" and "energy has grown" in summary.reason
    calm = Simulation("williamson2", **SMALL, energy_growth=0.5).run(days=0.1)
    assert calm.status == "unstable"


@pytest.mark.parametrize("stepper", ["rk4", pytest.param("tr-bdf2", marks=pytest.mark.thorough)])
def test_effects_that_wrongly_declare_to_conserve_mass_are_refused(stepper):
    scene = replace(basin(), effects=(*basin().effects, FalseRain(1e-7)))
    summary = Simulation(scene, **SMALL, stepper=stepper).run(days=0.1)
    assert summary.status == "failed" and summary.exit_status == 1
    assert "the effect false-rain changes the total mass by 0.00432 % a day" in summary.reason
    for effect in (Rain(1e-7), Mixing(1e-6)):
        right = replace(basin(), effects=(*basin().effects, effect))
        assert Simulation(right, **SMALL, stepper=stepper).run(days=0.1).completed


def test_no_depth_anywhere_is_refused():
    for depth in (0.0, -0.0, 1e-31):
        with pytest.raises(ConfigError, match="depth"):
            Simulation(basin(depth), **SMALL).run(days=0.1)
    passive = basin(0.0, effects=(effects.MomentumAdvection(),))
    with pytest.raises(ConfigError, match="zero everywhere"):
        Simulation(passive, **SMALL).run(days=0.1)
    assert Simulation("williamson1", **SMALL).run(days=0.1).completed  # zero but for a hill


@pytest.mark.parametrize("stepper", ["rk4", "tr-bdf2", "bdf2", "semi-implicit", "epi3"])
@pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.thorough), 4])
def test_a_callback_that_spoils_the_state_ends_the_run(stepper, step, tmp_path):
    """A fault in the last step ends the run too; the frames before it are kept."""
    seen = []

    def spoil(sim):
        if sim.steps == step:
            sim.stepper.state.fill_(np.nan)

    sim = Simulation("williamson2", **SMALL, stepper=stepper)
    file = tmp_path / "run.nc"
    calls = [spoil, lambda sim: seen.append(sim.steps)]
    summary = sim.run(days=1 / 24, out=file, every=0.25, callbacks=calls)
    assert summary.status == "unstable" and "is NaN" in summary.reason
    assert f"(step {step})" in summary.reason and seen == [*range(1, step)]
    assert get_frames(file) == step


def test_a_callback_that_spoils_the_state_is_named():
    def spoil(sim):
        set_state(sim, lambda x: np.where(np.arange(x.size) == 5, np.nan, x))

    summary = Simulation("williamson2", **SMALL).run(days=1 / 24, callbacks=[spoil])
    reason = "the solution is NaN in u at day 0.01042 (step 1): the callback spoil has changed the"
    assert summary.reason == f"{reason} state"


def test_a_callback_that_left_a_sound_state_is_not_blamed_for_later_faults():
    sim = Simulation("williamson2", **SMALL)
    sim.step()
    check = HealthCheck(sim)
    check.observe(sim.snapshot, Callback(print))
    set_state(sim, lambda x: np.nan * x)
    with pytest.raises(Unstable, match=r"is NaN in .*; try a finer mesh, a smaller dt"):
        check.observe(sim.snapshot)


@pytest.mark.parametrize(
    "nested", [lambda sim: sim.step(), lambda sim: sim.run(days=1 / 12), lambda sim: sim.reset()]
)
def test_a_callback_that_steps_the_simulation_ends_the_run(nested, tmp_path):
    """Frames would be missing without a word."""

    def meddle(sim):
        if sim.steps == 2:
            nested(sim)

    sim, file = Simulation("williamson2", **SMALL), tmp_path / "run.nc"
    summary = sim.run(days=1 / 24, out=file, every=0.25, callbacks=[meddle])
    assert summary.status == "failed" and get_frames(file) == 2
    assert summary.reason.startswith("the callback meddle has stepped, run or reset the simulation")


STEPPERS = [name for name in list_steppers() if get_stepper(name).family != "explicit"]
QUICK = ("ark2", "epi3", "tr-bdf2")


@pytest.mark.parametrize("stepper", [n if n in QUICK else thorough(n) for n in STEPPERS])
@pytest.mark.parametrize("field", ["u", "h"])
@pytest.mark.parametrize("steps", [0, 1])
def test_a_spoilt_state_is_no_fault_of_the_solver(stepper, field, steps):
    sim = Simulation("williamson2", **SMALL, stepper=stepper)
    sim.begin()
    for _ in range(steps):
        sim.step()
    first = sim.model.names.index(field) * sim.model.device_mesh.size
    set_state(sim, lambda x: np.where(np.arange(x.size) == first + 5, np.nan, x))
    when = f"at day {sim.time / 86400.0:.4g} \\(step {steps}\\)"
    with pytest.raises(Unstable, match=f"^the solution is NaN in {field} {when}: correct custom"):
        sim.step()


@pytest.mark.parametrize("stepper", ["ark2", "epi3", "tr-bdf2"])
def test_a_rate_that_is_not_finite_is_no_fault_of_the_solver(stepper):
    scene = basin().with_effect(Shallows())
    sim = Simulation(scene, **SMALL, stepper=stepper)
    sim.step()
    set_state(sim, lambda x: np.where(x == x.max(), 400.0, x))
    reason = "the rate of change of the solution is NaN in h at day 0.01042 "
    with pytest.raises(Unstable, match=reason):
        sim.step()


def get_frames(file) -> int:
    source = RunFile(file)
    assert all(np.isfinite(source.frame(t)["h"]).all() for t in source.times)
    return source.times.size


SPOILT = {
    "NaN": lambda x: np.nan * x,
    "infinite": lambda x: np.inf * x,
    "without depth": lambda x: 0.0 * x,
    "energy": lambda x: 4.0 * x,
    "mass": lambda x: 1.01 * x,
}
"""Changes of a state that the check notices."""


def change_at(count, array, change, monkeypatch) -> None:
    """Have steppers change an array by a function of its values at the end of a step."""
    step = Stepper.step

    def changed(stepper):
        step(stepper)
        if stepper.steps == count:
            array(stepper).assign(change(array(stepper).numpy()))

    monkeypatch.setattr(Stepper, "step", changed)


@pytest.mark.parametrize(
    ("stepper", "kind"),
    [*[thorough("leapfrog", kind) for kind in SPOILT], ("rk4", "NaN"), thorough("bdf2", "NaN")],
)
@pytest.mark.parametrize("continued", [False, True])
def test_the_newest_checkpoint_is_the_last_sound_state(
    continued, stepper, kind, tmp_path, monkeypatch
):
    """A ruined state replaces neither frame nor checkpoint, also of the file that is continued."""
    file, whole = tmp_path / "run.nc", tmp_path / "whole.nc"
    asked = {"every": 0.25, "progress": False}
    Simulation("williamson2", **SMALL, stepper=stepper).run(days=1 / 16, out=whole, **asked)
    sim = Simulation("williamson2", **SMALL, stepper=stepper)
    if continued:
        sim.run(days=1 / 48, out=file, **asked)
        sim = Simulation.from_checkpoint(file)
    with monkeypatch.context() as patch:
        change_at(4, lambda stepper: stepper.state, SPOILT[kind], patch)
        assert sim.run(days=1 / 16, out=file, **asked).status == "unstable"
    before = file.with_name("run.nc.restart").read_bytes()
    with pytest.raises(Unstable):
        sim.checkpoint(file.with_name("run.nc.restart"))
    assert sim.run(days=1 / 16, out=file, **asked).status == "unstable"
    assert file.with_name("run.nc.restart").read_bytes() == before
    assert get_frames(file) == 4
    resumed = Simulation.from_checkpoint(file)
    assert resumed.steps == 3 and resumed.run(days=1 / 16, out=file, **asked).completed
    assert get_frames(file) == 7
    last, right = (RunFile(path).frame(None)["h"] for path in (file, whole))
    assert np.array_equal(last, right)


def test_a_run_that_nothing_observes_ends_soon_after_its_state_is_ruined(monkeypatch):
    sim = Simulation("williamson2", **SMALL)
    change_at(5, lambda stepper: stepper.state, SPOILT["NaN"], monkeypatch)
    assert sim.run(days=0.5, progress=False).status == "unstable" and sim.steps == 16


def test_a_checkpoint_whose_memory_is_not_finite_is_not_written(tmp_path, monkeypatch):
    sim = Simulation("williamson2", **SMALL, stepper="leapfrog")
    file = tmp_path / "run.nc"
    sim.run(days=1 / 24, out=file)
    change_at(8, lambda stepper: stepper.previous, lambda x: np.nan * x, monkeypatch)
    summary = sim.run(days=1 / 12, out=file)
    assert summary.status == "unstable"
    assert summary.reason.startswith("the array previous of stepper leapfrog is not finite at day")
    assert Simulation.from_checkpoint(file).steps == 4 and get_frames(file) == 2


def test_the_message_of_a_method_without_a_stability_limit_names_none():
    sim = Simulation("williamson2", **SMALL, stepper="tr-bdf2")
    sim.begin()
    set_state(sim, lambda x: np.nan * x)
    with pytest.raises(Unstable, match="dt = 900 s, no stability limit at the initial state"):
        HealthCheck(sim).observe(sim.snapshot)


def test_later_observers_see_what_a_callback_has_changed():
    depths = []

    def lower(sim):
        _ = sim.state
        sim.stepper.state.assign(0.9999 * sim.stepper.state.numpy())

    sim = Simulation(basin(), **SMALL)
    calls = [lower, lambda sim: depths.append(float(sim.state.h[0]))]
    summary = sim.run(days=900 / 86400, callbacks=calls)
    assert depths == [pytest.approx(0.9999 * 200.0)]
    assert summary["mass_drift"] == pytest.approx(-1e-4)


def test_errors_of_numerical_libraries_end_a_run_with_its_frames(monkeypatch, tmp_path):
    from scipy.sparse.linalg import ArpackError

    sim = Simulation("williamson2", **SMALL)

    def fail(stepper):
        raise ArpackError(-9999)

    monkeypatch.setattr(sim.stepper_class, "advance", fail)
    summary = sim.run(days=0.1, out=tmp_path / "run.nc")
    assert summary.status == "solver-failed" and "ARPACK" in summary.reason
    assert get_frames(tmp_path / "run.nc") == 1


FLOAT32 = {
    "rk4": 5e-8, "leapfrog": 5e-8, "ark2": 5e-8, "semi-implicit": 5e-8, "tr-bdf2": 5e-7,
    "bdf2": 1e-6,
}  # fmt: skip
"""Largest mass drift in float32 that docs/index.md states."""


@pytest.mark.thorough
@pytest.mark.parametrize("scene", ["williamson5", "williamson6"])
@pytest.mark.parametrize("stepper", FLOAT32)
def test_mass_drift_in_float32_is_what_the_docs_state(stepper, scene):
    sim = Simulation(scene, ne=8, np=4, stepper=stepper, precision="float32")
    summary = sim.run(days=5.0, progress=False)
    assert abs(summary["mass_drift"]) <= FLOAT32[stepper]


@pytest.mark.parametrize("stepper", ["bdf2", "tr-bdf2", "sdirk3"])
def test_many_short_implicit_steps_create_no_mass_in_float32(stepper):
    """Rounding errors of a step do not add up; those of 4/3 and -1/3 would to 2e-5."""
    sim = Simulation("williamson2", ne=3, np=4, stepper=stepper, dt=1200.0, precision="float32")
    summary = sim.run(days=10.0, progress=False)
    assert abs(summary["mass_drift"]) < 1e-6


def test_a_passive_depth_may_undershoot_zero_with_a_custom_effect():
    """The depth accelerates nothing where the wind is prescribed."""
    sim = Simulation("williamson1", ne=8, np=4, dt=600.0, effects=[Leak(1e-6)])
    assert sim.run(days=0.5, progress=False).completed and float(sim.state.h.min()) < 0.0
