"""The run: time plan, configuration, health check, restart, interruption."""

import json
import os
import re
import signal
import threading
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swe_sphere.errors import ConfigError
from swe_sphere.io.checkpoint import checkpoint_path, read_checkpoint
from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import DAY, HOUR
from swe_sphere.ranks.communicator import Communicator
from swe_sphere.settings.values import by_field, read_toml
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.observers import HealthCheck, Observer
from swe_sphere.simulation.planning import RunPlan, automatic_step, continued_plan, time_plan
from swe_sphere.simulation.simulation import Simulation, run_scene

SMALL = {"ne": 2, "np": 4, "days": 1.0}


def small(scene="williamson2", **values):
    return run_scene(make_config({"scene": scene, **SMALL, **values}))


# --- time plan


@given(
    days=st.integers(1, 200).map(lambda n: n / 10),
    every=st.none() | st.integers(1, 96).map(float),
    dt=st.floats(1.0, 1800.0),
)
@settings(max_examples=200, deadline=None)
def test_steps_are_equal_and_frames_and_end_fall_on_them(days, every, dt):
    plan = time_plan(days, every, dt)
    assert 0.499 * dt <= plan.dt <= dt * (1 + 1e-9)
    assert plan.time(plan.steps) == pytest.approx(days * DAY, abs=1e-6)
    assert plan.tail_begin * plan.dt + plan.tail_steps * plan.tail_dt == pytest.approx(
        days * DAY, abs=1e-6
    )
    assert plan.tail_steps <= 1 and plan.tail_dt < plan.dt
    assert plan.is_frame(0) and plan.is_frame(plan.steps)
    if every is not None and every * HOUR < days * DAY:
        assert plan.frame_steps * plan.dt == pytest.approx(every * HOUR, rel=1e-12)


def stand_in(limit, family="explicit", u=(0.0,), v=(0.0,), **kind):
    """What an automatic step is chosen by: a stepper, its limit [s], winds [m s-1], 1 km."""
    given = {"name": "a", "family": family, "safety": 0.9, "courant": 2.0, "longest": 3000.0}
    kind = {**given, "long_run_factor": 1.0, **kind}
    return SimpleNamespace(
        days=1.0,
        stepper_class=SimpleNamespace(**kind),
        stable_dt=lambda: limit,
        limiting_times=lambda: [0.0],
        model=SimpleNamespace(
            initial_state=lambda: None,
            fields=lambda state, t: {"u": np.array(u), "v": np.array(v)},
        ),
        mesh=SimpleNamespace(spacing=lambda: (1000.0, 1000.0)),
    )


def test_automatic_step_stays_within_the_safe_part_of_the_limit():
    dt, rule = automatic_step(stand_in(1000.0, longest=5000.0), 1.0)
    assert (dt, rule) == (900.0, "0.9 of the stability limit")
    plan = time_plan(1.0, None, dt)
    assert plan.dt == 900.0 and plan.steps == 96 and plan.frame_steps == 96


def test_automatic_step_without_a_limit_is_the_accurate_one():
    assert automatic_step(stand_in(np.inf), 1.0)[0] == 3000.0
    assert automatic_step(stand_in(np.inf), 1e-3)[0] == pytest.approx(86.4)
    dt, rule = automatic_step(stand_in(np.inf, u=(0.0, 3.0), v=(0.0, -4.0)), 1.0)
    assert (dt, rule) == (400.0, "advective Courant number 2, at most 3000 s")
    assert automatic_step(stand_in(np.inf, u=(5e-3,)), 1.0)[0] == 3000.0


def test_an_automatic_step_from_rest_is_an_accurate_one_within_the_limit():
    assert automatic_step(stand_in(9000.0, "imex"), 1.0)[0] == 3000.0
    assert automatic_step(stand_in(2000.0, "imex"), 1.0)[0] == 1800.0
    assert automatic_step(stand_in(9000.0, "imex", u=(1.0,)), 1.0)[0] == 8100.0
    assert automatic_step(stand_in(9000.0), 1.0)[0] == 8100.0


def test_an_automatic_step_needs_a_limit():
    with pytest.raises(ConfigError, match="the stability limit of a is nan s: choose a step"):
        automatic_step(stand_in(np.nan), 1.0)


def test_frames_come_about_daily_where_nothing_is_said():
    assert time_plan(5.0, None, 600.0).frame_steps == 144
    assert time_plan(0.5, None, 600.0).frame_steps == 72
    assert time_plan(20.0, None, 2 * DAY).frame_steps == 1


