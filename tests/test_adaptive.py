"""Adaptive steps: the controller, errors that follow the tolerance, cuts, restart, refusals."""

import json
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
from support import thorough

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.io.integrals import flow_integrals
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.adaptive import AdaptiveSteps, step_ratio
from swe_sphere.testcases import get_scene

OUTER = 7200.0


@pytest.fixture(scope="module")
def moving():
    """The unsteady flow of Läuter: its model, start, and the state after two outer steps."""
    model = Model(Mesh.build(3, 4), get_scene("lauter"))
    state, exact = model.initial_state(), STEPPERS["rk4"](model, 30.0)
    exact.start(state)
    for _ in range(480):
        exact.step()
    return SimpleNamespace(model=model, state=state, exact=exact.state.numpy().copy())


def make(
    flow, name: str, tolerance: float, outer: float = OUTER, first: float | None = None
) -> AdaptiveSteps:
    """A stepper at the start of a flow, with the length [s] of its first step."""
    stepper = AdaptiveSteps(STEPPERS[name](flow.model, outer), tolerance)
    stepper.start(flow.state)
    stepper.next_dt = first or stepper.next_dt
    return stepper


def error(flow, name: str, tolerance: float, **options) -> float:
    """Error after two outer steps in the energy norm, relative to the state."""
    stepper = make(flow, name, tolerance, **options)
    stepper.step()
    stepper.step()
    space = stepper.scheme.space
    difference = flow.model.device_mesh.upload(stepper.state.numpy() - flow.exact)
    return space.norm(difference) / space.norm(flow.state)


# --- the rule


@pytest.mark.parametrize(
    ("now", "before", "ratio"),
    [
        (1e-4, 1e-4, 0.9),
        (1e-5, 1e-4, 1.5401949),  # 0.9 * 10^(0.7/3)
        (1e-4, 1e-5, 0.6620780),  # 0.9 * 10^(-0.4/3)
        (2e-4, 5e-5, 0.6980151),  # 0.9 * 2^(-1.1/3)
        (1e-9, 1e-4, 2.0),
        (0.0, 1e-4, 2.0),
        (1.0, 1e-4, 0.5),
        (np.nan, 1e-4, 0.5),
        (np.inf, 1e-4, 0.5),
        (1e-4, 0.0, 0.9),  # no error before tells no trend
        (1e-5, 0.0, 1.5401949),
    ],
)
def test_ratio_of_steps_by_hand(now: float, before: float, ratio: float) -> None:
    assert step_ratio(now, before, 1e-4, 3) == pytest.approx(ratio, rel=1e-6)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf])
def test_a_tolerance_out_of_range_is_refused(moving, tolerance: float) -> None:
    with pytest.raises(ConfigError, match=r"^adaptive: the tolerance must be .* at least 1.11e-16"):
        make(moving, "tr-bdf2", tolerance)


# --- the measures


ESTIMATES = {"tr-bdf2": 3, "esdirk4": 4}


def test_every_stepper_with_an_embedded_method_has_an_estimate() -> None:
    found = {name: getattr(cls, "estimate_order", None) for name, cls in STEPPERS.items()}
    assert {name: order for name, order in found.items() if order is not None} == ESTIMATES
    with_embedded = {name for name, cls in STEPPERS.items() if getattr(cls, "embedded", None)}
    assert with_embedded == ESTIMATES.keys()


@pytest.mark.parametrize("name", ESTIMATES)
def test_estimates_go_with_their_power_of_the_step(moving, name: str) -> None:
    found = []
    for dt in (200.0, 100.0):
        scheme = STEPPERS[name](moving.model, dt, tolerance=1e-9)
        scheme.start(moving.state)
        assert scheme.attempt(0.0, dt) is None
        found.append(scheme.error_estimate())
    assert np.log2(found[0] / found[1]) == pytest.approx(ESTIMATES[name], abs=0.3)


@pytest.mark.parametrize(
    ("name", "power"),
    [("tr-bdf2", 2 / 3), thorough("esdirk4", 2 / 3)],
)
def test_error_goes_with_a_power_of_the_tolerance(moving, name: str, power: float) -> None:
    """esdirk4 has not all of its order where steps are longer than the fastest waves."""
    coarse, fine = (error(moving, name, tol) for tol in (1e-5, 1e-8))
    assert np.log10(coarse / fine) / 3.0 == pytest.approx(power, abs=0.12)


