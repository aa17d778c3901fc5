"""`Simulation` in Python: objects for names, callbacks, diagnostics, state, checkpoints."""

import copy
import json
import os
import pickle
import re
import signal
import time
from dataclasses import replace
from itertools import product

import matplotlib as mpl
import netCDF4
import numpy as np
import pytest
import warp as wp
import xarray as xr

from swe_sphere.analysis.accessor import open_run
from swe_sphere.equations.effects import Drag, Forcing, Orography, Rotation
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, RunFailed, Unstable
from swe_sphere.io.layout import VARIABLES
from swe_sphere.io.runfile import RunFile
from swe_sphere.io.scalar_fields import FIELDS
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, HOUR
from swe_sphere.simulation.config import Keywords, RunConfig, make_config
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, diagnostic
from swe_sphere.simulation.observers import Callback, Observer, every
from swe_sphere.simulation.restart import OF_ONE_RUN
from swe_sphere.simulation.simulation import Simulation, run_scene
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Stepper
from swe_sphere.testcases import get_scene

mpl.use("Agg")

SMALL = {"ne": 2, "np": 4, "dt": 1800.0}


def small(scene="williamson6", **values):
    return Simulation(scene, **{**SMALL, **values})


def test_a_summary_is_a_mapping_and_a_table():
    sim = small()
    summary = sim.run(days=0.25)
    assert {*summary} == {*json.loads(summary.as_json())} and len(summary) == len({*summary})
    assert summary["l1_h"] is None and summary.get("nonsense") is None
    with pytest.raises(KeyError, match=r"unknown value .* 'enrgy'; did you mean 'energy'"):
        summary["enrgy"]
    lines = str(summary).splitlines()
    assert lines[0] == "williamson6 with rk4"
    assert any(line.startswith("result   ") and "completed at day 0.25" in line for line in lines)
    assert repr(summary) == "<Summary of williamson6 with rk4: completed>"
    stopped = small("williamson2", dt=28800.0, days=20.0).run()
    assert str(stopped).splitlines()[-1].startswith("why ") and "unstable" not in str(summary)


def test_copies_are_refused_and_checkpoints_are_what_to_take_instead(tmp_path):
    sim = small()
    sim.run(days=0.1)
    parts = (sim.model, sim.model.device_mesh, sim.model.launch, sim.stepper)
    for thing, copied in product((sim, *parts), (copy.copy, copy.deepcopy, pickle.dumps)):
        name = type(thing).__name__
        with pytest.raises(
            ConfigError, match=rf"{name} cannot be copied .* sim\.checkpoint\(path\)"
        ):
            copied(thing)
    assert pickle.loads(pickle.dumps(sim.mesh)).size == copy.deepcopy(sim.mesh).size
    again = Simulation.from_checkpoint(sim.checkpoint(tmp_path / "here"))
    assert again.run(days=0.2)["energy"] == sim.run(days=0.2)["energy"]


# --- the same run, however it is asked for


def test_it_is_the_run_of_the_command_line():
    summary = small().run(days=0.5)
    plain = run_scene(make_config({"scene": "williamson6", **SMALL, "days": 0.5}))
    same = ("steps", "dt", "rhs_evaluations", "energy", "energy_drift", "mass_drift", "stable_dt")
    assert [summary[name] for name in same] == [plain[name] for name in same]
    assert summary.completed and summary.status == "completed"


def test_objects_are_as_good_as_their_names():
    named = small(parameters={"alpha": 0.5}, scene="williamson2").run(days=0.25)
    mesh = Mesh.build(2, 4)
    scene = get_scene("williamson2", alpha=0.5)
    made = Simulation(scene, mesh=mesh, stepper=STEPPERS["rk4"], dt=1800.0)
    assert made.run(days=0.25)["l2_h"] == named["l2_h"]
    assert made.config.ne == 2 and made.mesh is mesh


@pytest.mark.thorough
def test_effects_by_name_and_as_objects():
    by_name = small("williamson2", effects={"drag.linear": 1e-5}).run(days=0.25)
    added = small("williamson2", effects=[Drag(linear=1e-5)]).run(days=0.25)
    assert by_name["energy_drift"] == added["energy_drift"] < -0.01
    assert small("williamson2").run(days=0.25)["energy_drift"] > -1e-3


def test_a_summary_lists_the_effects_and_their_parameters():
    summary = small("williamson2", effects={"drag.linear": 1e-5}).run(days=0.1)
    assert summary["effects"]["drag"]["linear"] == 1e-5
    listed = dict(summary.rows())["effects"].split(", ")
    assert "drag" in listed and listed == [*summary["effects"]]


def test_an_effect_may_be_set_to_its_default():
    none, word = (
        small("williamson2", effects={"hyperviscosity.nu": nu}) for nu in (None, "default")
    )
    assert none.scene.effect("hyperviscosity") == word.scene.effect("hyperviscosity")
    assert none.scene.effect("hyperviscosity") is not None
    assert none.config.settings_of("hyperviscosity") == {"nu": None}


def test_values_stay_what_they_are():
    """Numbers do not go through text; those of numpy and paths are stored as JSON can hold them."""
    sim = small("williamson2", effects={"viscosity.nu": np.float32(0.1), "drag.linear": 1 / 3})
    assert sim.scene.effect("viscosity").nu == float(np.float32(0.1))
    assert sim.scene.effect("drag").linear == 1 / 3
    again = make_config(json.loads(json.dumps(sim.config.model_dump(mode="json"))))
    assert again == sim.config


def test_options_reach_the_stepper():
    asked = {"stepper": "tr-bdf2", "dt": 7200.0}
    strict = small(**asked, options={"tolerance": 1e-8}).run(days=0.5)
    assert strict["tolerance"] == 1e-8
    assert strict["krylov_iterations"] > small(**asked).run(days=0.5)["krylov_iterations"]
    bare = small(**asked, preconditioner="none").run(days=0.5)
    assert bare["preconditioner"] == "none" and bare["setups"] == 0