def test_frames_need_not_divide_the_length():
    plan = time_plan(1.0, 9.0, 3600.0)
    assert [step for step in range(plan.steps + 1) if plan.is_frame(step)] == [0, 9, 18, 24]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((1.0, None, 2 * DAY), "longer than the whole run"),
        ((1.0, None, 1e-200), "more than"),
        ((1.0, 0.4, 3600.0), "fits frames every 0.4 h: change every, or take dt=1440"),
        (
            (1.0, 1.0, 3600.0, [3600.5]),
            "fits frames every 1 h and callbacks or files every 1.00014 h",
        ),
        ((1e-12, None, 1.0), "too short"),
    ],
)
def test_plans_that_cannot_be(arguments, word):
    with pytest.raises(ConfigError, match=word):
        time_plan(*arguments)


def test_continued_plan_keeps_the_step():
    before = RunPlan(600.0, 100, 50, 700.0)
    plan = continued_plan(before, 2.0, 6.0, done=100)
    assert (plan.dt, plan.steps, plan.frame_steps) == (600.0, 288, 36)
    with pytest.raises(ConfigError, match="already"):
        continued_plan(before, 2.0, None, done=288)
    plan = continued_plan(before, 24.01 / 24, None, done=1)
    assert (plan.dt, plan.steps, plan.tail_steps, round(plan.tail_dt, 6)) == (600.0, 145, 1, 36.0)
    with pytest.raises(ConfigError, match="whole number of steps of 600 s: choose 1 or 1"):
        continued_plan(before, 2.0, 1.1, done=1)


# --- configuration


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"dt": -1}, "dt: must be a positive number of seconds or 'auto', got -1"),
        ({"dt": float("nan")}, "dt: must be a positive"),
        ({"days": -1}, "days: must be greater than or equal to 0, got -1"),
        ({"alpha": float("nan")}, "alpha: must be a finite number"),
        ({"ne": 2.5}, "ne: must be a valid integer"),
        ({"precision": "float16"}, "precision: must be 'float64' or 'float32', got 'float16'"),
        ({"centre_lon": "east"}, "centre-lon: must be a valid number"),
        ({"nee": 3}, "unknown option 'nee'; did you mean 'ne'"),
        ({"settings": {"viscosity": 3}}, "set: must be tables"),
    ],
)
def test_an_unfit_value_is_named_in_one_line(values, word):
    with pytest.raises(ConfigError) as error:
        make_config({"scene": "williamson2", **values})
    assert str(error.value).startswith(word)
    assert "\n" not in str(error.value)


