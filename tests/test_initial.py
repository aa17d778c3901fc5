"""Runs that begin from a state of another run, or of a function, in the place of the scene's."""

import json

import numpy as np
import pytest

from swe_sphere.analysis.accessor import open_run
from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import Output
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.testcases import get_scene

from .support import thorough

DAY = 86400.0


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The file of a run of half a day with three frames, and its simulation."""
    path = tmp_path_factory.mktemp("made") / "made.nc"
    sim = Simulation("williamson6", ne=3, np=5, dt=900.0)
    sim.run(days=0.5, every=6.0, out=path)
    return path, sim


@pytest.mark.parametrize("form", ["path", "text", "dataset", "state", "frame"])
def test_the_state_on_the_same_mesh_is_that_of_the_frame_bit_for_bit(made, form):
    path, sim = made
    initial = {
        "path": path, "text": str(path), "dataset": open_run(path), "state": sim.state,
        "frame": sim.to_xarray(),
    }[form]  # fmt: skip
    again = Simulation("williamson6", ne=3, np=5, dt=900.0, initial=initial)
    for name in ("u", "v", "h"):
        assert np.array_equal(again.initial_fields[name], sim.state[name]), name
    assert again.run(days=0.25).status == "completed"
    assert again.steps == 24


def test_any_frame_is_chosen_by_its_time(made):
    path, _ = made
    for day in (0.0, 0.25):
        sim = Simulation("williamson6", ne=3, np=5, initial=path, initial_time=day)
        frame = open_run(path).sel(time=day * DAY)
        assert np.array_equal(sim.initial_fields["h"], frame.h)
    with pytest.raises(ConfigError, match=r"holds no frame at day 0.3: the last ones are at day"):
        Simulation("williamson6", initial=path, initial_time=0.3)


def test_an_explicit_run_continues_as_if_it_had_never_stopped(made):
    """rk4 keeps nothing between steps, so that a frame holds all that it needs."""
    path, sim = made
    later = Simulation("williamson6", ne=3, np=5, dt=900.0, initial=path, initial_time=0.25)
    later.run(days=0.25)
    assert np.array_equal(later.state.h, sim.state.h)


def test_fields_on_another_mesh_are_those_of_the_polynomials(tmp_path):
    """A field of degree 1 in the coordinates of each element is met exactly."""
    flat = Simulation("williamson2", ne=4, np=8, dt=600.0)
    path = tmp_path / "a.nc"
    flat.run(days=0, out=path)
    turned = Simulation(
        "williamson2", ne=5, np=4, stretch=1.5, centre_lon=20.0, spin=10.0, initial=path
    )
    exact = get_scene("williamson2").initial(turned.mesh.lon, turned.mesh.lat)
    for name, values in zip(("u", "v", "h"), exact, strict=True):
        scale = np.abs(values).max() or 40.0
        assert np.abs(turned.initial_fields[name] - values).max() < 1e-5 * max(scale, 40.0), name
    finer = Simulation("williamson2", ne=4, np=8, spin=0.0, initial=path)
    assert np.array_equal(finer.initial_fields["h"], flat.initial_fields["h"])


@pytest.mark.parametrize(
    ("stepper", "more"),
    [
        ("tr-bdf2", {"effects": {"viscosity.nu": 1e5}}),
        ("leapfrog", {}),
        thorough("semi-implicit", {"precision": "float32"}),
        ("rk4", {"effects": {"hyperviscosity.nu": 1e16}, "dt": 200.0}),
    ],
)
def test_stepper_step_effects_mesh_and_precision_may_differ(made, stepper, more):
    path, _ = made
    sim = Simulation("williamson6", ne=4, np=4, stepper=stepper, initial=path, **more)
    assert sim.run(days=0.125).status == "completed"


def test_a_function_replaces_the_initial_state():
    def calm(lon, lat):
        return 0.0 * lon, 0.0 * lon, 5000.0 + 100.0 * np.cos(lat)

    sim = Simulation("williamson2", ne=2, np=4, dt=600.0, initial=calm)
    assert sim.initial_fields["u"].max() == 0.0
    assert sim.initial_fields["h"].max() == pytest.approx(5100.0)
    assert sim.run(days=0.125)["l2_h"] is None  # williamson2 starts otherwise


def test_a_run_from_another_initial_state_is_not_compared_with_shipped_solutions(monkeypatch):
    def fail(*_):
        raise AssertionError("compared")

    monkeypatch.setattr("swe_sphere.simulation.build.shipped_solution", fail)
    initial = get_scene("williamson2").initial
    sim = Simulation("williamson6", ne=2, np=4, days=0.1, initial=initial)
    assert "reference" not in sim.run()


def test_tracers_come_from_the_frame_and_others_begin_as_in_the_scene(tmp_path):
    name, path = "deformational", tmp_path / "a.nc"
    sim = Simulation(name, ne=4, np=4)
    sim.run(days=1.0, out=path)
    tracer = next(key for key in sim.to_xarray().data_vars if str(key).startswith("q_"))
    again = Simulation(name, ne=4, np=4, initial=path)
    assert np.allclose(again.initial_fields[tracer], sim.state[tracer], rtol=0.0, atol=1e-14)
    bare = open_run(path).drop_vars(tracer)
    fresh = Simulation(name, ne=4, np=4, initial=bare)
    scene = Simulation(name, ne=4, np=4).initial_fields
    assert np.allclose(fresh.initial_fields[tracer], scene[tracer], rtol=1e-13, atol=0.0)


def test_what_is_prescribed_in_time_continues_from_the_time_of_the_frame(tmp_path):
    name, path = "deformational", tmp_path / "a.nc"
    whole = Simulation(name, ne=4, np=4, dt=3600.0)
    whole.run(days=2.0, every=24.0, out=path)
    half = Simulation(name, ne=4, np=4, dt=3600.0, initial=path, initial_time=1.0)
    half.run(days=1.0)
    for field in ("u", "h"):
        assert np.allclose(half.state[field], whole.state[field], rtol=1e-13, atol=1e-13), field


@pytest.mark.parametrize("in_files", [False, True])
def test_times_of_runs_that_begin_from_one_another_add_up(tmp_path, in_files):
    state = None
    for leg in range(3):
        sim = Simulation("williamson4", ne=2, np=4, dt=1800.0, initial=state)
        sim.run(days=0.25, out=tmp_path / f"{leg}.nc" if in_files else None)
        state = tmp_path / f"{leg}.nc" if in_files else sim.to_xarray()
    one = Simulation("williamson4", ne=2, np=4, dt=1800.0)
    one.run(days=0.75)
    np.testing.assert_allclose(sim.state.h, one.state.h, rtol=1e-13)


def test_a_run_is_resumed_from_the_state_that_it_began_from(made, tmp_path):
    path, _ = made
    out, other = tmp_path / "b.nc", tmp_path / "c.nc"
    given = {"ne": 2, "np": 4, "dt": 900.0, "initial": path, "initial_time": 0.25}
    Simulation("williamson6", **given).run(days=0.25, out=out)
    Simulation("williamson6", **given).run(days=0.5, out=other)
    assert Simulation.from_checkpoint(out).run(days=0.5, out=out).status == "completed"
    ours, theirs = open_run(out), open_run(other)
    assert np.array_equal(ours.h[-1], theirs.h[-1])
    assert float(ours.mass_drift[-1]) == float(theirs.mass_drift[-1])
    with pytest.raises(ConfigError, match="of another run: initial is"):
        Simulation.from_checkpoint(out, initial_time=0.5)


def test_a_run_from_an_object_is_resumed_with_that_object(made, tmp_path):
    _, sim = made
    out, state = tmp_path / "b.nc", sim.to_xarray()
    Simulation("williamson6", ne=2, np=4, dt=900.0, initial=state).run(days=0.25, out=out)
    with pytest.raises(ConfigError, match="of another run: initial is"):
        Simulation.from_checkpoint(out)
    again = Simulation.from_checkpoint(out, initial=state)
    assert again.run(days=0.5, out=out).status == "completed"


def test_a_run_is_resumed_in_another_folder(made, tmp_path, monkeypatch):
    path, _ = made
    monkeypatch.chdir(path.parent)
    out = tmp_path / "b.nc"
    Simulation("williamson6", ne=2, np=4, dt=900.0, initial=path.name).run(days=0.25, out=out)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"there is no file made\.nc"):
        Simulation.from_checkpoint(out)
    resumed = Simulation.from_checkpoint(out, initial=path)
    assert resumed.run(days=0.5).status == "completed"


def test_history_names_file_and_frame_above_the_history_of_the_file(made, tmp_path):
    path, _ = made
    out = tmp_path / "b.nc"
    with pytest.raises(SystemExit) as end:
        main([
            "run", "williamson6", "--initial", str(path), "--initial-time", "0.25", "--days",
            "0.25", "--ne", "2", "--out", str(out), "--quiet",
        ])  # fmt: skip
    assert end.value.code == 0
    first, second = open_run(out).history.splitlines()
    assert first.endswith("run williamson6 from made.nc at day 0.25")
    assert second == open_run(path).history
    settings = json.loads(open_run(out).configuration)
    assert (settings["initial"], settings["initial_time"]) == (str(path), 0.25)


def test_a_run_that_became_unstable_is_rescued_with_dissipation(tmp_path):
    path = tmp_path / "a.nc"
    given = {"ne": 3, "np": 4}
    sim = Simulation("williamson6", dt=7200.0, **given)
    with pytest.warns(UserWarning, match="stability limit"):
        assert sim.run(days=9.0, every=2.0, out=path).status == "unstable"
    frames = open_run(path).time.values / DAY
    rescued = Simulation(
        "williamson6", dt=600.0, effects={"viscosity.nu": 1e6}, initial=path,
        initial_time=float(frames[-2]), **given,
    )  # fmt: skip
    assert rescued.run(days=0.5).status == "completed"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"initial": "nowhere.nc"}, "there is no file .*nowhere.nc"),
        ({"initial": 3}, "initial: give a file, a dataset or a function, got 3"),
        ({"initial_time": 0.5}, "got None; initial-time chooses a frame of it"),
        ({"initial": np.sin, "initial_time": 0.5}, "initial-time chooses a frame of it"),
    ],
)
def test_what_is_no_initial_state_is_refused_in_one_line(values, said):
    with pytest.raises(ConfigError, match=said):
        Simulation("williamson2", ne=2, **values)


def test_frames_without_the_fields_or_with_nan_are_refused(made):
    path, _ = made
    run = open_run(path)
    with pytest.raises(ConfigError, match=r"a dataset at day 0.5 lacks the field u: take another"):
        Simulation("williamson2", ne=2, initial=run.drop_vars("u"))
    spoilt = run.where(run.time < 0.4 * DAY)
    spoilt.attrs = run.attrs
    with pytest.raises(ConfigError, match=r"is not finite in a dataset at day 0.5: take an earl"):
        Simulation("williamson2", ne=2, initial=spoilt)
    at = Simulation("williamson2", ne=2, np=4, initial=spoilt, initial_time=0.25)
    assert np.isfinite(at.initial_fields["h"]).all()


def test_a_damaged_time_offset_is_refused(made, tmp_path):
    with open_run(made[0]) as data:
        spoilt = data.load().assign_attrs(time_offset="noon")
    spoilt.to_netcdf(tmp_path / "spoilt.nc")
    for given in (tmp_path / "spoilt.nc", spoilt):
        with pytest.raises(ConfigError, match=r"time.offset"):
            Simulation("williamson6", ne=2, initial=given)


def test_the_file_that_a_run_begins_from_is_not_its_output(made):
    path, _ = made
    before = path.read_bytes()
    sim = Simulation("williamson6", ne=2, initial=path)
    with pytest.raises(ConfigError, match="is a file that the run reads"):
        sim.run(days=0.25, out=path, overwrite=True)
    assert path.read_bytes() == before


def test_the_interpolated_mass_is_that_of_the_frame_to_the_order_of_the_elements(made):
    path, sim = made
    other = Simulation("williamson6", ne=6, np=6, initial=path)
    ours = np.average(other.initial_fields["h"], weights=other.mesh.area)
    theirs = np.average(sim.state.h, weights=Mesh.build(3, 5).area)
    assert ours == pytest.approx(theirs, rel=1e-4)


def test_a_dataset_that_is_changed_later_changes_no_simulation(made):
    ds, sims = open_run(made[0]).isel(time=-1).load(), []
    for _ in range(2):
        ds.h.values[:] += 1.0
        sims.append(Simulation("williamson6", ne=3, np=5, dt=900.0, initial=ds))
    first, second = (sim.initial_fields["h"] for sim in sims)
    assert np.allclose(second - first, 1.0, rtol=0.0, atol=1e-8)


def test_a_file_on_a_grid_is_refused_as_such(made, tmp_path):
    grid = [Output(path=tmp_path / "grid.nc", grid="latlon:4x8")]
    Simulation("williamson6", ne=3, np=5, dt=900.0).run(days=0.0625, outputs=grid)
    with pytest.raises(ConfigError, match="is already on a grid: give the file of a run"):
        Simulation("williamson6", ne=3, np=5, initial=tmp_path / "grid.nc")


def test_a_lake_at_rest_stays_at_rest_on_another_mesh_and_over_another_bottom():
    """The surface of the frame is kept, not its depth over a bottom that is interpolated."""
    lake = Simulation("lake-at-rest", ne=3, np=5).state
    other = Simulation("lake-at-rest", ne=4, np=6, initial=lake)
    level = other.initial_fields["h"] + other.initial_fields["b"]
    assert np.ptp(level) < 1e-9 * level.max()
    assert other.run(days=0.05)["max_wind"] < 1e-9
    flat = Simulation("williamson2", ne=3, np=5).state
    over = Simulation("williamson5", ne=3, np=5, initial=flat)
    assert np.allclose(over.initial_fields["h"] + over.initial_fields["b"], flat.h, rtol=1e-14)
    back = Simulation("williamson2", ne=3, np=5, initial=over.state)
    assert np.allclose(back.initial_fields["h"], flat.h, rtol=1e-14)