def test_the_solver_is_as_exact_as_the_tolerance_needs(moving) -> None:
    """Solves to the scheme's own tolerance would be the larger error."""
    stepper = make(moving, "tr-bdf2", 1e-7)
    usual = stepper.scheme.solver.largest_tolerance
    stepper.step()
    assert stepper.scheme.solver.largest_tolerance < 0.1 * usual
    loose = make(moving, "esdirk4", 1e-2)
    usual = loose.scheme.solver.largest_tolerance
    loose.step()
    assert loose.scheme.solver.largest_tolerance == usual


# --- the steps


def test_steps_grow_to_the_outer_step_on_a_steady_flow() -> None:
    model = Model(Mesh.build(2, 8), get_scene("williamson2"))
    flow = SimpleNamespace(model=model, state=model.initial_state())
    stepper = make(flow, "tr-bdf2", 1e-4, outer=21600.0, first=100.0)
    taken = [stepper.step() or stepper.counters["accepted_steps"] for _ in range(6)]
    assert stepper.next_dt == 21600.0
    # doubling takes eight for the first; the last ones are each one step
    assert taken[0] < 11
    assert taken[-1] == taken[-2] + 1
    assert stepper.counters["rejected_steps"] == 0


def test_a_first_step_that_is_too_large_is_taken_back_and_noted(moving) -> None:
    stepper = make(moving, "esdirk4", 1e-7, first=OUTER)
    stepper.step()
    cuts = stepper.cuts
    assert len(cuts) == stepper.counters["rejected_steps"] >= 2
    text = "at 0 s a step of {} s was rejected: relative error of a step "
    assert cuts[0].startswith(text.format(7200)) and cuts[0].endswith(" above 1e-07")
    assert cuts[1].startswith(text.format(3600))
    assert error(moving, "esdirk4", 1e-7, first=OUTER) < 1.5e-6


def failing_above(stepper: AdaptiveSteps, longest: float, monkeypatch) -> list[tuple]:
    """Make solves of longer steps fail; the steps that were attempted come into the list."""
    attempt, seen = stepper.scheme.solve_step, []

    def limited(t, dt, out):
        seen.append((t, dt))
        return "no way" if dt > longest else attempt(t, dt, out)

    monkeypatch.setattr(stepper.scheme, "solve_step", limited)
    return seen


def test_a_step_that_cannot_be_solved_is_halved(moving, monkeypatch) -> None:
    stepper = make(moving, "tr-bdf2", 1e-2, first=OUTER)
    seen = failing_above(stepper, 2000.0, monkeypatch)
    stepper.step()
    assert [dt for _, dt in seen[:3]] == [OUTER, OUTER / 2, OUTER / 4]
    assert stepper.cuts[0] == "at 0 s a step of 7200 s was rejected: no way"
    assert stepper.counters["accepted_steps"] + stepper.counters["rejected_steps"] == len(seen)


def test_a_run_that_cannot_go_on_says_so_in_one_line(moving, monkeypatch) -> None:
    stepper = make(moving, "tr-bdf2", 1e-2)
    failing_above(stepper, 0.0, monkeypatch)
    with pytest.raises(RunFailed, match=r"^tr-bdf2: even .* s from 0 s is too long.*no way") as e:
        stepper.step()
    assert "\n" not in str(e.value) and "tolerance" not in str(e.value)


@pytest.mark.parametrize("error", [1.0, np.nan])
def test_a_run_that_never_meets_its_tolerance_is_told_to_ask_for_less(
    moving, error: float, monkeypatch
) -> None:
    stepper = make(moving, "tr-bdf2", 1e-2)
    size = stepper.scheme.space.norm(stepper.state)
    monkeypatch.setattr(stepper.scheme, "error_estimate", lambda: error * size)
    with pytest.raises(RunFailed, match=rf"step {error:g} above 0\.01; choose a larger tolerance"):
        stepper.step()


def test_a_step_that_fails_on_its_way_leaves_the_state_of_its_start(moving, monkeypatch) -> None:
    """Which is the one that belongs to `time`."""
    stepper = make(moving, "tr-bdf2", 1e-2, first=OUTER / 8)
    attempt = stepper.scheme.attempt
    monkeypatch.setattr(
        stepper.scheme, "attempt", lambda t, dt: "no way" if t > OUTER / 4 else attempt(t, dt)
    )
    with pytest.raises(RunFailed):
        stepper.step()
    assert stepper.counters["accepted_steps"] > 1 and stepper.time == 0.0
    assert np.array_equal(stepper.state.numpy(), moving.state.numpy())