def test_a_file_says_all_that_flags_can(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(
        'scene = "galewsky"\ndt = "auto"\ncentre-lon = 30.0\njson = true\n'
        "[set.viscosity]\nnu = 1e5\n[set.scene]\nperturbed = false\n"
    )
    config = make_config(by_field(read_toml(file)))
    assert config.settings == (("viscosity", "nu", 1e5), ("scene", "perturbed", False))
    assert (config.centre_lon, config.as_json, config.dt) == (30.0, True, "auto")


# --- runs


def test_a_run_counts_times_and_judges():
    summary = small(dt=3600.0)
    numbers = json.loads(summary.as_json())
    assert numbers["completed"] is True and numbers["reason"] is None
    assert (numbers["steps"], numbers["dt"], numbers["rhs_evaluations"]) == (24, 3600.0, 96)
    assert 1e-5 < numbers["l2_h"] < 5e-3
    assert abs(numbers["mass_drift"]) < 1e-14
    assert 0.0 < numbers["wall_seconds"] < numbers["total_seconds"]


def test_no_errors_without_an_exact_solution():
    numbers = json.loads(small("williamson6", days=0.1).as_json())
    assert all(numbers[name] is None for name in ("l1_h", "l2_h", "linf_h", "l2_v"))


def test_a_prescribed_wind_has_no_error_no_energy_and_no_gravity_waves():
    numbers = json.loads(small("williamson1").as_json())
    assert numbers["l2_v"] is None and numbers["l2_h"] > 0.0
    assert numbers["energy_drift"] is None and numbers["enstrophy_drift"] is None
    assert numbers["courant_advective"] > 0.0 and "courant_gravity" not in numbers


def test_settings_reach_scene_and_effects():
    calm, thick = small(dt=3600.0), small(dt=3600.0, settings=["viscosity.nu=1e6"])
    tilted = small(dt=3600.0, settings=["scene.alpha=0.7"])
    assert thick["energy_drift"] < 10 * calm["energy_drift"] < 0.0
    assert tilted["l2_h"] == small(dt=3600.0, alpha=0.7)["l2_h"] != calm["l2_h"]


def test_too_long_a_step_is_warned_of_and_found_out():
    texts = []
    values = {"scene": "williamson2", **SMALL, "days": 20.0, "dt": 28800.0}
    summary = run_scene(make_config(values), warn=texts.append)
    assert re.search(r" 3\.3\d times the stability limit", texts[0])
    assert not summary.completed and summary.exit_status == 1
    assert "take a smaller dt" in summary.reason
    assert summary["l2_h"] is None and summary["steps"] < 60


def test_frames_are_kept_when_a_run_fails(tmp_path):
    file = tmp_path / "failed.nc"
    summary = small(days=20.0, dt=28800.0, every=8.0, out=file)
    kept = RunFile(file)
    assert not summary.completed and 2 <= kept.times.size < 60
    for time in kept.times:
        assert all(np.isfinite(values).all() for values in kept.frame(time).values())
    assert kept.attributes["reason"] == summary.reason


DAMPED = ("hyperviscosity.factor=30",)


@pytest.mark.parametrize(
    ("stepper", "settings"),
    [(name, DAMPED) for name in ("rk4", "ssprk3", "kg5", "leapfrog")]
    + [(name, ()) for name in ("tr-bdf2", "bdf2", "semi-implicit", "ark2")],
)
@pytest.mark.thorough
def test_a_restart_goes_on_bit_for_bit(tmp_path, stepper, settings):
    """Also where the set-up of the preconditioner in use was made for an earlier depth."""
    whole, part, rest = (tmp_path / name for name in ("whole.nc", "part.nc", "rest.nc"))
    values = {"stepper": stepper, "every": 6.0, "settings": settings}
    through = small("williamson6", **values, out=whole)
    small("williamson6", **{**values, "days": 0.5}, out=part)
    config = {"scene": "williamson6", "days": 1.0, "restart": part, "out": rest}
    restarted = run_scene(make_config(config))
    for field in ("u", "v", "h"):
        assert np.array_equal(RunFile(whole).values(field), RunFile(rest).values(field))
    same = ("dt", "steps", "rhs_evaluations", "krylov_iterations", "mass_drift", "energy_drift")
    for name in same:
        assert through[name] == restarted[name], name
    assert RunFile(rest).times.tolist() == [12 * HOUR, 18 * HOUR, 24 * HOUR]


@pytest.mark.parametrize("stepper", ["rk4", "bdf2"])
def test_a_checkpoint_stands_where_the_last_frame_does(tmp_path, stepper):
    """Its time and steps are those of the frame, its state is that frame, its counts are told."""
    file = tmp_path / "part.nc"
    summary = small("williamson6", stepper=stepper, days=0.25, dt=1800.0, every=2.0, out=file)
    found, frames = read_checkpoint(file), RunFile(file)
    assert (found.steps, found.attributes["stepper"]) == (12, stepper)
    assert Simulation.from_checkpoint(file).time == 6.0 * HOUR
    assert frames.times.tolist() == [0.0, 2.0 * HOUR, 4.0 * HOUR, 6.0 * HOUR]
    fields = np.concatenate([frames.frame()[name] for name in "uvh"])
    assert np.array_equal(found.state_dict["state"], fields)
    assert found.state_dict["counter_rhs_evaluations"] == summary["rhs_evaluations"]
    assert found.attributes["run_id"] == frames.attributes["run_id"]


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"scene": "williamson2"}, "scene is 'williamson6' there and 'williamson2' here"),
        ({"ne": 3}, "ne is 2 there and 3 here"),
        ({"stepper": "leapfrog"}, "stepper is 'rk4' there and 'leapfrog' here"),
        ({"precision": "float32"}, "precision is 'float64' there"),
        ({"settings": ["viscosity.nu=1"]}, "effects is"),
        ({"dt": 100.0}, "keeps the step of its file"),
        ({"days": 0.25}, "already"),
        ({"restart": "moved.nc"}, "moved.nc has no checkpoint: there is no file moved.nc.restart"),
        ({"restart": "other.nc"}, "other.nc: it is not a file of a run"),
    ],
)
def test_a_restart_of_another_run_is_refused(tmp_path, monkeypatch, values, word):
    monkeypatch.chdir(tmp_path)
    small("williamson6", days=0.25, dt=3600.0, out="part.nc")
    before = (tmp_path / "part.nc").read_bytes()
    (tmp_path / "moved.nc").write_bytes(before)
    netCDF4.Dataset("other.nc", "w").close()
    config = {"scene": "williamson6", "restart": "part.nc", "days": 1.0, **values}
    with pytest.raises(ConfigError, match=word):
        run_scene(make_config(config))
    assert (tmp_path / "part.nc").read_bytes() == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_run_can_be_restarted(tmp_path, number):
    """The signal comes after the first tick; what is left is a whole state, and goes on."""

    class Stop(Observer):
        def tick(self, step):
            os.kill(os.getpid(), number)

    file = tmp_path / "stopped.nc"
    handler = signal.default_int_handler  # under nohup hangups are ignored, also by runs
    before = signal.signal(number, handler)
    values = {"scene": "williamson6", **SMALL, "days": 2.0, "dt": 1800.0, "out": file}
    summary = run_scene(make_config(values), [Stop()])
    assert signal.signal(number, before) is handler
    assert summary.exit_status == 130 and not summary.completed
    assert summary.reason.startswith("interrupted by ")
    assert 0 < summary["steps"] < 96
    assert RunFile(file).times[-1] == summary["steps"] * 1800.0
    for restart in (file, checkpoint_path(file)):
        restarted = run_scene(make_config({"scene": "williamson6", "restart": restart}))
    assert restarted["energy_drift"] == small("williamson6", days=2.0, dt=1800.0)["energy_drift"]


