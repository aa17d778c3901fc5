"""Further files of a run, each with its fields, times and grid, also when the run resumes."""

import re
import shutil
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
import xarray as xr

from swe_sphere import Output, Simulation, every, open_run
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.planet import DAY, HOUR

SMALL = {"ne": 2, "np": 4, "dt": 1800.0, "every": 6.0}
TABLES = """
dt = 1800
every = 6
days = 0.5
[[output]]
path = "wind.nc"
every = 1.5
fields = "u"
grid = "latlon:7x12"
[[output]]
path = "depth.zarr"
fields = ["h"]
"""


def simulation(**more):
    return Simulation("williamson6", **(SMALL | more))


def test_a_rounded_fraction_of_an_hour_is_that_fraction_in_further_files_too(tmp_path):
    sim = Simulation("williamson6", ne=2, np=4)
    sim.run(days=0.25, every=0.333333, outputs=[Output(tmp_path / "a.nc", every=0.333333)])
    assert sim.plan.dt == 1200.0 and len(hours(tmp_path / "a.nc")) == 19


def test_a_picture_of_a_further_file_shows_a_field_of_that_file(tmp_path):
    outputs = [Output(tmp_path / f"{name}.nc", fields=name) for name in ("u", "vorticity")]
    simulation(fields="h,u").run(days=0.25, out=tmp_path / "h.nc", outputs=outputs)
    for name in ("h", "u", "vorticity"):
        with open_run(tmp_path / f"{name}.nc") as data:
            assert data.attrs.get("plot_field", "h") == name


def test_a_run_between_two_steps_of_the_requested_length_states_where_it_is():
    sim = Simulation("williamson5", ne=2, np=4, dt=1000.0)
    for days in (0.3, 0.33):
        sim.run(days=days, every=5)
    with pytest.raises(ConfigError, match=r"no step of 720 s from day 0.33 on ends at a multiple"):
        sim.run(days=0.66, every=5)


def hours(path):
    with open_run(path) as data:
        return (data.time.values / HOUR).tolist()


def files(folder):
    return [
        Output(folder / "fine.nc", every=1.5, fields="h,potential_vorticity"),
        Output(folder / "wind.nc", every=3, fields=["u"], grid="latlon:7x12"),
        Output(folder / "frames.zarr"),
    ]


def same(one, two):
    """Return whether two files hold the same frames: all variables, bit for bit."""
    with xr.open_dataset(one) as first, xr.open_dataset(two) as second:
        return first.drop_attrs().equals(second.drop_attrs())


def test_each_file_has_its_times_and_fields(tmp_path):
    summary = simulation().run(days=0.625, out=tmp_path / "run.nc", outputs=files(tmp_path))
    assert summary.completed
    assert hours(tmp_path / "fine.nc") == [1.5 * k for k in range(11)]
    assert hours(tmp_path / "wind.nc") == [0, 3, 6, 9, 12, 15]
    assert hours(tmp_path / "frames.zarr") == hours(tmp_path / "run.nc") == [0, 6, 12, 15]
    run = open_run(tmp_path / "run.nc").load()
    fine = open_run(tmp_path / "fine.nc").load()
    assert {str(n) for n in fine.data_vars if "time" in fine[n].dims} == {
        "h",
        "potential_vorticity",
    }
    assert np.array_equal(fine.h[::4].values, run.h[:3].values)
    wind, expected = open_run(tmp_path / "wind.nc").load(), run.swe.to_latlon(7, 12)
    assert {str(n) for n in wind.data_vars if "time" in wind[n].dims} == {"u", "v"}
    assert wind.u.dims == ("time", "lat", "lon")
    for name in ("u", "v"):
        assert np.array_equal(wind[name][[0, 2, 4]].values, expected[name][:3].values)
    assert wind.attrs["run_id"] == fine.attrs["run_id"] == run.attrs["run_id"]


def test_files_of_a_run_in_two_calls_are_those_of_one(tmp_path):
    for name in ("once", "twice", "resumed"):
        (tmp_path / name).mkdir()
    simulation().run(days=0.75, out=tmp_path / "once/run.nc", outputs=files(tmp_path / "once"))
    sim, folder = simulation(), tmp_path / "twice"
    for days in (0.3125, 0.75):
        sim.run(days=days, out=folder / "run.nc", outputs=files(folder))
    folder = tmp_path / "resumed"
    out = folder / "run.nc"
    simulation().run(days=0.3125, out=out, outputs=files(folder))
    assert Simulation.from_checkpoint(out).run(days=0.75, out=out).completed
    for name in ("fine.nc", "wind.nc"):
        assert same(tmp_path / "once" / name, tmp_path / "twice" / name)
        assert same(tmp_path / "once" / name, tmp_path / "resumed" / name)
    for name in ("twice", "resumed"):
        assert hours(tmp_path / name / "frames.zarr") == [0, 6, 7.5, 12, 18]