def test_it_goes_on_where_it_stands():
    whole = small().run(days=1.0)
    sim = small()
    sim.run(days=0.25)
    for _ in range(12):
        sim.step()
    assert sim.time == 0.5 * DAY
    rest = sim.run(days=1.0)
    assert (rest["energy_drift"], rest["steps"]) == (whole["energy_drift"], 48)
    with pytest.raises(ConfigError, match="is already at day 1"):
        sim.run(days=0.5)


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"scene": 3}, "scene: give a name, a file or a Scene, got 3"),
        ({"stepper": dict}, "stepper: give a name, a file or a class, got <class 'dict'>"),
        ({"stepper": 3}, "stepper: give a name, a file or a class, got 3"),
        ({"preconditioner": 3}, "preconditioner: give a name, a file or a class, got 3"),
        ({"preconditioner": dict}, "a class, got <class 'dict'>"),
        ({"mesh": 3}, "give a Mesh, got 3"),
        ({"effects": ["drag"]}, r"got \['drag'\]"),
        ({"effects": "drag"}, "got 'drag'"),
        ({"effects": 3}, "got 3"),
        ({"out": "a.nc"}, "out is not a setting of a simulation"),
        ({"nee": 3}, "unknown option 'nee'; did you mean 'ne'"),
        ({"effects": {"drag.linearr": 1}}, "no effect 'drag'|no parameter"),
        ({"parameters": {"beta": 1}}, "beta"),
        ({"options": {"beta": 1}}, "has no option 'beta'"),
        ({"effects": {"nu": 1.0}}, r"set: must be tables .* got \{'nu': 1.0\}"),
        ({"settings": 5}, "set: must be a list of EFFECT.PARAMETER=VALUE, got 5"),
        ({"parameters": [1]}, r"parameters: give \{'alpha': 0.8\}, got \[1\]"),
        ({"options": [1]}, r"options: give \{'tolerance': 1e-6\}, got \[1\]"),
    ],
)
def test_what_cannot_be_is_one_line(values, word):
    with pytest.raises(ConfigError, match=word) as error:
        small(**values)
    assert "\n" not in str(error.value)


def test_parameters_are_for_scenes_by_name():
    with pytest.raises(ConfigError, match="this one is built already"):
        small(get_scene("williamson2"), parameters={"alpha": 1.0})


# --- looking at it


def test_state_has_names_units_and_values():
    sim = small("williamson5")
    sim.step()
    state = sim.state
    assert {"h", "u", "v", "vorticity", "divergence", "b", "area"} <= set(state.data_vars)
    assert state.u.attrs["units"] == "m s-1" and state.h.dims == ("node",)
    assert np.array_equal(state.h.values, sim.model.fields(sim.stepper.state)["h"])
    assert float(state.area.sum()) == pytest.approx(4 * np.pi * sim.mesh.radius**2, rel=1e-3)
    whole = sim.to_xarray()
    assert whole.sizes["time"] == 1 and float(whole.time[0]) == 1800.0
    assert whole.attrs["scene"] == "williamson5"


def test_frames_are_kept_in_memory():
    sim = small("williamson5")
    with pytest.raises(ConfigError, match=r"kept no frames: call run\(keep=True\)"):
        _ = sim.frames
    sim.run(days=0.5, every=6, keep=True)
    assert sim.frames.h.dims == ("time", "node") and sim.frames.b.dims == ("node",)
    assert sim.frames.time.values.tolist() == [0.0, 0.25 * DAY, 0.5 * DAY]
    np.testing.assert_array_equal(sim.frames.h[0], sim.initial_fields["h"])
    np.testing.assert_array_equal(sim.frames.h[-1], sim.state.h)


def test_frames_of_the_last_run_may_be_those_of_its_file(tmp_path):
    sim = small("williamson5")
    sim.run(days=0.25, every=6, out=tmp_path / "run.nc")
    np.testing.assert_array_equal(sim.frames.h, open_run(tmp_path / "run.nc").h)


@pytest.mark.thorough
def test_a_film_of_the_last_run_is_shown_by_notebooks():
    sim = small("williamson5")
    sim.run(days=0.25, every=6, keep=True)
    film = sim.animate("speed")
    shown = film._repr_html_()
    assert shown.count("data:image/png;base64,") == 2 and "<input" in shown
    with pytest.raises(ConfigError, match="fewer than two frames"):
        sim.to_xarray().swe.animate()


def test_an_editor_completes_the_settings_of_a_simulation():
    known = RunConfig.model_fields
    others = {"scene", "stepper", "preconditioner", "initial", *OF_ONE_RUN}
    assert Keywords.__annotations__.keys() == known.keys() - others
    for function in (Simulation.__init__, Simulation.from_checkpoint):
        assert function.__annotations__["settings"] == "Unpack[Keywords]"


def test_potential_vorticity_and_kinetic_energy_are_fields(tmp_path):
    sim = small("williamson5", fields="h,potential_vorticity,kinetic_energy")
    sim.run(days=0.25, out=tmp_path / "run.nc")
    run, whole = open_run(tmp_path / "run.nc"), sim.to_xarray()
    right = whole.swe.potential_vorticity()
    np.testing.assert_allclose(run.potential_vorticity[-1], right[0], rtol=1e-14)
    np.testing.assert_allclose(run.kinetic_energy[-1], 0.5 * (whole.u**2 + whole.v**2)[0])
    assert run.potential_vorticity.attrs["units"] == "m-1 s-1"
    sim = small("williamson5")
    sim.run(days=0.25, out=tmp_path / "whole.nc")
    file, frame = RunFile(tmp_path / "whole.nc"), sim.to_xarray().swe.frames
    for field in ("potential_vorticity", "kinetic_energy"):
        at = file.at(field, np.array([1.0]), np.array([0.5]))
        np.testing.assert_allclose(at, frame.at(field, np.array([1.0]), np.array([0.5])))
    assert {"potential_vorticity", "kinetic_energy"}.isdisjoint(file.about)


