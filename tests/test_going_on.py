"""Several runs of one simulation, one after the other, and the files that they leave."""

import shlex
import signal
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from swe_sphere.analysis.accessor import open_run
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.io.reference_solution import SHIPPED
from swe_sphere.logs import print_lines
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import Output, make_config
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, diagnostic
from swe_sphere.simulation.observers import LogLines, Observer, every
from swe_sphere.simulation.simulation import Simulation, run_scene
from swe_sphere.simulation.summary import failed_summary
from swe_sphere.testcases import get_scene


def small(scene="williamson6", **values):
    return Simulation(scene, **{"ne": 2, "np": 4, "dt": 1800.0} | values)


# --- files


@pytest.mark.parametrize("ne", [2, 3])
def test_a_file_that_another_run_has_replaced_is_not_gone_on_with(tmp_path, ne):
    path, one = tmp_path / "run.nc", small()
    one.run(days=0.25, out=path)
    small("williamson2", ne=ne).run(days=0.25, out=path, overwrite=True)
    theirs = path.read_bytes()
    with pytest.raises(ConfigError, match="another"):
        one.run(days=0.5, out=path)
    assert path.read_bytes() == theirs


def test_a_restart_whose_file_another_run_has_replaced_is_not_gone_on_with(tmp_path):
    path = tmp_path / "run.nc"
    small().run(days=0.25, out=path)
    again = Simulation.from_checkpoint(path)
    small("williamson2").run(days=0.25, out=path, overwrite=True)
    with pytest.raises(ConfigError, match="another"):
        again.run(days=0.5, out=path)


def test_a_file_is_known_by_its_place_and_not_by_its_name(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path)
    small("williamson2").run(days=0.25, out="there/run.nc")
    sim = small()
    sim.run(days=0.25, out="run.nc")
    monkeypatch.chdir(tmp_path / "there")
    with pytest.raises(ConfigError, match="holds a finished run of williamson2"):
        sim.run(days=0.5, out="run.nc")
    assert sim.run(days=0.5, out="../run.nc", every=6.0).status == "completed"
    assert open_run("../run.nc").scene == "williamson6"
    assert open_run("../run.nc").sizes["time"] == 3


def test_a_run_without_a_file_between_two_does_not_matter(tmp_path):
    sim, path = small(), tmp_path / "run.nc"
    sim.run(days=0.25, out=path)
    sim.run(days=0.5)
    sim.run(days=0.75, out=path, every=6.0)
    assert open_run(path).time.values.tolist() == [0.0, 21600.0, 43200.0, 64800.0]


@pytest.mark.parametrize("what", ["a folder", "frames", "notes"])
def test_a_checkpoint_takes_the_place_of_a_checkpoint_only(tmp_path, what):
    sim, place = small(), tmp_path / "place"
    if what == "a folder":
        place.mkdir()
    elif what == "frames":
        sim.run(days=0.25, out=place)
    else:
        place.write_text("mine")
    before = place.read_bytes() if place.is_file() else None
    with pytest.raises(ConfigError, match="exists and is not a checkpoint"):
        sim.checkpoint(place)
    assert place.is_dir() if before is None else place.read_bytes() == before
    assert sim.checkpoint(sim.checkpoint(tmp_path / "a")).exists()


def test_a_start_is_gone_on_with_whatever_the_step(tmp_path):
    """Nothing has been stepped yet, so that steps are planned anew."""
    path, asked = tmp_path / "start.nc", {"dt": "auto", "effects": {"viscosity.nu": 1e5}}
    small("williamson2", **asked).run(days=0, out=path)
    again = Simulation.from_checkpoint(path)
    assert again.run(days=1, out=path, overwrite=False).status == "completed"
    assert again.summary["energy"] == small("williamson2", **asked).run(days=1)["energy"]
    assert open_run(path).sizes["time"] == 2
    small("williamson2", dt=1200.0).run(days=0, out=path, overwrite=True)
    assert Simulation.from_checkpoint(path).run(days=0.25)["dt"] == 1200.0


# --- what was asked for


def test_what_a_run_was_asked_for_is_not_asked_of_the_next():
    sim = small()
    assert sim.run(days=0.25, time_limit=1e-9).status == "timed-out"
    assert sim.run(days=0.25).status == "completed"
    with pytest.raises(ConfigError, match="every"):
        sim.run(days=0.5, every=0.7)
    assert sim.run(days=0.5).status == "completed"