def test_a_run_without_a_main_file_continues_its_further_files(tmp_path):
    sim, wind = simulation(), [Output(tmp_path / "wind.nc", every=3, grid="gaussian:4")]
    sim.run(days=0.25, outputs=wind)
    sim.run(days=0.5, outputs=wind)
    assert hours(wind[0].path) == [0, 3, 6, 9, 12]
    with pytest.raises(ConfigError, match=re.escape(
        f"output: {wind[0].path} belongs to another run: choose another name, or replace it with"
        " --overwrite"
    )):  # fmt: skip
        simulation().run(days=0.5, outputs=wind)
    assert hours(wind[0].path) == [0, 3, 6, 9, 12]
    simulation().run(days=0.125, outputs=wind, overwrite=True)
    assert hours(wind[0].path) == [0, 3]


def test_a_run_that_stops_keeps_all_files_and_resumes_in_them(tmp_path):
    @every(hours=7)
    def stop(sim):
        raise KeyError("stop")

    once, stopped = tmp_path / "once", tmp_path / "stopped"
    for folder in (once, stopped):
        folder.mkdir()
    simulation().run(days=0.5, out=once / "run.nc", outputs=files(once))
    out = stopped / "run.nc"
    summary = simulation().run(days=0.5, out=out, outputs=files(stopped), callbacks=[stop])
    assert summary.status == "failed"
    assert hours(stopped / "fine.nc") == [0, 1.5, 3, 4.5, 6]
    assert Simulation.from_checkpoint(out).run(days=0.5, out=out).completed
    assert same(once / "fine.nc", stopped / "fine.nc")
    assert same(once / "wind.nc", stopped / "wind.nc")


def test_tables_in_a_file(swe, tmp_path):
    (tmp_path / "run.toml").write_text(TABLES)
    status, out, err = swe("run", "williamson6", "--config", "run.toml", "--ne", 2, "--np", 4)
    assert (status, err) == (0, "")
    assert "further files" in out
    assert "wind.nc, depth.zarr" in out
    assert hours("wind.nc") == [1.5 * k for k in range(9)]
    assert hours("depth.zarr") == [0, 6, 12]