def test_the_anomaly_of_potential_vorticity_is_that_of_columns_at_the_mean_depth(tmp_path):
    sim = small("williamson5", fields="h,potential_vorticity_anomaly")
    sim.run(days=0.25, out=tmp_path / "run.nc")
    run, whole = open_run(tmp_path / "run.nc"), sim.to_xarray().isel(time=0)
    mean = np.average(whole.h, weights=whole.area)
    right = (whole.vorticity + whole.f) * mean / whole.h - whole.f
    np.testing.assert_allclose(run.potential_vorticity_anomaly[-1], right, atol=1e-18)
    assert run.potential_vorticity_anomaly.attrs["units"] == "s-1"
    sim = small("williamson5")
    sim.run(days=0.25, out=tmp_path / "whole.nc")
    found = RunFile(tmp_path / "whole.nc").values("potential_vorticity_anomaly")
    np.testing.assert_allclose(found, right, atol=1e-18)
    assert sim.plot("potential_vorticity_anomaly").get_title()
    norms = open_run(tmp_path / "whole.nc").swe.error_norms(whole, "potential_vorticity_anomaly")
    assert norms.l2_potential_vorticity_anomaly[-1] < 1e-14


def test_times_of_pictures_are_days():
    sim = small("williamson5")
    sim.run(days=0.5, every=6, keep=True)
    axes = sim.frames.swe.plot("h", time=0.25)
    assert any("day 0.25" in text.get_text() for text in axes.texts)
    with pytest.raises(ConfigError, match=r"no frame at day 2: the last ones are at day 0, 0.25"):
        sim.frames.swe.plot("h", time=2.0)
    mpl.pyplot.close(axes.figure)


@pytest.mark.parametrize("look", [{"region": (0, 90, 0, 45)}, {"projection": "lat-lon"}])
def test_axes_of_the_user_keep_their_extent(look):
    from cartopy.crs import Robinson
    from matplotlib import pyplot

    axes = pyplot.figure().add_subplot(projection=Robinson())
    (name,) = look
    message = f"ax keeps its projection and extent: leave out {name}"
    with pytest.raises(ConfigError, match=message):
        small("williamson5").plot("h", ax=axes, **look)
    pyplot.close(axes.figure)


def test_a_number_of_contours_asks_for_contours():
    sim, drawn = small("williamson5"), []
    for look in ({}, {"levels": 6}, {"levels": 6, "contours": False}):
        axes = sim.plot("vorticity", **look)
        drawn.append(len(axes.collections))
        mpl.pyplot.close(axes.figure)
    assert drawn == [drawn[0], drawn[0] + 1, drawn[0]]


def test_a_map_in_a_figure_of_the_user_keeps_its_title():
    from cartopy.crs import Robinson
    from matplotlib import pyplot

    figure, (one, other) = pyplot.subplots(1, 2, subplot_kw={"projection": Robinson()})
    one.set_title("mine")
    sim = small("williamson5")
    for axes in (one, other):
        sim.plot("vorticity", ax=axes)
        assert not [text for text in axes.texts if text.get_text()]
    assert (one.get_title(), other.get_title()) == ("mine", "relative vorticity, day 0")
    labels = {each.get_xlabel() for each in figure.axes}
    assert "relative vorticity [10$^{-6}$ s$^{-1}$]" in labels
    pyplot.close(figure)


def test_a_signed_field_of_the_user_has_its_zero_in_the_middle():
    @diagnostic
    def anomaly(sim):
        return sim.state.h - sim.state.h.mean()

    try:
        axes = small("williamson5").plot("anomaly")
        (image,) = axes.get_images()
        low, high = image.get_clim()
        assert low == -high and image.get_cmap().name.endswith("vik")
    finally:
        del DIAGNOSTICS["anomaly"]


def test_a_picture_of_the_state():
    from cartopy.crs import Robinson
    from matplotlib import pyplot

    sim = small("williamson5")
    figure, axes = pyplot.subplots(subplot_kw={"projection": Robinson()})
    assert sim.plot("vorticity", ax=axes) is axes
    assert axes.get_title() == "relative vorticity, day 0"
    with pytest.raises(ConfigError, match="unknown field 'vorticty'; did you mean"):
        sim.plot("vorticty")
    pyplot.close(figure)


def test_it_shows_itself():
    sim = small()
    assert repr(sim) == (
        "Simulation('williamson6', ne=2, np=4, stepper='rk4': not begun of 14 days)"
    )
    assert "<td>not begun</td>" in sim._repr_html_() and "not begun" in repr(sim)
    sim.run(days=0.125)
    html = sim._repr_html_()
    assert html.startswith("<table>") and "completed at day 0.125 after 6 steps" in html
    assert "right-hand sides" in sim.summary._repr_html_()


# --- callbacks


def test_callbacks_come_at_steps_and_at_simulated_times():
    steps, hours, ends = [], [], []
    calls = [
        lambda sim: steps.append(sim.steps),
        every(hours=1.5)(lambda sim: hours.append(sim.time / HOUR)),
        every(steps=7)(lambda sim: ends.append(sim.steps)),
    ]
    small().run(days=0.25, callbacks=calls)
    assert steps == [*range(1, 13)]
    assert hours == [1.5, 3.0, 4.5, 6.0]
    assert ends == [7]


def test_steps_are_shortened_so_that_calls_fall_on_them():
    sim, times = small(dt=1700.0), []
    sim.run(days=0.25, callbacks=[every(hours=2.0)(lambda sim: times.append(sim.time))])
    assert times == [2 * HOUR, 4 * HOUR, 6 * HOUR]
    assert sim.plan.dt == 1440.0
    with pytest.raises(ConfigError, match="not a whole number of steps"):
        sim.run(days=0.5, callbacks=[every(hours=1.0001)(print)])


