"""Signals and time limits: a run stops soon, also within a step, and nothing is lost."""

import os
import signal
import time

import numpy as np
import pytest

from swe_sphere.analysis.accessor import open_run
from swe_sphere.cli.main import main
from swe_sphere.errors import Interrupted
from swe_sphere.io.runfile import RunFile
from swe_sphere.ranks import limits
from swe_sphere.simulation import build
from swe_sphere.simulation.loop import Interruption
from swe_sphere.simulation.observers import Callback
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers.stepper import Stepper, Trajectory
from swe_sphere.testcases import get_scene

from .support import thorough
from .test_tracers import with_tracers

LONG = {
    "adaptive": {"stepper": "esdirk4", "adaptive": 1e-3, "dt": 21600.0},
    "implicit": {"stepper": "tr-bdf2", "dt": 10800.0},
    "multistep": {"stepper": "bdf2", "dt": 7200.0},
    "gauss": {"stepper": "gauss-legendre", "dt": 10800.0},
    "exponential": {"stepper": "epi3", "dt": 3600.0},
}
"""Steppers whose steps may be given up."""


CARRYING = with_tracers(get_scene("williamson6"))
LARGE = {
    "semi-implicit": {"stepper": "semi-implicit", "dt": 1800.0},
    "imex": {"stepper": "ark2", "dt": 3600.0},
    "tracers": {"scene": CARRYING, "stepper": "forward-backward", "dt": 600.0, "tracer_steps": 3},
    "tracers in stages": {"scene": CARRYING, "stepper": "fb-rk3", "dt": 900.0, "tracer_steps": 4},
    "tracers with waves": {
        "scene": CARRYING, "stepper": "semi-implicit", "dt": 900.0, "tracer_steps": 4,
    },
    "wind": {"scene": "deformational", "dt": 1800.0, "tracer_steps": 4},
}  # fmt: skip
"""Runs whose steps may be given up on large meshes."""


def small(**values):
    given = {"scene": "williamson6", "ne": 2, "np": 4} | values
    return Simulation(given.pop("scene"), **given)


def at_call(count, act, monkeypatch):
    """Act once within a solve, where a step asks for the `count`th time whether to stop."""
    calls, check = [], limits.check_stop

    def counted():
        calls.append(None)
        if len(calls) == count:
            act()
        check()

    for module in (
        "solvers.krylov", "steppers.exponential", "steppers.implicit",
        "steppers.tracer_steps", "operators.tracers",
    ):  # fmt: skip
        monkeypatch.setattr(f"swe_sphere.{module}.check_stop", counted)
    return calls


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize(
    "kind", [thorough("adaptive"), "implicit", "multistep", thorough("gauss"), "exponential"]
)
@pytest.mark.parametrize("count", [thorough(3), 25])
def test_ctrl_c_within_a_step_is_heard_there_and_loses_nothing(tmp_path, monkeypatch, kind, count):
    out, whole = tmp_path / "run.nc", tmp_path / "whole.nc"
    small(**LONG[kind]).run(days=1.0, every=12.0, out=whole)
    sim = small(**LONG[kind])
    with monkeypatch.context() as patch:
        calls = at_call(count, interrupt, patch)
        with pytest.raises(KeyboardInterrupt):
            sim.run(days=1.0, every=12.0, out=out)
        assert len(calls) <= count + 1
    assert sim.outcome.status == "interrupted"
    found = RunFile(out)
    assert found.frame_time(None) == sim.time and found.attributes["status"] == "interrupted"
    again = Simulation.from_checkpoint(out, LONG[kind].get("scene"))
    assert again.run(days=1.0, every=12.0, out=out).completed
    assert sim.run(days=1.0, every=12.0).completed  # in the same process, too
    right = open_run(whole).h[-1]
    assert np.array_equal(open_run(out).h[-1], right) and np.array_equal(sim.state.h, right)


@pytest.mark.parametrize(
    "kind", ["imex", *map(thorough, [kind for kind in LARGE if kind != "imex"])]
)
@pytest.mark.parametrize("count", [thorough(3), 14])
def test_ctrl_c_within_a_step_on_a_large_mesh_is_heard_there(tmp_path, monkeypatch, kind, count):
    monkeypatch.setattr("swe_sphere.steppers.stepper.LARGE", 1)
    monkeypatch.setitem(LONG, kind, LARGE[kind])
    test_ctrl_c_within_a_step_is_heard_there_and_loses_nothing(tmp_path, monkeypatch, kind, count)


@pytest.mark.parametrize("kind", [*LARGE])
def test_steps_on_small_meshes_are_not_copied_before_they_are_taken(monkeypatch, kind):
    def fail(stepper):
        raise AssertionError

    monkeypatch.setattr(Trajectory, "restore_point", fail)
    assert small(**LARGE[kind]).run(days=0.25).completed