def test_a_reference_is_of_the_end_of_the_run():
    day15, day5 = (SHIPPED / f"williamson5_day{day}.nc" for day in (15, 5))
    with pytest.raises(ConfigError, match=r"is of day 15, the run ends at day 0.25"):
        small("williamson5", reference=day15).run(days=0.25)
    early = small("williamson5", reference=day5, dt=3600.0, stepper="semi-implicit")
    assert early.run(days=5)["l2_h"] < 0.05
    for days in (2, 14.99, 15.01):
        with pytest.raises(ConfigError, match=f"is of day 15, the run ends at day {days}"):
            small("williamson5", reference=day15, days=days)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"scene": get_scene("williamson2"), "alpha": 0.7}, "this one is built already"),
        ({"scene": get_scene("williamson2"), "settings": ["scene.alpha=1"]}, "built already"),
        ({"mesh": Mesh.build(3, 4)}, "(ne|np) is given twice: as (ne|np), and by the mesh"),
        ({"restart": "a"}, r"see from_checkpoint\(\)"),
        ({"plot": "a"}, r"see plot\(\)"),
        ({"quiet": True}, "see swe-sphere run"),
    ],
)
def test_what_would_not_be_heard_is_refused(values, said):
    with pytest.raises(ConfigError, match=said):
        small(**values)


def test_a_configuration_holds_all_settings():
    config = make_config({"scene": "williamson6", "ne": 2, "np": 4})
    frame = small().to_xarray()
    for others, said in (
        ({"initial": frame}, "leave out initial"),
        ({"effects": np.ones(2)}, "leave out effects"),
        ({"mesh": Mesh.build(3, 4)}, "the mesh has ne=3"),
    ):
        with pytest.raises(ConfigError, match=said):
            Simulation("williamson6", config=config, **others)
    with pytest.raises(ConfigError, match="for the scene williamson6, not williamson2"):
        Simulation("williamson2", config=config)
    mesh = Mesh.build(2, 4)
    assert Simulation("williamson6", config=config, mesh=mesh).mesh is mesh


def test_a_mesh_may_stand_beside_settings_that_are_none():
    mesh = Mesh.build(3, 4, stretch=2.0, centre=(370.0, 20.0), spin=400.0)
    assert Simulation("williamson6", mesh=mesh, ne=None).mesh is mesh


def test_callbacks_are_only_called_at_multiples_of_their_time():
    """A short continuation with other steps may end before the first of them."""
    hours = []
    sim = Simulation("williamson2", ne=2, np=4)
    sim.run(days=1.3)
    sim.run(days=1.33, callbacks=[every(hours=1)(lambda sim: hours.append(sim.time / 3600.0))])
    assert hours == []
    sim.run(days=1.4, callbacks=[every(hours=1)(lambda sim: hours.append(sim.time / 3600.0))])
    assert hours == pytest.approx([32.0, 33.0])


def test_callbacks_more_often_than_steps_are_not_called_between_them():
    hours = []
    often = every(hours=0.01)(lambda sim: hours.append(sim.time))
    sim = Simulation("williamson2", ne=2, np=4, dt=864.0, days=0.02)
    sim.begin()
    assert sim.run_plan([often]).completed and sim.time not in hours[:-1]


def test_a_summary_without_numbers_and_a_diagnostic_without_a_name():
    sim = Simulation("williamson2", ne=2, np=4)
    assert "None" not in str(sim.outcome) + repr(sim.outcome)
    with pytest.raises(ConfigError, match="needs a name="):
        diagnostic(partial(max, 1))


def test_a_run_that_could_not_begin_has_no_frames():
    class Broken(Observer):
        def begin(self, plan, snapshot):
            raise RunFailed("not today")

    sim = small()
    assert sim.run(days=0.25, callbacks=[Broken()], keep=True).reason == "not today"
    with pytest.raises(ConfigError, match="kept no frames"):
        _ = sim.frames


def test_a_mesh_of_another_planet_is_refused():
    with pytest.raises(ConfigError, match=r"the mesh has radius=1000\.0, and williamson2"):
        Simulation("williamson2", mesh=Mesh.build(2, 4, radius=1e3))


def test_a_checkpoint_is_no_place_for_what_runs_are_asked_for(tmp_path):
    path = small().checkpoint(tmp_path / "a.npz")
    with pytest.raises(ConfigError, match=r"out is not a setting of a simulation: see run\(\)"):
        Simulation.from_checkpoint(path, out=tmp_path / "run.nc")