def test_callbacks_by_steps_come_in_a_resumed_run_whose_steps_pass_over_the_multiples():
    """Three steps are taken with one of the tracers, from a number that is no multiple of three."""
    called, every_six = [], every(steps=6)(lambda sim: called.append(sim.steps))
    sim = Simulation("deformational", ne=4, np=4, tracer_steps="auto")
    sim.run(days=0.5, every=12)
    before = sim.steps
    sim.run(days=5, every=7, callbacks=[every_six])
    assert sim.plan.cycle == 3 and before % 3
    assert np.all(np.diff(called[:-1]) == 6) and len(called) >= (sim.steps - before) // 6


def test_the_time_between_calls_is_checked_by_whoever_makes_the_callback():
    times = []
    small(dt=1700.0).run(
        days=0.25, callbacks=[Callback(lambda sim: times.append(sim.time), seconds=7200.0)]
    )
    assert times == [2 * HOUR, 4 * HOUR, 6 * HOUR]
    with pytest.raises(ConfigError, match="every of -1 s is too short"):
        small().run(days=0.25, callbacks=[Callback(print, seconds=-1.0)])


def test_a_callback_that_raises_ends_the_run_in_one_line(tmp_path):
    def breaks(sim):
        if sim.steps == 5:
            raise ZeroDivisionError("oh")

    summary = small().run(days=1.0, callbacks=[breaks], out=tmp_path / "a.nc", every=1.0)
    assert (summary.status, summary.exit_status, summary["steps"]) == ("failed", 1, 5)
    assert summary.reason.startswith("the callback breaks fails: ZeroDivisionError: oh")
    assert "test_simulation_api.py, line" in summary.reason
    assert RunFile(tmp_path / "a.nc").times.tolist() == [0.0, HOUR, 2 * HOUR]


@pytest.mark.parametrize(
    "call",
    [lambda: every(), lambda: every(0), lambda: every(3, days=1), lambda: every(hours="six"),
     lambda: every(hours=1e-9), lambda: every(days=np.inf), lambda: every(np.inf)],
)  # fmt: skip
def test_schedules_that_cannot_be(call):
    with pytest.raises(ConfigError, match="every: give one of"):
        call()


def test_frames_and_checkpoints_have_the_state_that_a_callback_leaves(tmp_path):
    @every(hours=6)
    def brake(sim):
        values = sim.stepper.state.numpy().copy()
        values[: 2 * sim.mesh.size] *= 0.9
        sim.stepper.state.assign(values)

    def small():
        return Simulation("williamson2", ne=2, np=4, dt=1800.0)

    whole, part = small(), small()
    whole.run(days=0.5, callbacks=[brake])
    part.run(days=0.25, every=6, out=tmp_path / "a.nc", callbacks=[brake])
    with open_run(tmp_path / "a.nc") as data:
        assert np.array_equal(data.u.values[-1], part.state.u.values)
    again = Simulation.from_checkpoint(tmp_path / "a.nc")
    again.run(days=0.5, callbacks=[brake])
    assert np.array_equal(again.state.u, whole.state.u)


def test_a_callback_may_change_the_state_and_keep_its_energy(tmp_path):
    def reverse(sim):
        if sim.steps == 2:
            values = sim.state.u.values, sim.stepper.state.numpy().copy()
            values[1][: 2 * sim.mesh.size] *= -1.0
            sim.stepper.state.assign(values[1])

    sim = Simulation("williamson6", ne=2, np=4, dt=1800.0)
    sim.run(days=1 / 24, every=0.5, out=tmp_path / "a.nc", callbacks=[reverse])
    now = sim.model.fields(sim.stepper.state, sim.time)["u"]
    with open_run(tmp_path / "a.nc") as data:
        assert np.array_equal(data.u.values[-1], now) and np.array_equal(sim.state.u, now)


@pytest.mark.parametrize("stepper", ["leapfrog", "semi-implicit", "forward-backward", "bdf2"])
def test_a_multistep_method_starts_again_from_a_state_that_a_callback_changes(stepper, tmp_path):
    """Half of the wind is lost after two hours; compared with a stepper that begins there."""
    changed = []

    @every(hours=2)
    def change(sim):
        if not changed:
            state = sim.stepper.state.numpy().copy()
            state[: 2 * sim.mesh.size] *= 0.5
            sim.stepper.state.assign(state)
            changed.append(state)

    given = {"ne": 2, "np": 4, "stepper": stepper, "dt": 600.0}
    sim = Simulation("williamson6", **given)
    summary = sim.run(days=1 / 6, callbacks=[change], out=tmp_path / "a.nc")
    assert "step_changes" not in summary
    fresh = Simulation("williamson6", **given)
    fresh.begin()
    begun = type(fresh.stepper)(fresh.model, 600.0)
    begun.start(wp.array(changed[0], dtype=wp.float64), 7200.0)
    while begun.time < 14399.0:
        begun.step()
    np.testing.assert_array_equal(sim.stepper.state.numpy(), begun.state.numpy())
    resumed = Simulation.from_checkpoint(tmp_path / "a.nc", days=0.25)
    resumed.run()
    sim.run(days=0.25)
    np.testing.assert_array_equal(resumed.stepper.state.numpy(), sim.stepper.state.numpy())