@pytest.mark.skipif(find_spec("mpi4py") is None, reason="there is no mpi4py")
def test_ranks_write_the_same_files(tmp_path):
    for ranks in ("1", "2"):
        folder = tmp_path / ranks
        folder.mkdir()
        (folder / "run.toml").write_text(TABLES)
        command = [sys.executable, "-m", "swe_sphere", "run", "williamson6", "--ranks", ranks]
        command += ["--config", "run.toml", "--ne", "2", "--np", "4", "--quiet"]
        subprocess.run(command, cwd=folder, check=True)
    assert same(tmp_path / "1/wind.nc", tmp_path / "2/wind.nc")


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (
            {"path": "x.nc", "ever": 3},
            "unknown option of output 'ever'; did you mean 'every'? There",
        ),
        ({"every": 3}, "output: give a path"),
        ({"path": "x.nc", "every": "6h"}, "output: every: must be a valid number, got '6h'"),
        ({"path": "x.nc", "every": -3.0}, "output: every: must be greater than 0, got -3.0"),
        ({"path": "x.nc", "every": 0.7}, "no step near 1800 s fits"),
        ({"path": "x.nc", "fields": "q"}, "unknown field 'q'; there are: "),
        (
            {"path": "x.nc", "grid": "latlon:7"},
            "there is no grid 'latlon:7': use latlon:ROWSxCOLUMNS",
        ),
        ({"path": "none/x.nc"}, "/none: make it first"),
        ({"path": "run.nc"}, "run.nc would be written twice: choose another name"),
        ({"path": "run.nc.restart"}, "restart would be written twice: choose another name"),
        ("x.nc", "output: must be a list of outputs, got 'x.nc'"),
        (3, "output: must be a list of outputs, got 3"),
    ],
)
def test_faults_are_named_before_a_file_is_written(output, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outputs = output if isinstance(output, str | int) else [output]
    with pytest.raises(ConfigError) as error:
        simulation().run(days=0.5, out="run.nc", outputs=outputs)
    assert message in str(error.value)
    assert [*tmp_path.iterdir()] == []


def test_a_full_disk_ends_the_run_in_one_line(tmp_path, monkeypatch):
    from swe_sphere.io.growing import GrowingFile

    written = GrowingFile.add_record

    def fail(self, values, wait=True):
        if self.records == 3 and "h" not in values:
            raise OSError(28, "No space left on device")
        written(self, values, wait)

    monkeypatch.setattr(GrowingFile, "add_record", fail)
    summary = simulation().run(days=0.5, out=tmp_path / "run.nc", outputs=files(tmp_path))
    assert summary.status == "failed"
    assert f"cannot write {tmp_path / 'wind.nc'}: No space left on device" in summary.reason
    assert hours(tmp_path / "wind.nc") == [0, 3, 6]
    assert RunFailed.exit_status == summary.exit_status


def test_schedules_meet_hours_that_frames_do_not(tmp_path):
    sim = Simulation("williamson6", ne=2, np=4, dt="auto")
    sim.run(days=0.25, outputs=[Output(tmp_path / "odd.nc", every=0.75, fields="h")])
    assert hours(tmp_path / "odd.nc") == [0.75 * k for k in range(9)]
    assert (0.75 * HOUR) % sim.plan.dt == pytest.approx(0.0, abs=1e-6)


def test_a_run_that_resumes_into_another_file_continues_its_further_files(tmp_path, monkeypatch):
    once, parts = tmp_path / "once", tmp_path / "parts"
    for folder in (once, parts):
        folder.mkdir()
    simulation().run(days=0.75, out=once / "run.nc", outputs=files(once))
    simulation().run(days=0.25, out=parts / "a.nc", outputs=files(parts))
    monkeypatch.chdir(tmp_path)
    Simulation.from_checkpoint(parts / "a.nc").run(days=0.5, out=parts / "b.nc")
    Simulation.from_checkpoint(parts / "b.nc").run(days=0.75, out=parts / "c.nc")
    assert same(once / "fine.nc", parts / "fine.nc")
    assert same(once / "wind.nc", parts / "wind.nc")


def test_a_run_that_resumes_elsewhere_finds_its_further_files(swe, tmp_path, monkeypatch):
    (tmp_path / "run.toml").write_text(TABLES)
    arguments = "--config", "run.toml", "--ne", 2, "--np", 4, "--out", "run.nc"
    assert swe("run", "williamson6", *arguments)[0] == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    resumed = "--restart", "../run.nc", "--out", "../run.nc", "--days", 0.75
    status, out, _ = swe("run", "williamson6", *resumed)
    assert status == 0 and "../wind.nc" in out
    assert hours(tmp_path / "wind.nc") == [1.5 * k for k in range(13)]
    assert [*(tmp_path / "elsewhere").iterdir()] == []


def test_a_lost_file_begins_again_with_a_warning(tmp_path):
    sim, wind = simulation(), [Output(tmp_path / "wind.nc", every=3, fields="u")]
    sim.run(days=0.25, outputs=wind)
    wind[0].path.unlink()
    with pytest.warns(UserWarning, match=r"wind\.nc does not exist: it begins at day 0\.25"):
        sim.run(days=0.5)
    assert hours(wind[0].path) == [6, 9, 12]


def test_another_grid_is_no_damage_of_the_file_that_a_run_resumes(tmp_path):
    sim = simulation()
    for grid in ("latlon:7x12", "latlon:9x12"):
        wanted = [Output(tmp_path / "wind.nc", every=3, grid=grid)]
        if grid == "latlon:7x12":
            sim.run(days=0.25, outputs=wanted)
    with pytest.raises(ConfigError, match="its frames hold other fields"):
        sim.run(days=0.5, outputs=wanted)
    assert hours(tmp_path / "wind.nc") == [0, 3, 6]


def test_the_initial_file_is_not_replaced(tmp_path):
    simulation().run(days=0.25, out=tmp_path / "first.nc")
    before = (tmp_path / "first.nc").read_bytes()
    sim = simulation(initial=tmp_path / "first.nc")
    with pytest.raises(ConfigError, match="is a file that the run reads"):
        sim.run(days=0.25, outputs=[Output(tmp_path / "first.nc")], overwrite=True)
    assert (tmp_path / "first.nc").read_bytes() == before


def test_further_files_that_were_moved_with_a_run_are_continued(swe, tmp_path, monkeypatch):
    """A run resumes the files beside its own; those of a copied folder stay as they are."""
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    (old / "run.toml").write_text(TABLES)
    monkeypatch.chdir(old)
    run = "run", "williamson6", "--ne", 2, "--np", 4, "--out", "run.nc"
    assert swe(*run, "--config", "run.toml")[0] == 0
    shutil.copytree(old, new)
    monkeypatch.chdir(new)
    assert swe(*run, "--restart", "run.nc", "--days", 0.75)[0] == 0
    assert hours(new / "wind.nc") == [1.5 * k for k in range(13)]
    assert hours(new / "depth.zarr") == [0, 6, 12, 18]
    assert len(hours(old / "wind.nc")) == 9 and hours(old / "depth.zarr") == [0, 6, 12]
    shutil.copy(old / "wind.nc", new / "wind.nc")
    with pytest.warns(UserWarning, match=r"wind\.nc lacks the frames before day 0\.75"):
        Simulation.from_checkpoint(new / "run.nc").run(days=1, out=new / "run.nc")


def test_a_further_file_named_like_the_file_of_the_run_stays_where_it_is(tmp_path):
    (tmp_path / "other").mkdir()
    outputs = [Output(tmp_path / "other" / "run.nc", fields="h")]
    simulation().run(days=0.25, out=tmp_path / "run.nc", outputs=outputs)
    for file in ("run.nc", "run.nc.restart"):
        sim = Simulation.from_checkpoint(tmp_path / file)
        sim.run(days=sim.time / DAY + 0.25, out=tmp_path / "run.nc")
    assert hours(tmp_path / "run.nc") == hours(tmp_path / "other" / "run.nc") == [0, 6, 12, 18]


@pytest.mark.skipif(find_spec("zarr") is None, reason="zarr is not installed")
def test_a_store_with_foreign_files_is_not_replaced(swe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = "run", "williamson6", "--ne", 2, "--np", 4, "--days", 0.25, "--out", "run.zarr"
    assert swe(*run)[0] == 0
    notes = tmp_path / "run.zarr" / "notes.txt"
    notes.write_text("precious")
    for more in (("--restart", "run.zarr", "--days", 0.5), ("--overwrite",)):
        status, _, err = swe(*run, *more)
        assert status == 2 and "run.zarr contains notes.txt" in err
    status, _, err = swe(*run[:-1], "run.zarr/inner.nc")
    assert status == 2 and "run.zarr is a Zarr store" in err
    (tmp_path / "run.zarr" / "h" / "inner.txt").write_text("precious")
    notes.unlink()
    status, _, err = swe(*run, "--restart", "run.zarr", "--days", 0.5)
    assert status == 2 and "run.zarr contains inner.txt" in err
    (tmp_path / "run.zarr" / "h" / "inner.txt").rename(notes)
    for left in ("..zmetadata.0123456789abcdef.part", "h/0.0.0.0123abcd.partial"):  # after a kill
        (tmp_path / "run.zarr" / left).touch()
    status, _, err = swe("plot", "run.zarr", "--out", "run.zarr/h/h.png")
    assert status == 2 and "run.zarr is a Zarr store" in err
    regrid = "regrid", "run.zarr", "--grid", "latlon:7x12", "--overwrite", "--out"
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "thesis.txt").write_text("precious")
    status, _, err = swe(*regrid, "folder.zarr")
    assert status == 2 and "folder.zarr is a folder" in err
    assert notes.exists() and (tmp_path / "folder.zarr" / "thesis.txt").exists()
    notes.unlink()
    assert swe(*run, "--restart", "run.zarr", "--days", 0.5)[0] == 0
    (tmp_path / "kept").mkdir()
    (tmp_path / "grid.zarr").symlink_to("kept/grid.zarr")
    assert swe(*regrid, "grid.zarr")[0] == 0 and swe(*regrid, "grid.zarr")[0] == 0
    assert (tmp_path / "grid.zarr").is_symlink()
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["grid.zarr"]


def test_a_file_that_a_run_writes_is_not_replaced_by_its_regridded_frames(swe, tmp_path):
    first, live = tmp_path / "first.nc", tmp_path / "live.nc"
    simulation().run(days=0.25, out=first)
    found = []

    def regrid(sim):
        found.append(swe("regrid", first, "--grid", "latlon:7x12", "--out", live, "--overwrite"))

    simulation().run(days=0.25, out=live, callbacks=[every(hours=6)(regrid)])
    assert found and all(status == 2 and "another program" in err for status, _, err in found)
    assert hours(live) == [0, 6]