def test_a_scene_file_edited_meanwhile_is_not_the_scene(tmp_path):
    """What is said of the sources is what was loaded."""
    file, out = tmp_path / "flow.toml", tmp_path / "run.nc"
    file.write_text('base = "williamson2"\nname = "flow"\n')
    sim = small(file)
    file.write_text('base = "williamson2"\nname = "flow"\n[parameters]\nalpha = 1.0\n')
    sim.run(days=0.25, out=out)
    with pytest.raises(ConfigError, match="has been edited"):
        Simulation.from_checkpoint(out, trust=[file])
    file.write_text("no toml")
    assert sim.run(days=0.5).status == "completed"


# --- diagnostics and callbacks


def test_a_resumed_run_keeps_the_settings_that_are_not_given_again(tmp_path):
    path = tmp_path / "run.nc"
    options = {"strength": 0.2, "share": 0.9}
    first = small(stepper="leapfrog", dt=900.0, options=options, effects={"drag.linear": 1e-6})
    first.run(days=0.25, out=path)
    again = run_scene(make_config({
        "scene": "williamson6", "restart": path, "days": 0.5, "settings": ["stepper.share=0.8"],
    }))  # fmt: skip
    assert again.status == "completed"
    assert (again["strength"], again["share"]) == (0.2, 0.8)
    assert again["effects"]["drag"]["linear"] == 1e-6


def test_the_time_of_a_resumed_run_is_shown_alone_and_with_earlier_runs(tmp_path):
    path = tmp_path / "run.nc"
    first = small().run(days=0.25, out=path)
    sim = Simulation.from_checkpoint(path)
    again = sim.run(days=0.5)
    assert again["earlier_seconds"] == first["wall_seconds"] > first["earlier_seconds"] == 0.0
    own = again["wall_seconds"] - again["earlier_seconds"]
    shown = f"{own:.3g} s stepping (with earlier runs {again['wall_seconds']:.3g} s)"
    assert own > 0.0 and shown in str(again) and "earlier" not in str(first)


def test_an_option_with_a_field_replaces_the_setting_of_the_earlier_run(tmp_path):
    path = tmp_path / "run.nc"
    small(stepper="tr-bdf2", options={"tolerance": 1e-6}).run(days=0.25, out=path)
    values = {"scene": "williamson6", "restart": path, "days": 0.5, "tolerance": 1e-3}
    assert run_scene(make_config(values))["tolerance"] == 1e-3


def test_a_diagnostic_may_come_and_go_between_runs(tmp_path):
    sim = small()
    sim.run(days=0.25)
    diagnostic(name="jet", units="m s-1")(lambda sim: float(sim.state.u.max()))
    diagnostic(name="height")(lambda sim: sim.state.h.values)
    done = sim.run(days=0.5, out=tmp_path / "run.nc")
    assert done.status == "completed" and done["jet"] > 10.0
    assert "height" in sim.state
    DIAGNOSTICS.clear()
    assert "height" not in sim.state and "jet" not in sim.summary


@pytest.mark.parametrize("out", [None, "run.nc"])
def test_a_diagnostic_that_fails_is_told_each_time(tmp_path, out):
    diagnostic(name="wrong")(lambda sim: 1 / 0)
    sim = small()
    ended = sim.run(days=0.25, out=out and tmp_path / out)
    assert ended.status == "failed" and "the diagnostic wrong fails" in ended.reason
    assert "the diagnostic wrong fails" in sim._repr_html_() + ended.reason
    for _ in range(2):
        with pytest.raises(Exception, match="the diagnostic wrong fails"):
            _ = sim.state


def test_to_look_at_a_simulation_does_not_begin_it():
    """Its state is the initial one, and it has neither steps nor their lengths."""
    sim = small("williamson2", dt=1e9)
    assert (sim.time, sim.steps, sim.summary["dt"], sim.summary["stable_dt"]) == (
        0.0,
        0,
        None,
        None,
    )
    assert float(sim.state.h.max()) == sim.initial_fields["h"].max()
    assert sim.diagnostics["l2_h"] == 0.0 and "courant_gravity" not in sim.diagnostics
    assert ("result", "not begun at day 0 after 0 steps") in sim.summary.rows()
    assert "not begun" in sim._repr_html_() and "not begun" in repr(sim)
    for name in ("stepper", "plan"):
        with pytest.raises(ConfigError, match="the simulation has not begun: call begin"):
            getattr(sim, name)