@pytest.mark.parametrize("stepper", ["leapfrog", "semi-implicit", "bdf2", "rk4"])
@pytest.mark.parametrize("by", ["observer", "assignment", "step", "checkpoint"])
def test_a_state_that_changes_between_runs_is_a_new_beginning(stepper, by, tmp_path):
    """Half of the wind is lost after two hours: by a callback, or between two runs."""

    def halve(sim):
        state = sim.stepper.state.numpy().copy()
        state[: 2 * sim.mesh.size] *= 0.5
        sim.stepper.state.assign(state)

    class Halving(Observer):
        def begin(self, plan, snapshot):
            halve(sim)

    given = {"ne": 2, "np": 4, "stepper": stepper, "dt": 600.0, "every": 1}
    within, sim = (Simulation("williamson6", **given) for _ in range(2))
    within.run(
        days=1 / 6, callbacks=[every(hours=2)(lambda s: halve(s) if s.steps == 12 else None)]
    )
    sim.run(days=1 / 12)
    if by != "observer":
        halve(sim)
    if by == "checkpoint":
        sim = Simulation.from_checkpoint(sim.checkpoint(tmp_path / "a.nc"))
    if by == "step":
        sim.accept_changes()
        sim.step()
    sim.run(days=1 / 6, callbacks=[Halving()] if by == "observer" else [])
    np.testing.assert_array_equal(sim.stepper.state.numpy(), within.stepper.state.numpy())


def test_a_checkpoint_of_a_changed_scene_needs_the_scene(tmp_path):
    plain = get_scene("williamson5")
    own = replace(plain, bottom=lambda lon, lat: 0.9 * plain.bottom(lon, lat))
    Simulation(own, **SMALL).run(days=0.25, out=tmp_path / "a.nc")
    with pytest.raises(
        ConfigError, match=r"own_functions is 'bottom' there .* give the scene itself"
    ):
        Simulation.from_checkpoint(tmp_path / "a.nc")
    resumed = Simulation.from_checkpoint(tmp_path / "a.nc", own)
    assert resumed.run(days=0.5).status == "completed"


def test_energy_that_a_forcing_added_before_is_no_growth():
    """The wind reaches 60 m/s within an hour, and the forcing has ended when the run continues."""

    def forcing(lon, lat, t):
        rate = 60.0 / 1800.0 * np.exp(-t / 1800.0)
        return rate * np.cos(lat), 0.0 * lon, 0.0 * lon

    scene = Scene(
        "puff", (Rotation(), Forcing()), lambda lon, lat: (5.0 * np.cos(lat), 0.0, 20.0),
        forcing=forcing, ne=2, np=4, days=2.0,
    )  # fmt: skip
    sim = Simulation(scene, dt=600.0)
    assert [sim.run(days=days).status for days in (1, 2)] == ["completed"] * 2


def test_fields_of_a_snapshot_are_read_before_the_next_step():
    sim = small()
    sim.begin()
    early, late = sim.snapshot, small()
    assert early.fields["h"].size == sim.mesh.size
    sim.step()
    assert early.fields["h"].size == sim.mesh.size  # as they were
    late.begin()
    snapshot = late.snapshot
    late.step()
    with pytest.raises(
        RunFailed, match="is of step 0, the simulation is at step 1: read its fields"
    ):
        _ = snapshot.fields


@pytest.mark.parametrize("more", [1, 2, 3])
def test_a_snapshot_is_not_read_after_steps_that_exchange_levels(more):
    sim = small(stepper="fb-rk3", dt=600.0)
    sim.step()
    snapshot = sim.snapshot
    for _ in range(more):
        sim.step()
    with pytest.raises(RunFailed, match=f"of step 1, the simulation is at step {1 + more}"):
        _ = snapshot.fields


def test_a_snapshot_can_be_read_after_a_reset():
    sim = small()
    sim.step()
    snapshot, expected = sim.snapshot, sim.model.fields(sim.stepper.state)["h"].copy()
    sim.reset()
    np.testing.assert_array_equal(snapshot.fields["h"], expected)


def test_the_initial_snapshot_can_be_read_after_a_run():
    sim = small()
    start, depth = sim.snapshot, sim.initial_fields["h"]
    sim.run(days=0.25)
    np.testing.assert_array_equal(start.fields["h"], depth)


def test_a_signal_during_the_last_step_leaves_the_run_complete():
    def end(sim):
        if sim.steps == sim.plan.steps:
            os.kill(os.getpid(), signal.SIGTERM)

    summary = small().run(days=0.25, callbacks=[end], raises=False)
    assert (summary.status, summary["days"]) == ("completed", 0.25)


def test_steps_before_a_run_do_not_make_it_start_again():
    whole, sim = (small(stepper="leapfrog") for _ in range(2))
    whole.run(days=0.25)
    sim.run(days=0.125)
    sim.step()
    sim.run(days=0.25)
    np.testing.assert_array_equal(sim.stepper.state.numpy(), whole.stepper.state.numpy())


@pytest.mark.parametrize("stepper", ["rk4", "leapfrog", "forward-backward"])
def test_the_edge_penalty_acts_however_often_a_callback_changes_the_state(stepper):
    def change(sim):
        state = sim.stepper.state.numpy().copy()
        state[: 2 * sim.mesh.size] *= 1.0 - 1e-12
        sim.stepper.state.assign(state)

    def effect(callbacks):
        winds = []
        for c in (0.0, 0.02):
            sim = small(stepper=stepper, dt=300.0, effects={"edge-penalty.c": c})
            sim.run(days=0.5, callbacks=callbacks)
            winds.append(sim.state.u)
        return winds[1] - winds[0]

    expected = effect([])
    # a start in each step makes another method of leapfrog
    assert np.abs(effect([change]) - expected).max() < 0.1 * np.abs(expected).max()


def test_the_summary_of_a_run_in_progress_is_that_of_a_run_in_progress():
    lines = []
    sim = Simulation("williamson2", ne=2, np=4, dt=3600.0)
    sim.run(
        days=0.25, callbacks=[every(hours=3)(lambda sim: lines.append(dict(sim.summary.rows())))]
    )
    assert lines[0]["result"] == "running at day 0.125 after 3 steps"


