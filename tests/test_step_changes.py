"""Steps that change their length during a run: plans, orders, restarts, counts, the summary."""

import gc
import weakref

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from manufactured import DURATION, MESH, STEPS, answer, manufactured, tight

from swe_sphere.cli.main import main
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import DAY, HOUR
from swe_sphere.simulation.config import Output
from swe_sphere.simulation.observers import every
from swe_sphere.simulation.planning import led_plan, time_plan
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.leapfrog import Leapfrog

from .support import thorough


def small(**values):
    return Simulation("williamson6", **{"ne": 2, "np": 4, **values})


SHORTER = {"forward-backward": 0.25, "epi4": 0.7, "epi5": 0.5}
"""Part of the longest step of `STEPS` from which the order shows with the steps of the start."""

# --- plans


@given(
    days=st.integers(5, 40).map(lambda n: n / 10),
    now=st.floats(1.0, 0.4 * DAY),
    hours=st.none() | st.sampled_from([0.1, 0.333333, 0.7, 1.0, 6.0, 9.0]),
    calls=st.none() | st.sampled_from([1800.0, 7200.0]),
    dt=st.floats(100.0, 5000.0),
    cycle=st.integers(1, 4),
)
@settings(max_examples=200, deadline=None)
def test_a_plan_from_any_time_has_the_frames_calls_and_end_of_one_from_the_start(
    days, now, hours, calls, dt, cycle
):
    also = [] if calls is None else [calls]
    whole = time_plan(days, hours, dt, also, cycle, fewer=True, automatic=True)
    plan = led_plan(whole, 7, now, also)
    lengths = [plan.length(step) for step in range(7, plan.steps)]
    assert min(lengths) > 0.0 and max(lengths) <= dt * (1 + 1e-6)
    times = now + np.concatenate([[0.0], np.cumsum(lengths)])
    assert [plan.time(step) for step in range(7, plan.steps + 1)] == pytest.approx(times, abs=1e-5)
    assert times[-1] == pytest.approx(days * DAY, abs=1e-5)
    assert all((n - 7) % plan.cycle == 0 for n in (plan.lead_steps, plan.tail_begin, plan.steps))
    if hours is not None:
        assert_multiples(plan, plan.is_frame, hours if hours != 0.333333 else 1 / 3, now)
    if calls is not None:
        assert_multiples(plan, lambda step: plan.is_multiple(step, calls), calls / HOUR, now)


def assert_multiples(plan, is_due, hours, now):
    """All multiples of a time after the present one and before the end are due, at their times."""
    due = [plan.time(step) / HOUR for step in range(8, plan.steps) if is_due(step)]
    first = int(now / HOUR / hours + 1e-9) + 1
    end = plan.time(plan.steps) / HOUR
    expected = [n * hours for n in range(first, int(end / hours) + 2) if n * hours < end - 1e-6]
    assert due == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("hours", "frames"), [(0.1, 60), (1 / 3, 18), (0.333333, 18), (0.16667, 36)]
)
def test_frames_may_come_more_often_than_automatic_steps(hours, frames):
    sim = small()
    assert sim.run(days=0.25, every=hours).completed
    assert sim.plan.steps // sim.plan.frame_steps == frames
    assert sim.time == 0.25 * DAY


# --- runs one after the other


@pytest.mark.parametrize(
    "stepper", ["rk4", "leapfrog", thorough("semi-implicit"), "bdf2", "epi3", thorough("mis2")]
)
def test_automatic_steps_fit_every_later_end(stepper):
    sim = small(stepper=stepper)
    longest = sim.stepper_class.safety * sim.stable_dt()
    assert sim.run(days=0.3).completed
    first, times = sim.plan.dt, []
    assert sim.run(days=1, callbacks=[every(hours=6)(lambda sim: times.append(sim.time / HOUR))])
    assert sim.summary.completed and times == [12.0, 18.0, 24.0] and sim.time == DAY
    assert sim.plan.dt <= longest * (1 + 1e-9) and sim.plan.dt > 0.5 * first

    sim = small(stepper=stepper)
    sim.step()
    assert sim.run(days=0.25, every=1).completed
    assert sim.time == 0.25 * DAY and all(map(sim.plan.is_frame, (sim.plan.lead_steps, sim.steps)))


def test_a_short_first_run_does_not_shorten_the_steps_of_the_next():
    sim = small()
    sim.run(days=0.01)
    assert sim.plan.dt <= 0.01 * DAY
    assert sim.run(days=1)["dt"] > 2000.0