def test_a_time_limit_leaves_no_step_uncalled():
    sim, calls = small(), []
    for _ in range(3):
        sim.run(days=0.25, time_limit=1e-9, callbacks=[lambda sim: calls.append(sim.steps)])
    sim.run(days=0.25, callbacks=[lambda sim: calls.append(sim.steps)])
    assert calls == [*range(1, 13)]


def test_calls_fall_on_steps_that_are_taken_at_once():
    sim = Simulation("deformational", ne=2, np=4, dt=300.0, stepper="rk4", tracer_steps=4)
    with pytest.raises(ConfigError, match="3 steps are not a multiple of the 4"):
        sim.run(days=0.5, callbacks=[every(steps=3)(lambda sim: None)])
    calls = []
    sim.run(days=0.5, callbacks=[every(steps=8)(lambda sim: calls.append(sim.steps))])
    assert calls[:3] == [8, 16, 24]


class Gone:
    """A stream that nobody reads any more."""

    def isatty(self):
        return False

    def write(self, text):
        raise BrokenPipeError(32, "Broken pipe")

    def flush(self):
        pass


def test_log_lines_that_nobody_reads_do_not_end_the_run(monkeypatch):
    monkeypatch.setattr(LogLines, "PATIENCE", 0.0)
    monkeypatch.setattr(sys, "stderr", Gone())
    config = make_config({"scene": "williamson6", "ne": 2, "np": 4, "dt": 60.0, "days": 0.25})
    with print_lines():
        assert run_scene(config, [LogLines()]).status == "completed"


def test_a_run_without_depth_has_a_picture(tmp_path):
    asked = {"scene": "williamson5", "ne": 2, "np": 4, "days": 0.1, "fields": "u,v"}
    asked |= {"out": tmp_path / "run.nc", "plot": tmp_path / "run.png"}
    assert run_scene(make_config(asked)).exit_status == 0 and (tmp_path / "run.png").exists()


def test_a_file_that_loses_its_first_frames_to_a_longer_run_is_warned_of(tmp_path):
    sim, path = small(), tmp_path / "run.nc"
    sim.run(days=0.25, out=path, overwrite=True)
    with pytest.warns(UserWarning, match=r"is replaced and begins at day 0\.25: leave overwrite"):
        sim.run(days=0.5, out=path, overwrite=True)


def test_a_cell_of_a_notebook_can_be_run_again(tmp_path):
    sim = Simulation("williamson6", ne=2, np=4, dt=1800.0)
    first, again = (sim.run(days=0.25, out=tmp_path / "a.nc", overwrite=True) for _ in range(2))
    names = ("steps", "days", "rhs_evaluations", "energy_drift", "status")
    assert [first[name] for name in names] == [again[name] for name in names]
    sim.step()
    assert "day 0.2708 of 0.2708 days" in repr(sim)
    sim.reset()
    assert (sim.steps, sim.time, sim.summary.status) == (0, 0.0, "not begun")
    with pytest.raises(ConfigError, match="holds a finished run of williamson6: choose another"):
        sim.run(days=0.25, out=tmp_path / "a.nc")
    assert sim.run(days=0.25)["energy_drift"] == first["energy_drift"]


def test_a_table_in_a_notebook_states_why_a_run_stopped():
    def stop(sim):
        raise RuntimeError("nothing more to see")

    sim = small()
    sim.run(days=0.25, callbacks=[stop])
    assert "nothing more to see" in sim._repr_html_()
    refused = failed_summary({"scene": "williamson6"}, "no such mesh", 2)
    assert "no such mesh" in refused._repr_html_()
    statuses = [failed_summary({}, "", status).status for status in (1, 2)]
    assert statuses == ["failed", "refused"]


# --- files that are gone, states and signals that changed between two runs


def test_a_run_goes_on_without_its_file(tmp_path):
    one, out, other = small(), tmp_path / "one.nc", tmp_path / "other.nc"
    one.run(days=0.25, out=out)
    for end in ("", ".restart"):
        Path(f"{out}{end}").rename(tmp_path / f"moved.nc{end}")
    assert one.run(days=0.375).status == "completed"
    assert one.run(days=0.5, out=other).status == "completed"
    again = Simulation.from_checkpoint(tmp_path / "moved.nc")
    for end in ("", ".restart"):
        (tmp_path / f"moved.nc{end}").unlink()
    assert again.run(days=0.375, out=out).status == "completed"
    assert open_run(out).time.values.tolist() == [0.25 * DAY, 0.375 * DAY]