def test_a_run_goes_on_where_hangups_are_ignored():
    """As nohup asks for."""

    class HangUp(Observer):
        def tick(self, step):
            os.kill(os.getpid(), signal.SIGHUP)

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run_scene(make_config({"scene": "williamson6", **SMALL}), [HangUp()]).completed
    finally:
        signal.signal(signal.SIGHUP, before)


class Harm(Observer):
    """Does something to the file of a run, at its first step or after its last."""

    def __init__(self, harm, moment):
        self.harm, self.moment = harm, moment

    def tick(self, step):
        if self.moment == "tick":
            self.harm()

    def end(self):
        if self.moment == "end":
            self.harm()


@pytest.mark.parametrize("moment", ["tick", "end"])
@pytest.mark.parametrize("harm", ["deleted", "cut short"])
def test_a_run_whose_file_is_deleted_or_cut_has_failed(tmp_path, harm, moment):
    file = tmp_path / "gone.nc"
    does = {"deleted": file.unlink, "cut short": lambda: os.truncate(file, 1000)}[harm]
    values = {"scene": "williamson6", **SMALL, "days": 2.0, "dt": 1800.0, "every": 24.0}
    summary = run_scene(make_config({**values, "out": file}), [Harm(does, moment)])
    assert (summary.completed, summary.exit_status) == (False, 1)
    assert f"{file} was {harm}" in summary.reason and "\n" not in summary.reason
    assert summary["steps"] == {"tick": 1, "end": 96}[moment]


def test_a_run_interrupted_at_a_frame_writes_it_once(tmp_path, monkeypatch):
    look = HealthCheck.observe

    def stop_and_look(self, snapshot):
        look(self, snapshot)
        if snapshot.steps == 4:
            monkeypatch.setattr(HealthCheck, "observe", look)  # a second signal would end pytest
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(HealthCheck, "observe", stop_and_look)
    file = tmp_path / "stopped.nc"
    summary = small(dt=1800.0, every=2.0, out=file)
    assert (summary.exit_status, summary["steps"]) == (130, 4)
    assert RunFile(file).times.tolist() == [0.0, 7200.0]


def test_a_step_waits_for_no_numbers_of_all_ranks(monkeypatch):
    gather, calls = Communicator.allgather_arrays, []

    def counted(*given):
        calls.append(1)
        return gather(*given)

    monkeypatch.setattr(Communicator, "allgather_arrays", counted)
    assert small(dt=900.0)["steps"] > 4 * len(calls)


def test_a_run_that_takes_too_long_ends_in_good_order(tmp_path):
    file = tmp_path / "late.nc"
    values = {"days": 2000.0, "dt": 1800.0, "every": 24.0, "time_limit": 0.3, "out": file}
    summary = small("lake-at-rest", **values)
    assert (summary.exit_status, summary.completed) == (1, False)
    assert summary.reason.startswith("the time limit of 0.3 s was reached at day ")
    assert summary["total_seconds"] > 0.3
    assert RunFile(file).times[-1] == summary["steps"] * 1800.0
    assert small(time_limit=1000.0).completed


def test_a_run_outside_the_main_thread_leaves_signals_alone():
    found = []
    thread = threading.Thread(target=lambda: found.append(small(days=0.1).completed))
    thread.start()
    thread.join()
    assert found == [True]


@pytest.mark.parametrize("stepper", ["semi-implicit", "ars343"])
def test_a_fluid_at_rest_does_not_get_a_step_as_long_as_the_run(stepper: str) -> None:
    """Split steppers are limited by the wind alone, and there is none when the dam breaks."""
    config = make_config({"scene": "dam-break", "stepper": stepper, "ne": 4, "days": 0.5})
    sim = Simulation(config.scene, config=config)
    sim.begin()
    assert sim.plan.dt == 3600.0