def test_a_callback_leaves_the_steps_that_were_taken_back_in_the_summary():
    @every(hours=6)
    def change(sim):
        state = sim.stepper.state.numpy().copy()
        state[: 2 * sim.mesh.size] *= 0.999
        sim.stepper.state.assign(state)

    sim = Simulation("williamson6", ne=4, np=4, stepper="tr-bdf2", adaptive=1e-7, dt=21600.0)
    summary = sim.run(days=1, callbacks=[change])
    assert len(summary["cuts"]) == summary["rejected_steps"] > 0


def test_a_rounded_interval_of_a_callback_stands_for_a_fraction_of_an_hour():
    sim = Simulation("williamson2", ne=2, np=4)
    sim.run(days=1 / 6, callbacks=[every(hours=0.333333)(lambda sim: None)])
    assert sim.plan.dt == pytest.approx(1200.0, rel=1e-12)


def test_a_callback_must_be_callable():
    def deferred(sim):
        yield sim

    async def later(sim):
        pass

    async def later_again(sim):
        yield sim

    class Deferred:
        def __call__(self, sim):
            yield sim

    for each in (3, deferred, later, later_again, Deferred()):
        with pytest.raises(ConfigError, match="a callback must be a plain function, got"):
            small().run(days=0.1, callbacks=[each])
    with pytest.raises(ConfigError, match="callbacks: give a list of functions, got <built-in"):
        small().run(days=0.1, callbacks=print)


def test_a_callback_leaves_the_length_of_steps():
    def shorten(sim):
        sim.stepper.dt = 0.5 * sim.stepper.dt

    summary = small().run(days=0.25, callbacks=[every(3)(shorten)])
    assert summary.status == "failed" and summary["steps"] == 3
    assert "shorten has stepped, run or reset the simulation or changed its dt" in summary.reason


def test_effects_are_given_once():
    with pytest.raises(ConfigError, match="effects: drag is listed twice"):
        Simulation("williamson2", effects=[Drag(linear=1e-4), Drag(quadratic=1e-9)])


def test_an_observer_may_be_among_the_callbacks():
    class Heights(Observer):
        seen = ()

        def begin(self, plan, snapshot):
            self.seen = [(plan.steps, snapshot.steps)]

        def due(self, step):
            return step % 5 == 0

        def observe(self, snapshot):
            self.seen.append((snapshot.steps, snapshot.fields["h"].shape))

        def end(self):
            self.seen.append("end")

    heights = Heights()
    nodes = (small().mesh.size,)
    small().run(days=0.25, callbacks=[heights])
    assert heights.seen == [(12, 0), (5, nodes), (10, nodes), (12, nodes), "end"]


@pytest.mark.parametrize("moment", ["begin", "due", "observe", "tick", "end"])
def test_an_observer_that_raises_ends_the_run_in_one_line(tmp_path, moment):
    ended = []

    class Late(Observer):
        def begin(self, *seen):
            self.begun = True

        def end(self):
            ended.append(self.begun)

    class Early(Late):
        pass

    def breaks(self, *seen):
        raise RuntimeError("oh")

    broken = type("Broken", (Observer,), {moment: breaks})()
    file = tmp_path / "a.nc"
    summary = small().run(days=0.25, callbacks=[Early(), broken, Late()], out=file)
    assert (summary.status, summary.exit_status) == ("failed", 1)
    assert summary.reason.startswith("the observer Broken fails: RuntimeError: oh")
    assert ended == ([True] if moment == "begin" else [True, True])
    with netCDF4.Dataset(file) as data:
        assert "the observer Broken fails" in str(vars(data))


def test_an_observer_may_choose_its_methods_when_it_begins():
    class Choosing(Observer):
        seen = 0

        def begin(self, plan, snapshot):
            self.observe = self.count

        def due(self, step):
            return True

        def count(self, snapshot):
            self.seen += 1

    observer = Choosing()
    Simulation("williamson2", ne=2, np=4, dt=1800).run(0.125, callbacks=[observer])
    assert observer.seen >= 6


def test_an_observer_whose_end_fails_hides_no_earlier_failure():
    class Broken(Observer):
        def observe(self, snapshot):
            raise RuntimeError("first")

        def end(self):
            raise RuntimeError("second")

    summary = small().run(days=0.25, callbacks=[Broken()])
    assert summary.reason.index("first") < summary.reason.index("second")
    assert (summary.status, summary.exit_status) == ("failed", 1)


def test_an_interrupted_run_whose_file_fails_has_failed_and_an_unstable_one_stays_unstable():
    class Stops(Observer):
        def due(self, step):
            return True

        def observe(self, snapshot):
            signal.raise_signal(signal.SIGINT)

        def end(self):
            raise OSError("the disk is full")

    class Breaks(Stops):
        def observe(self, snapshot):
            raise Unstable("it is unstable")

    stopped = small().run(days=0.25, callbacks=[Stops()], raises=False)
    assert (stopped.status, stopped.exit_status) == ("failed", 1), stopped.reason
    assert "the disk is full" in stopped.reason
    broken = small().run(days=0.25, callbacks=[Breaks()])
    assert (broken.status, broken.exit_status) == ("unstable", 1)


def test_scalars_of_arrays_are_numbers(tmp_path):
    for value in (np.array(1e5), xr.DataArray(1e5), np.float32(1e5)):
        sim = small(effects={"viscosity.nu": value}, settings=[("drag", "linear", value)])
        assert [type(setting.value) for setting in sim.config.settings] == [float, float]
        assert sim.config.model_dump_json()


def test_a_limit_is_none_only_where_there_is_none():
    sim = small()
    assert "stability limit" not in dict(sim.summary.rows())
    sim.begin()
    assert dict(sim.summary.rows())["stability limit"].endswith(" s")
    sim = small(stepper="implicit-midpoint")
    sim.step()
    assert dict(sim.summary.rows())["stability limit"] == "none"