def test_a_requested_step_stays_and_the_last_one_is_shorter():
    sim = small(dt=1000.0, stepper="leapfrog")
    assert sim.run(days=0.3)["dt"] == pytest.approx(0.3 * DAY / 26)
    summary = sim.run(days=1)
    assert summary.completed and sim.time == DAY and summary["steps"] == 87
    assert summary["dt"] == pytest.approx(0.3 * DAY / 26)
    assert summary["step_changes"] == ["664.615 s from day 0.992308 on"]
    assert ("changed to", "664.615 s from day 0.992308 on") in summary.rows()
    sim.step()
    assert sim.time == pytest.approx(DAY + 0.3 * DAY / 26)
    with pytest.raises(ConfigError, match=r"choose 1\.93846154 or 2\.21538462 h, or dt=auto"):
        sim.run(days=2, every=2)


def test_the_command_line_takes_frames_of_any_interval(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["williamson6", "--ne", "2", "--np", "4", "--quiet", "--out"]

    def run(*more):
        with pytest.raises(SystemExit) as ended:
            main(["run", *words, *more])
        assert not ended.value.code, capsys.readouterr().err

    run("a.nc", "--days", "0.1", "--every", "0.333333")
    run("b.nc", "--days", "0.1", "--every", "0.1")
    run("b.nc", "--days", "0.37", "--restart", "b.nc", "--every", "1")
    run("b.nc", "--days", "0.5", "--restart", "b.nc", "--every", "0.7")
    assert [t / HOUR for t in RunFile("a.nc").times] == pytest.approx(
        [n / 3 for n in range(8)] + [2.4]
    )
    hours = [*(n / 10 for n in range(25)), *range(3, 9), 8.88, 9.1, 9.8, 10.5, 11.2, 11.9, 12.0]
    assert [t / HOUR for t in RunFile("b.nc").times] == pytest.approx(hours)


# --- what stays exact


@pytest.mark.parametrize(
    "stepper", ["rk4", "leapfrog", thorough("semi-implicit"), "forward-backward", "bdf2"]
)
def test_an_automatic_run_that_stopped_resumes_with_its_steps(tmp_path, stepper):
    whole, part = small(stepper=stepper), small(stepper=stepper)
    whole.run(days=0.5)
    part.begin()
    part.run(days=0.5, callbacks=[lambda sim: sim.steps < 2 or stop(sim)])
    part.checkpoint(tmp_path / "a.npz")
    again = Simulation.from_checkpoint(tmp_path / "a.npz")
    again.run(days=0.5)
    assert np.array_equal(again.stepper.state.numpy(), whole.stepper.state.numpy())
    assert again.steps == whole.steps and "step_changes" not in again.summary


@pytest.mark.parametrize("stepper", ["rk4", "bdf2"])
@pytest.mark.parametrize(
    ("settings", "ends", "at"),
    [({}, [0.537], 12), ({}, [0.1, 0.537], 13), ({"dt": 1000.0}, [0.337], 5)],
    ids=["before the last step", "after another change", "with a requested step"],
)
def test_a_run_whose_last_step_is_shorter_resumes_exactly(tmp_path, stepper, settings, ends, at):
    whole, part = small(stepper=stepper, **settings), small(stepper=stepper, **settings)
    for end in ends[:-1]:
        whole.run(days=end)
        part.run(days=end)
    whole.run(days=ends[-1], every=1)
    assert whole.plan.tail_steps == 1 and whole.steps > at
    part.run(days=ends[-1], every=1, callbacks=[lambda sim: sim.steps < at or stop(sim)])
    assert part.steps == at
    part.checkpoint(tmp_path / "a.npz")
    again = Simulation.from_checkpoint(tmp_path / "a.npz")
    again.run(days=ends[-1], every=1)
    assert np.array_equal(again.stepper.state.numpy(), whole.stepper.state.numpy())
    assert again.steps == whole.steps


def stop(sim):
    raise ConfigError("enough")


@pytest.mark.parametrize("stepper", [*STEPPERS])
@pytest.mark.thorough
def test_restarts_after_a_change_are_exact(tmp_path, stepper):
    """From between a change of the step and the next one, and the counts are those of all steps."""
    options = {"stepper": stepper, "dt": 1000.0}
    whole = small(**options)
    whole.run(days=0.1)
    whole.run(days=0.12)
    whole.step()
    whole.checkpoint(tmp_path / "a.npz")
    again = Simulation.from_checkpoint(tmp_path / "a.npz")
    assert (again.steps, again.time) == (whole.steps, whole.time)
    for sim in (whole, again):
        assert sim.run(days=0.151).completed
    assert np.array_equal(again.stepper.state.numpy(), whole.stepper.state.numpy())
    counted = ("steps", "rhs_evaluations", "krylov_iterations", "step_changes", "days", "dt")
    assert [again.summary[name] for name in counted] == [whole.summary[name] for name in counted]
    assert len(whole.summary["step_changes"]) == 3


def test_counts_are_those_of_all_steps():
    sim = small(stepper="rk4", dt=1000.0)
    sim.run(days=0.1)
    assert sim.run(days=0.12)["rhs_evaluations"] == 4 * sim.steps


@pytest.mark.parametrize("name", STEPPERS)
@pytest.mark.thorough
def test_steppers_keep_their_order_where_the_step_changes(name, monkeypatch):
    """On a made solution, with steps of 0.6, 1.6 and 1 times a length, each for a part of it."""
    monkeypatch.setattr(Leapfrog, "default_strength", 0.0)
    model, errors = Model(MESH, manufactured("advection", "pressure", "rotation")), []
    scale = np.repeat([10.0, 10.0, 100.0], MESH.size)
    longest = STEPS.get(name, 450.0) * SHORTER.get(name, 1.0)
    for halvings in range(3):
        stepper, now = None, 0.0
        for part, factor in ((0.3, 0.6), (0.4, 1.6), (0.3, 1.0)):
            count = round(part * DURATION / (0.6 * factor * longest)) * 2**halvings
            earlier, stepper = (
                stepper,
                STEPPERS[name](model, part * DURATION / count, **tight(name)),
            )
            if earlier is None:
                stepper.start(model.initial_state())
            else:
                stepper.follow(earlier, now)
            for _ in range(count):
                stepper.step()
            now += part * DURATION
        assert stepper.time == pytest.approx(DURATION)
        errors.append(float(np.abs((stepper.state.numpy() - answer(DURATION)) / scale).max()))
    # coarse steps do not show the order, and the finest ones reach the solver tolerance
    assert np.log2(np.array(errors[:-1]) / errors[1:]).max() > STEPPERS[name].order - 0.3


@pytest.mark.thorough
@pytest.mark.parametrize("stepper", ["semi-implicit", "tr-bdf2"])
def test_changes_of_step_do_not_keep_the_memory_of_earlier_solvers(stepper, monkeypatch):
    sim, held, make = small(stepper=stepper), [], Simulation._make_stepper

    def made(sim, *arguments):
        gc.collect()
        held.append(sum(x.capacity for x in gc.get_objects() if type(x) is wp.array))
        return make(sim, *arguments)

    monkeypatch.setattr(Simulation, "_make_stepper", made)
    for end in np.cumsum([0.03, 0.02, 0.013] * 3):
        assert sim.run(days=end).completed
    assert len(held) == 9
    assert held[-1] - held[2] < 6 * 8 * sim.stepper.state.capacity  # what recordings hold


def test_wall_time_is_counted_once_over_a_change_of_step():
    """Counters of the steps before the change are added, and the clock of the run just runs on."""
    sim = Simulation("williamson2", ne=2, np=4, stepper="rk4")
    sim.run(days=0.3, progress=False)
    before, evaluations = sim.wall_seconds, sim.counts()["rhs_evaluations"]
    sim.run(days=0.55, progress=False)
    assert len(sim.summary["step_changes"]) >= 1
    counted = sim.counts()
    assert counted["wall_seconds"] == sim.wall_seconds > before
    assert counted["rhs_evaluations"] == 4 * sim.steps > evaluations


def test_changes_of_the_step_do_not_pile_up_steppers():
    """Parts of steppers reference each other: only the garbage collector frees them.

    Arrays are not counted: recorded launches, of which there is a largest number, keep some.
    """
    sim, seconds = Simulation("williamson2", ne=2, np=4, stepper="ark2"), 2000.0
    gc.disable()
    try:
        kept, steppers = [], []
        for k in range(6):
            sim.run(days=seconds / 86400.0, progress=False)
            steppers.append(weakref.ref(sim.stepper))
            kept.append(sum(each() is not None for each in steppers))
            seconds += (700.0, 2433.0)[k % 2]
    finally:
        gc.enable()
    assert len(sim.summary["step_changes"]) == 5 and kept[5] == kept[4] == kept[3]


def test_a_refused_run_leaves_the_options_of_the_next_one(tmp_path):
    sim = small(dt=1000.0, stepper="rk4")
    sim.run(days=0.1)
    with pytest.raises(ConfigError, match="every"):
        sim.run(days=0.3, outputs=[Output(tmp_path / "a.nc", every=0.7)])
    other = tmp_path / "other.txt"
    other.write_text("not of a run")
    with pytest.raises(ConfigError):
        sim.run(days=0.2, outputs=[Output(other)])
    assert sim.config.outputs == () and sim.run(days=0.2).completed