def test_steps_fill_the_outer_step_exactly(moving, monkeypatch) -> None:
    stepper = make(moving, "esdirk4", 1e-6, outer=5000.0 / 3.0)
    seen = failing_above(stepper, np.inf, monkeypatch)
    for _ in range(3):
        stepper.step()
    ends = [t + dt for t, dt in seen]
    assert stepper.counters["rejected_steps"] == 0
    assert [t for t, _ in seen[1:]] == pytest.approx(ends[:-1], rel=1e-14)
    assert {5000.0 / 3.0, 10000.0 / 3.0} <= {t for t, _ in seen}
    assert stepper.time == 5000.0
    assert ends[-1] == pytest.approx(5000.0, rel=1e-14)
    assert min(dt for _, dt in seen[1:]) > 0.4 * max(dt for _, dt in seen)


def test_mass_is_kept_to_round_off(moving) -> None:
    stepper = make(moving, "esdirk4", 1e-6, first=OUTER)
    stepper.step()
    model = moving.model
    before, after = (
        flow_integrals(model.mesh, model.scene.planet, **model.fields(state))["mass"]
        for state in (moving.state, stepper.state)
    )
    assert stepper.counters["rejected_steps"] > 0
    assert abs(after / before - 1.0) < 1e-14


# --- restart


@pytest.mark.parametrize("name", ["tr-bdf2", "esdirk4"])
def test_a_restarted_run_is_the_same_to_the_bit(moving, name: str) -> None:
    through = make(moving, name, 1e-5, outer=2400.0)
    through.step()
    memory = through.state_dict()
    again = AdaptiveSteps(STEPPERS[name](moving.model, 2400.0), 1e-5)
    again.load_state_dict(memory, 1)
    for _ in range(2):
        through.step()
        again.step()
    assert again.time == through.time == 7200.0
    assert np.array_equal(again.state.numpy(), through.state.numpy())
    assert again.next_dt == through.next_dt


def test_memory_of_fixed_steps_is_refused(moving) -> None:
    fixed = STEPPERS["tr-bdf2"](moving.model, OUTER)
    fixed.start(moving.state)
    with pytest.raises(ConfigError, match="of a run with fixed steps"):
        make(moving, "tr-bdf2", 1e-5).load_state_dict(fixed.state_dict(), 1)


# --- what cannot be


@pytest.mark.parametrize("name", ["rk4", "sdirk3", "epi3"])
def test_what_has_no_estimate_is_refused_in_one_line(moving, name) -> None:
    line = f"stepper {name} has no error estimate; take one of tr-bdf2, esdirk4"
    with pytest.raises(ConfigError, match=line):
        make(moving, name, 1e-5)


# --- from the command line on


def test_a_run_notes_its_cuts_and_goes_on_from_its_file(tmp_path) -> None:
    asked = {
        "scene": "williamson5", "stepper": "esdirk4", "adaptive": 1e-6, "ne": 2, "np": 4,
        "every": 6.0, "quiet": True,
    }  # fmt: skip
    whole = run_scene(make_config(asked | {"days": 0.5, "out": tmp_path / "whole.nc"}))
    run_scene(make_config(asked | {"days": 0.25, "out": tmp_path / "half.nc"}))
    rest = make_config({"scene": "williamson5", "restart": tmp_path / "half.nc", "days": 0.5})
    rest = run_scene(rest)
    assert (whole["dt"], whole["steps"]) == (21600.0, 2)
    for name in ("l2_h", "energy", "energy_drift", "accepted_steps", "rejected_steps"):
        assert rest[name] == whole[name]
    assert len(whole["cuts"]) == min(100, whole["rejected_steps"])
    with netCDF4.Dataset(tmp_path / "whole.nc") as file:
        summary = json.loads(file.summary)
    assert summary["cuts"] == whole["cuts"]
    assert summary["accepted_steps"] == whole["accepted_steps"] > 2


def test_a_restart_may_ask_for_a_smaller_tolerance(moving) -> None:
    """The error before it, larger than the new tolerance, must not undo the cuts of steps."""
    first = make(moving, "tr-bdf2", 1e-3)
    first.step()
    second = make(moving, "tr-bdf2", 1e-6)
    second.load_state_dict(first.state_dict(), 1)
    second.step()
    assert 0 < second.counters["rejected_steps"] < 30