def test_a_configuration_holds_all_arguments():
    config = small().config
    with pytest.raises(ConfigError, match="leave out stepper, ne"):
        Simulation("williamson6", config=config, ne=5, stepper="ars343")


def test_a_picture_that_fails_leaves_the_numbers_of_the_run(tmp_path, monkeypatch):
    def fails(*arguments, **options):
        raise TypeError("unexpected\nargument")

    monkeypatch.setattr("swe_sphere.pictures.plot.plot_file", fails)
    summary = run_scene(
        make_config({"scene": "williamson6", **SMALL, "days": 0.125, "plot": "a.pdf"})
    )
    assert (summary.completed, summary.exit_status, summary["steps"]) == (True, 1, 6)
    assert summary.reason == "cannot draw a.pdf: TypeError: unexpected argument"


def test_callbacks_may_be_a_generator():
    times = []
    looks = (lambda sim: times.append(sim.time) for _ in range(2))
    small().run(days=0.125, callbacks=looks)
    assert len(times) > 1 and times[::2] == times[1::2]


# --- diagnostics of the user's own


def test_diagnostics_appear_in_file_and_summary(tmp_path):
    @diagnostic(units="m s-1")
    def jet(sim):
        "largest eastward wind"
        return sim.state.u.max()

    @diagnostic(name="kinetic", units="m2 s-2", long_name="kinetic energy")
    def energy_of_motion(sim):
        return 0.5 * (sim.snapshot.fields["u"] ** 2 + sim.snapshot.fields["v"] ** 2)

    sim = small()
    summary = sim.run(days=0.25, every=3.0, out=tmp_path / "a.nc")
    assert summary["jet"] == sim.state.u.values.max() == sim.diagnostics["jet"]
    data = open_run(tmp_path / "a.nc")
    assert data.jet.attrs == {"long_name": "largest eastward wind", "units": "m s-1"}
    assert data.kinetic.dims == ("time", "node") and data.kinetic.attrs["units"] == "m2 s-2"
    assert np.allclose(data.kinetic, 0.5 * (data.u**2 + data.v**2), rtol=1e-15)
    assert data.jet.values[-1] == summary["jet"] and data.attrs["jet"] == summary["jet"]
    assert "kinetic" in sim.state
    assert ("jet [m s-1]", f"{summary['jet']:.5g}") in summary.rows()
    assert small().plot("kinetic") is not None


def test_a_diagnostic_that_is_nan_is_told_and_written(tmp_path):
    @diagnostic
    def lost(sim):
        return np.nan

    for _ in range(2):  # each simulation tells it
        with pytest.warns(UserWarning, match="the diagnostic lost is NaN or infinite at day 0"):
            summary = small().run(days=0.125, out=tmp_path / "a.nc", overwrite=True)
    assert summary.completed and summary["lost"] is None
    assert np.isnan(open_run(tmp_path / "a.nc").lost).all()


@pytest.mark.parametrize(
    ("value", "word"),
    [(np.zeros(3), "array of shape .3,.: return one number"), ("h", "fails: ValueError"),
     (None, "fails: TypeError: it returned nothing")],
)  # fmt: skip
def test_a_diagnostic_of_a_wrong_shape_ends_the_run(value, word):
    @diagnostic
    def odd(sim):
        return value

    summary = small().run(days=0.125)
    assert summary.status == "failed" and re.match(f"the diagnostic odd .*{word}", summary.reason)
    assert summary["steps"] == 0  # before any step is taken, without a file too


@pytest.mark.parametrize("first", ["number", "field"])
def test_a_diagnostic_stays_a_number_or_a_field(first, tmp_path):
    """The file has a variable for what it is at the start."""

    @diagnostic
    def fickle(sim):
        return 1.0 if (sim.time == 0.0) == (first == "number") else np.ones(sim.mesh.size)

    summary = small().run(days=0.25, every=3.0, out=tmp_path / "a.nc")
    assert summary.status == "failed"
    assert summary.reason == (
        "the diagnostic fickle has changed its kind, size or coordinate since its first value:"
        " return the same kind"
    )


@pytest.mark.parametrize("name", ["mass", "h", "q_x", "not a name"])
def test_a_diagnostic_needs_a_name_of_its_own(name):
    with pytest.raises(ConfigError, match=r"needs (another|a) name"):
        diagnostic(name=name)(lambda sim: 0.0)


WAYS = [
    ("williamson5", {}), ("williamson5", {"stepper": "tr-bdf2"}),
    ("williamson5", {"stepper": "tr-bdf2", "adaptive": 1e-3, "dt": "auto"}),
    ("williamson5", {"stepper": "epi3"}), ("williamson5", {"stepper": "semi-implicit"}),
    ("williamson5", {"stepper": "leapfrog"}), ("williamson5", {"stepper": "mis2", "dt": 600.0}),
    ("deformational", {"stepper": "forward-backward", "tracer_steps": "auto", "dt": "auto"}),
]  # fmt: skip
"""Runs whose summaries have all kinds of names in them."""


@pytest.mark.parametrize(("scene", "values"), WAYS)
def test_no_diagnostic_takes_a_name_that_files_and_summaries_have(scene, values, tmp_path):
    found = small(scene, **values).run(days=0.25, every=6.0, out=tmp_path / "a.nc")
    data = open_run(tmp_path / "a.nc")
    known = FIELDS.keys() - VARIABLES["derived"].keys()
    for name in {*found, *data.variables, *data.dims, *data.attrs, *known, "wind"}:
        with pytest.raises(ConfigError, match="needs another name"):
            diagnostic(name=name)(lambda sim: 0.0)