def test_a_file_that_could_not_be_opened_is_refused_for_the_same_reason_again(tmp_path):
    one = small(fields="nonsense")
    for _ in range(2):
        with pytest.raises(ConfigError, match="unknown field 'nonsense'"):
            one.run(days=0.25, out=tmp_path / "run.nc")


def test_callbacks_beyond_the_end_change_no_step():
    frames, times = [], []
    for late in ([], [every(days=100.123)(lambda sim: times.append(sim.time))]):
        one = Simulation("williamson2", ne=2, np=4)
        one.run(days=1.0, callbacks=late, keep=True)
        frames.append([*one.frames.time.values, one.plan.dt])
    assert frames[0] == frames[1] and not times
    assert small().run(days=0.25, callbacks=[every(days=100.123)(print)]).status == "completed"


def test_a_checkpoint_resumes_the_outputs_of_its_run(tmp_path):
    wind = tmp_path / "wind.nc"
    one = small(outputs=[Output(wind, every=3.0, fields="u,v")])
    one.run(days=0.25)
    saved = one.checkpoint(tmp_path / "saved.restart")
    assert Simulation.from_checkpoint(saved).run(days=0.5).status == "completed"
    assert (open_run(wind).time.values / 3600.0).tolist() == [0.0, 3.0, 6.0, 9.0, 12.0]


def test_a_run_in_a_new_file_leaves_the_frames_of_the_earlier_one(tmp_path):
    """Further files are inherited: --overwrite is not for them, and a branch needs its own."""
    wind, first = tmp_path / "wind.nc", tmp_path / "first.nc"
    one = small(outputs=[Output(wind, every=3.0, fields="u,v")])
    one.run(days=0.25, out=first)
    early = one.checkpoint(tmp_path / "early.restart")
    Simulation.from_checkpoint(first).run(days=0.5, out=tmp_path / "next.nc", overwrite=True)
    whole = [0.0, 3.0, 6.0, 9.0, 12.0]
    assert (open_run(wind).time.values / 3600.0).tolist() == whole
    with pytest.raises(ConfigError, match=r"wind\.nc has later frames of the resumed run"):
        Simulation.from_checkpoint(early).run(days=0.375, out=tmp_path / "branch.nc")
    assert (open_run(wind).time.values / 3600.0).tolist() == whole


def test_a_run_that_was_killed_after_its_last_frame_can_be_completed(tmp_path, monkeypatch):
    out = tmp_path / "run.nc"
    with monkeypatch.context() as patched:
        patched.setattr("swe_sphere.io.netcdf.FrameWriter.finish", lambda self, known: None)
        small().run(days=0.25, out=out)
    before = open_run(out)
    assert not before.attrs.get("completed")
    assert Simulation.from_checkpoint(out).run(days=0.25, out=out).completed
    after = open_run(out)
    assert after.attrs["completed"] and after.h.identical(before.h)
    with pytest.raises(ConfigError, match=r"already at day 0\.25"):
        Simulation.from_checkpoint(out).run(days=0.25, out=out)


def test_an_interrupted_run_has_each_sample_once(tmp_path):
    def stop(sim):
        if sim.steps == 5:
            signal.raise_signal(signal.SIGTERM)

    out = tmp_path / "run.nc"
    ended = small().run(days=1.0, out=out, callbacks=[stop], raises=False)
    assert ended.status == "interrupted"
    assert np.diff(open_run(out).diagnostic_time.values).tolist() == [1800.0] * 5
    Simulation.from_checkpoint(out).run(days=0.25, out=out)
    assert (np.diff(open_run(out).diagnostic_time.values) > 0.0).all()