def test_every_family_with_long_steps_may_give_them_up():
    from swe_sphere.steppers.stepper import STEPPERS

    for cls in STEPPERS.values():
        assert issubclass(cls, Stepper)
        assert cls.can_give_up == (cls.family in ("implicit", "exponential")), cls.name


def test_the_time_limit_is_looked_at_within_a_step(tmp_path, monkeypatch):
    now, clock = [0.0], time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: clock() + now[0])
    calls = at_call(5, lambda: now.append(now.pop() + 1e6), monkeypatch)
    sim = small(**LONG["adaptive"])
    ended = sim.run(days=2.0, time_limit=1e5, out=tmp_path / "run.nc")
    assert (ended.status, sim.steps, len(calls)) == ("timed-out", 0, 5)
    assert "at day 0 (step 0 of 8)" in ended.reason


def test_the_time_limit_counts_from_the_beginning_of_the_command(tmp_path, monkeypatch, capsys):
    """Start-up, compiling, diagnostics and writing included."""
    out = tmp_path / "run.nc"
    clock, late = time.monotonic, []
    monkeypatch.setattr(time, "monotonic", lambda: clock() + sum(late))
    start_warp = build.start_warp

    def slow():
        start_warp()
        late.append(1000.0)

    monkeypatch.setattr(build, "start_warp", slow)
    words = ["run", "williamson2", "--ne=2", "--np=4", "--days=9", f"--out={out}", "--time-limit"]
    with pytest.raises(SystemExit) as end:
        main([*words, "900"])
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert "the time limit of 900 s was reached" in said and "resume with:" in said
    assert Simulation.from_checkpoint(out).steps == 1


def test_in_python_the_limit_counts_from_the_call(monkeypatch):
    sim = small(dt=1800.0)
    clock = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: clock() + 1e6)
    assert sim.run(days=0.25, time_limit=1e5).completed


def test_the_age_of_the_process_is_known():
    before = limits.process_age()
    time.sleep(0.05)
    assert 0.0 < before < limits.process_age() < 1e6


def send(number):
    return lambda sim: os.kill(os.getpid(), number) if sim.steps == 3 else None


def test_ctrl_c_in_a_script_closes_the_file_and_ends_the_loop_around_the_run(tmp_path):
    done = []
    with pytest.raises(KeyboardInterrupt):
        for k in range(3):
            small(dt=1800.0).run(
                days=0.25, out=tmp_path / f"{k}.nc", callbacks=[send(signal.SIGINT)]
            )
            done.append(k)
    assert not done
    assert RunFile(tmp_path / "0.nc").frame_time(None) == 3 * 1800.0
    small(dt=1800.0).run(days=0.25, out=tmp_path / "0.nc", overwrite=True)  # nobody has it open


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP])
def test_other_signals_take_effect_when_the_file_is_closed(tmp_path, number):
    heard = []
    before = signal.signal(number, lambda *_: heard.append(number))
    try:
        ended = small(dt=1800.0).run(days=0.25, out=tmp_path / "a.nc", callbacks=[send(number)])
    finally:
        signal.signal(number, before)
    assert (ended.status, heard) == ("interrupted", [number])
    assert ended.reason.startswith(f"interrupted by {number.name} at day 0.0625")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_message_of_a_signal_between_two_runs_and_within_one_is_the_same(number):
    name = "Ctrl-C" if number == signal.SIGINT else number.name
    sim = small(dt=1800.0, days=0.25)
    sim.begin()
    with Interruption() as noted:
        with pytest.raises(Interrupted, match=f"^interrupted by {name}$"):
            sim.run_plan([Callback(send(number))], interruption=noted)
        with pytest.raises(Interrupted, match=f"^interrupted by {name}$"):
            noted.check()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1])
def test_the_command_prints_how_to_resume_and_ends_with_130(tmp_path, monkeypatch, capsys, number):
    out = tmp_path / "run.nc"
    at_call(9, lambda: os.kill(os.getpid(), number), monkeypatch)
    with pytest.raises(SystemExit) as end:
        main([
            "run", "williamson6", "--ne=2", "--np=4", "--stepper=tr-bdf2", "--dt=3600",
            "--days=2", f"--out={out}",
        ])  # fmt: skip
    assert end.value.code == 130
    name = "Ctrl-C" if number == signal.SIGINT else number.name
    said = capsys.readouterr().err
    assert f"interrupted by {name} at day" in said and f"--restart {out}" in said


def test_a_block_leaves_the_handlers_as_they_were():
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    with Interruption():
        assert all(signal.getsignal(n) is not b for n, b in zip(numbers, before, strict=True))
    assert [signal.getsignal(number) for number in numbers] == before


def test_handlers_from_outside_of_python_are_left_alone(monkeypatch):
    """Python cannot restore them: it knows them as None."""
    before = signal.getsignal(signal.SIGUSR1)
    known = signal.getsignal
    foreign = signal.SIGUSR1
    monkeypatch.setattr(signal, "getsignal", lambda n: None if n == foreign else known(n))
    with Interruption():
        assert known(foreign) is before
    assert known(foreign) is before