def test_a_diagnostic_replaces_a_field_that_files_have_on_request_alone(tmp_path):
    @diagnostic(units="J")
    def kinetic_energy(sim):
        return 2.0 * sim.state.h

    sim = small("williamson5", fields="h,kinetic_energy")
    sim.run(days=0.1, out=tmp_path / "run.nc")
    run = open_run(tmp_path / "run.nc")
    np.testing.assert_array_equal(run.kinetic_energy, 2.0 * run.h)
    assert run.kinetic_energy.attrs["units"] == "J"


def test_a_diagnostic_does_not_replace_an_option_of_the_stepper():
    """Summaries have both by their names."""
    rk4 = STEPPERS["rk4"]

    class Damped(rk4):
        def __init__(self, model, dt, beta: float = 0.5):
            super().__init__(model, dt)

    class Vague(rk4):
        def __init__(self, model, dt, energy: float = 0.5):
            super().__init__(model, dt)

    assert small(stepper=Damped).run(days=0.125)["beta"] == 0.5
    diagnostic(name="beta")(lambda sim: 2.0)
    with pytest.raises(ConfigError, match="'beta' needs another name: an option of rk4"):
        small(stepper=Damped).run(days=0.125)
    DIAGNOSTICS.clear()
    with pytest.raises(ConfigError, match="its option 'energy' needs another name"):
        small(stepper=Vague).run(days=0.125)


def test_a_diagnostic_registered_again_is_replaced():
    for value in (1.0, 2.0):
        diagnostic(name="which")(lambda sim, value=value: value)
    assert small().run(days=0.125)["which"] == 2.0


# --- checkpoints


@pytest.mark.parametrize("stepper", ["rk4", "bdf2"])
def test_a_checkpoint_goes_on_bit_for_bit(tmp_path, stepper):
    whole = small(stepper=stepper).run(days=0.5)
    sim = small(stepper=stepper)
    sim.run(days=0.25)
    again = Simulation.from_checkpoint(sim.checkpoint(tmp_path / "half.npz"))
    assert (again.steps, again.time) == (12, 6 * HOUR)
    rest = again.run(days=0.5)
    for name in ("energy", "energy_drift", "rhs_evaluations", "krylov_iterations", "steps"):
        assert rest[name] == whole[name], name


def test_a_checkpoint_is_read_once(tmp_path, monkeypatch):
    path, load, read = small().checkpoint(tmp_path / "start.npz"), np.load, []
    monkeypatch.setattr(np, "load", lambda *given, **more: read.append(1) or load(*given, **more))
    assert Simulation.from_checkpoint(path).steps == 0
    assert len(read) == 1


def test_a_scene_given_as_an_object_is_given_again(tmp_path):
    scene = replace(get_scene("williamson6"), name="mine")
    sim = small(scene)
    sim.run(days=0.125)
    path = sim.checkpoint(tmp_path / "mine.npz")
    with pytest.raises(ConfigError, match="mine"):
        Simulation.from_checkpoint(path)
    rest = Simulation.from_checkpoint(path, scene=scene).run(days=0.25)
    assert rest["energy"] == small(scene).run(days=0.25)["energy"]


def test_a_damaged_checkpoint_is_one_line(tmp_path):
    path = small().checkpoint(tmp_path / "a.npz")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ConfigError, match="damaged"):
        Simulation.from_checkpoint(path)


@pytest.mark.parametrize("name", STEPPERS)
@pytest.mark.thorough
def test_a_second_simulation_makes_no_kernel(monkeypatch, name):
    """Making one takes longer than most of what else a short run does."""

    def step_once():
        Simulation("williamson5", ne=1, np=4, stepper=name, dt=60.0).step()

    step_once()
    monkeypatch.setattr(wp.Kernel, "__init__", lambda *_, **__: pytest.fail("one was made"))
    step_once()


def test_cpu_time_of_steps_leaves_compiling_out(monkeypatch):
    """A kernel that is compiled within a step does not count as work of the step."""
    sim, now = small(), [100.0]
    monkeypatch.setattr(time, "process_time", lambda: now[0])

    def step(stepper):
        now[0] += 8.0
        stepper.model.launch.compile_cpu_seconds += 3.0
        stepper.steps += 1

    monkeypatch.setattr(Stepper, "step", step)
    summary = sim.run(days=0.125)
    assert sim.cpu_seconds == pytest.approx(5.0 * summary["steps"])


def test_the_table_of_a_summary_has_no_row_of_rounding_errors():
    """The means of vorticity and divergence vanish on every sphere."""
    summary = small().run(days=0.1)
    assert "mean" not in [label for label, _ in summary.rows()]
    assert abs(summary["total_vorticity"]) < 1e-15


def test_a_diagnostic_that_works_in_place_changes_no_numbers(tmp_path):
    plain = small()
    plain.run(days=0.125, every=1.5, out=tmp_path / "plain.nc")

    @diagnostic
    def wave(sim):
        h = sim.state.h
        h -= h.mean()
        return float((h**2).mean())

    sim = small()
    sim.run(days=0.125, every=1.5, out=tmp_path / "run.nc")
    a, b = (open_run(tmp_path / f"{name}.nc") for name in ("plain", "run"))
    for name in a:
        if name not in ("wall_seconds", "cpu_seconds"):
            assert np.array_equal(a[name], b[name], equal_nan=a[name].dtype.kind == "f"), name
    assert sim.summary["mass"] == plain.summary["mass"]
    with pytest.raises(ValueError, match="read-only"):
        sim.snapshot.fields["u"] *= 2.0
    with pytest.raises(ValueError, match="read-only"):
        sim.model.bottom[0] = 1.0


def test_a_bottom_that_is_changed_later_changes_no_simulation():
    stored = np.zeros(Mesh.build(2, 4).size)
    flat = get_scene("williamson6")
    effects = (*flat.effects, Orography())
    sim = small(replace(flat, effects=effects, bottom=lambda lon, lat: stored))
    stored += 500.0
    assert not sim.model.bottom.any()