def test_the_first_frame_shows_a_state_that_was_changed_between_two_runs(tmp_path):
    one, out = small(), tmp_path / "run.nc"
    one.run(days=0.25)
    before = one.summary["max_wind"]
    state = one.stepper.state.numpy().copy()
    state[: 2 * one.mesh.size] *= 0.5
    one.stepper.state.assign(state)
    one.run(days=0.375, out=out)
    assert open_run(out).max_wind.values[0] == pytest.approx(0.5 * before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_that_are_ignored_stay_ignored(number):
    before = signal.signal(number, signal.SIG_IGN)
    try:
        ended = small().run(days=0.25, callbacks=[lambda sim: signal.raise_signal(number)])
    finally:
        signal.signal(number, before)
    assert ended.status == "completed"


def test_a_run_without_stderr(tmp_path):
    code = (
        "from swe_sphere import Simulation as S\nprint(S('williamson2', ne=2).run(days=0.1).status)"
    )
    command = f"exec {sys.executable} -c {shlex.quote(code)} 2>&-"
    found = subprocess.run(command, shell=True, stdout=subprocess.PIPE, text=True, check=True)
    assert found.stdout.strip() == "completed"


def test_a_warning_that_is_an_error_leaves_no_file_behind(tmp_path):
    one = small(outputs=[Output(tmp_path / "gone.nc", every=3.0)])
    one.run(days=0.25)
    (tmp_path / "gone.nc").unlink()
    with warnings.catch_warnings(), pytest.raises(UserWarning, match="does not exist"):
        warnings.simplefilter("error")
        one.run(days=0.5)
    assert not [*tmp_path.iterdir()]


def test_a_diagnostic_that_is_registered_during_a_run_is_named(tmp_path):
    def late(sim):
        DIAGNOSTICS.clear()
        diagnostic(lambda sim: 1.0, name="late")

    with pytest.raises(RunFailed, match="no series of late"):
        ended = small().run(days=0.25, out=tmp_path / "run.nc", callbacks=[late])
        raise RunFailed(ended.reason)
    assert ended.status == "failed"


def test_a_file_does_not_replace_the_diagnostic_of_another_file(tmp_path):
    files = [tmp_path / "one.py", tmp_path / "two.py"]
    text = "from swe_sphere import diagnostic\n@diagnostic\ndef kk(sim): return {}"
    for number, file in enumerate(files):
        file.write_text(text.format(number))
    one = small(diagnostics=files[:1])
    with pytest.raises(ConfigError, match=r"another file has a diagnostic 'kk', .*one\.py: rename"):
        small(diagnostics=files[1:])
    assert one.run(days=0.125)["kk"] == 0.0
    files[0].write_text(text.format(3))
    assert small(diagnostics=files[:1]).run(days=0.125)["kk"] == 3.0
    files[1].write_text(
        text.format(4)
        + "\nfrom swe_sphere import get_scene\ndef scene(): return get_scene('williamson2')"
    )
    with pytest.raises(ConfigError, match="another file has a diagnostic 'kk'"):
        small(scene=files[1])
    assert one.run(days=0.25)["kk"] == 3.0


# --- states that are changed from outside


def change(sim):
    state = sim.stepper.state.numpy().copy()
    state[: sim.mesh.size] += np.cos(sim.mesh.lat)
    sim.stepper.state.assign(state)


def test_a_changed_state_is_seen_at_once():
    sim, found = small(), []

    def changing(sim):
        if sim.steps == 3:
            before = sim.state.u.values.copy()
            change(sim)
            found.append(np.ptp(sim.state.u.values - before))

    sim.run(days=0.125, callbacks=[changing])
    before, drift = sim.state.u.values.copy(), sim.summary["energy_drift"]
    change(sim)
    found.append(np.ptp(sim.to_xarray().u.values - before))
    assert found == pytest.approx([1.0, 1.0], abs=0.1)
    assert sim.summary["energy_drift"] != drift


@pytest.mark.parametrize("stepper", ["leapfrog", "semi-implicit", "bdf2", "forward-backward"])
def test_a_checkpoint_of_a_changed_state_in_a_callback_resumes_bit_for_bit(tmp_path, stepper):
    path = tmp_path / "changed.restart"

    def changing(sim):
        if sim.steps == 3:
            change(sim)
            sim.checkpoint(path)

    sim = small("williamson2", stepper=stepper, dt=900.0)
    sim.run(days=0.125, callbacks=[changing])
    resumed = Simulation.from_checkpoint(path)
    resumed.run(days=0.125)
    assert sim.state.h.equals(resumed.state.h) and sim.state.u.equals(resumed.state.u)


def test_a_diagnostic_of_other_numbers_is_computed_where_the_state_is_not_a_number():
    @diagnostic
    def twice(sim):
        return 2.0 * sim.diagnostics["mass"]

    sim = small()
    sim.step()
    sim.stepper.state.fill_(np.nan)
    assert np.isnan(sim.diagnostics["twice"])
