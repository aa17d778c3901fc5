"""Runs in Zarr stores: the same as in netCDF files, whole whatever happens, and gone on with."""

import os
import shutil
from contextlib import suppress
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr.storage

from swe_sphere import open_run
from swe_sphere.analysis.regrid import regrid_file
from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import OLD, PART, _marked, _new_name
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.reference_solution import compare
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene

from .support import thorough

SMALL = {"scene": "williamson6", "ne": 2, "np": 4, "dt": 1800.0, "every": 3.0}


def small(**values):
    return run_scene(make_config(SMALL | values))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The same run as netCDF file and as store."""
    folder = tmp_path_factory.mktemp("whole")
    for out in (folder / "jet.nc", folder / "jet.zarr"):
        assert small(days=0.5, out=out).completed
    return folder / "jet.nc", folder / "jet.zarr"


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(2, 4)


def frame(mesh, k):
    names = ("h", "u", "v", "vorticity", "divergence")
    return {name: np.full(mesh.size, 10.0 * n + k) for n, name in enumerate(names)}


def test_a_store_holds_what_a_file_holds(whole):
    """With the same attributes, types and dimensions; also for who knows nothing of this model."""
    one, other = map(open_run, whole)
    for name in one.variables:
        assert one[name].dtype == other[name].dtype, name
        for key, value in one[name].attrs.items():
            np.testing.assert_array_equal(other[name].attrs[key], value)
    xr.testing.assert_equal(one, other)
    differ = {name for name in one.attrs if one.attrs[name] != other.attrs[name]}
    assert differ <= {"run_id", "history", "out", "configuration", "summary", "wall_seconds",
                      "setup_seconds", "compile_seconds"}  # fmt: skip
    plain = xr.open_zarr(whole[1], chunks=None, decode_times=False)
    xr.testing.assert_equal(plain.h, one.h)


def test_comparisons_and_grids_take_stores(whole, tmp_path):
    assert compare(*whole)["linf"] == compare(*reversed(whole))["linf"] == 0.0
    grid = regrid_file(whole[1], "gaussian:6", tmp_path / "grid.zarr")
    assert compare(grid, whole[0])["linf"] < 0.1
    expected = open_run(whole[0]).swe.to_gaussian(6).h
    np.testing.assert_array_equal(xr.open_dataset(grid).h, expected)


@pytest.mark.parametrize("behind", [False, True], ids=["", "checkpoint-behind"])
@pytest.mark.thorough
def test_a_run_goes_on_in_its_own_store(whole, tmp_path, behind):
    """Frame by frame as if it had never stopped; also where the checkpoint is an older one."""
    store = tmp_path / "jet.zarr"
    assert small(days=0.25, out=store).completed
    if behind:
        checkpoint = (tmp_path / "jet.zarr.restart").read_bytes()
        run_scene(
            make_config({"scene": "williamson6", "restart": store, "out": store, "days": 0.375})
        )
        (tmp_path / "jet.zarr.restart").write_bytes(checkpoint)
    run_scene(make_config({"scene": "williamson6", "restart": store, "out": store, "days": 0.5}))
    found, expected = open_run(store), open_run(whole[1])
    for name in ("time", "h", "u", "v"):
        assert found[name].values.tobytes() == expected[name].values.tobytes(), name
    assert np.all(np.diff(found.diagnostic_time) > 0.0) and found.attrs["completed"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["jet.zarr", "jet.zarr.restart"]


@pytest.mark.thorough
def test_a_disk_that_is_full_at_any_write_loses_no_frame(mesh, tmp_path, monkeypatch):
    """At some of the writes of the first frame and of the second with its sample."""
    put, room = zarr.storage._local._put, 1000

    def full(path, *arguments, **options):
        nonlocal room
        room -= 1
        if room < 0:
            if path.parent.exists():  # as a kill would leave it
                path.with_suffix(".partial").write_bytes(b"torn")
            raise OSError(28, "No space left on device")
        return put(path, *arguments, **options)

    monkeypatch.setattr(zarr.storage._local, "_put", full)

    def written(store):
        """Room after each of two frames that could be written."""
        left = []
        with FrameWriter(store, mesh, {"scene": "none"}) as writer, suppress(RunFailed):
            for k in range(2):
                writer.write(60.0 * k, frame(mesh, k), {"mass": 1.0 + k})
                left.append(room)
        return left

    first, both = (1000 - left for left in written(tmp_path / "all.zarr"))
    counts = []
    for given in (3, first // 2, first - 1, *range(first, both, 3), both):
        room, store = given, tmp_path / f"{given}.zarr"
        frames = len(written(store))
        counts.append(frames)
        if frames == 0:
            assert not store.exists()
            continue
        found = RunFile(store)
        assert found.times.tolist() == [0.0, 60.0][:frames]
        for name, values in frame(mesh, frames - 1).items():
            np.testing.assert_array_equal(found.frame()[name], values)
        times, series = found.series()
        assert times.size == series["mass"].size and np.isfinite(series["mass"]).all()
    assert counts == sorted(counts) and min(map(counts.count, range(3))) > 0


@pytest.mark.parametrize("again", [False, True], ids=["given-up", "written-again"])
@pytest.mark.thorough
def test_after_any_single_failed_write_all_frames_can_be_read(mesh, tmp_path, monkeypatch, again):
    """The failure is in the second frame or in the summary, and there is room for what follows."""
    put, put_whole, left = zarr.storage._local._put, Path.write_bytes, 0

    def fails():
        nonlocal left
        left -= 1
        return left == 0

    def put_once_not(path, *arguments, **options):
        if fails():
            path.parent.mkdir(exist_ok=True)
            put_whole(path.with_suffix(".partial"), b"torn")
            raise OSError(28, "No space left on device")
        return put(path, *arguments, **options)

    def put_whole_once_not(file, contents):
        if fails():
            put_whole(file, contents[: len(contents) // 2])
            raise OSError(28, "No space left on device")
        put_whole(file, contents)

    monkeypatch.setattr(zarr.storage._local, "_put", put_once_not)
    monkeypatch.setattr(Path, "write_bytes", put_whole_once_not)
    counts = set()
    for k in count(2 if again else 1, 3):
        store, left = tmp_path / f"{k}.zarr", 0
        with FrameWriter(store, mesh, {"scene": "none"}) as writer:
            writer.write(0.0, frame(mesh, 0), {"mass": 1.0})
            left = k
            with suppress(RunFailed):
                writer.write(60.0, frame(mesh, 1), {"mass": 2.0})
            if again and writer._growing.records == 1:
                writer.write(60.0, frame(mesh, 1), {"mass": 2.0})
            frames = writer._growing.records
            with suppress(RunFailed):
                writer.finish({"days": 1.0})
            whole, left = left > 0, 0
            writer.finish({"days": 1.0})
        counts.add(frames)
        found, plain = RunFile(store), xr.open_zarr(store, chunks=None, decode_times=False)
        assert found.times.tolist() == plain.time.values.tolist() == [0.0, 60.0][:frames]
        for i, time in enumerate(found.times):
            for name, values in frame(mesh, i).items():
                np.testing.assert_array_equal(found.frame(time)[name], values)
                np.testing.assert_array_equal(plain[name][i], values)
        assert found.series()[1]["mass"].tolist() == plain.mass.values.tolist()
        assert plain.mass.values.tolist() == [1.0, 2.0][:frames]
        assert found.attributes["days"] == 1.0
        if whole:
            break
    assert k > 20 and counts == ({2} if again else {1, 2})


def test_the_lengths_are_replaced_at_once_after_the_numbers_are_on_the_disk(
    mesh, tmp_path, monkeypatch
):
    """And not for each of the frames that are copied when a run is resumed."""
    store, synced, published = tmp_path / "run.zarr", set(), []
    sync, replace = os.fsync, os.replace

    def unsynced(folder):
        files = [path for path in folder.glob("*/*") if not path.name.startswith(".")]
        return [path.name for path in files if path.stat().st_ino not in synced]

    def fsync(file):
        synced.add(os.fstat(file).st_ino)
        sync(file)

    def replaced(source, target):
        if Path(target).name == ".zmetadata":
            published.append(unsynced(Path(target).parent))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replaced)
    with FrameWriter(store, mesh, {"scene": "none"}) as writer:
        for k in range(4):
            writer.write(60.0 * k, frame(mesh, k), {"mass": 1.0})
        layout, *commits = published
        assert layout and commits == [[]] * 5  # the first two are made under another name
        writer.finish({})
    assert published[1:] == [[]] * 6
    published.clear()
    with FrameWriter(store, mesh, {"scene": "none"}, append_from=180.0) as writer:
        writer.write(180.0, frame(mesh, 3), {"mass": 1.0})
    assert published[1:] == [[]] * 2
    assert RunFile(store).times.tolist() == [0.0, 60.0, 120.0, 180.0]


def test_a_store_is_whole_while_it_is_written(mesh, tmp_path):
    store = tmp_path / "run.zarr"
    with FrameWriter(store, mesh, {}) as writer:
        for k in range(2):
            writer.write(60.0 * k, frame(mesh, k))
            assert xr.open_zarr(store, chunks=None).sizes["time"] == k + 1
        with pytest.raises(ConfigError, match="another program writes it"):
            FrameWriter(store, mesh, {})
        shutil.rmtree(store)
        with pytest.raises(RunFailed, match="deleted while the run"):
            writer.write(120.0, frame(mesh, 2))


def write(store, mesh, k):
    with FrameWriter(store, mesh, {"scene": "none"}) as writer:
        writer.write(60.0 * k, frame(mesh, k))


def test_only_what_is_its_own_is_removed_when_a_store_is_replaced(mesh, tmp_path):
    """Neither what a user has called so nor what a kill has left is in the way."""
    store, users = (tmp_path / f"run.zarr{end}" for end in ("", ".old.part"))
    write(store, mesh, 1)
    left = _new_name(store, OLD)
    for folder in (users, left):
        folder.mkdir()
        (folder / "kept").write_text("by hand")
    write(store, mesh, 2)
    assert RunFile(store).times.tolist() == [120.0]
    assert (users / "kept").read_text() == "by hand" and not left.exists()


def test_a_kill_amid_the_replacement_loses_neither(mesh, tmp_path, monkeypatch):
    """Until the user has said which of the two it shall be."""
    store, rename, renames = tmp_path / "run.zarr", Path.replace, []
    write(store, mesh, 1)

    def killed(path, target):
        if path.parent == tmp_path:
            renames.append(target)
            if len(renames) == 2:
                raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(Path, "replace", killed)
    with FrameWriter(store, mesh, {}) as writer:
        with pytest.raises(KeyboardInterrupt):
            writer.write(120.0, frame(mesh, 2))
        assert [len(_marked(store, ending)) for ending in (PART, OLD)] == [1, 1]
        assert len([*tmp_path.iterdir()]) == 2
        shutil.copytree(tmp_path, tmp_path.with_name("killed"))
    store = tmp_path.with_name("killed") / "run.zarr"
    for again in (lambda: FrameWriter(store, mesh, {}), lambda: RunFile(store)):
        with pytest.raises(ConfigError, match=r"rename .*\.part\.zarr \(the new one\) or .*old"):
            again()
    (new,), (old,) = _marked(store), _marked(store, OLD)
    assert RunFile(new).times.tolist() == [120.0]
    old.rename(store)
    assert RunFile(store).times.tolist() == [60.0]
    write(store, mesh, 3)
    assert [path.name for path in store.parent.iterdir()] == ["run.zarr"]


def test_what_is_no_store_is_left_alone(whole, tmp_path, capsys):
    folder = tmp_path / "thesis.zarr"
    folder.mkdir()
    (folder / "chapter").write_text("one")
    for arguments in ([folder], [folder, "--overwrite"], [whole[1]]):
        with pytest.raises(SystemExit, match="2"):
            main(["run", "williamson2", "--out", *map(str, arguments)])
    said = capsys.readouterr().err
    assert said.count("is a folder") == 2 and said.count("holds a finished run") == 1
    assert (folder / "chapter").read_text() == "one"


@pytest.mark.parametrize(
    ("missing", "complaint"),
    [("h/1.0", "values of h are"), thorough("u/2.0", "values of u are"),
     thorough("vorticity/1.0", "of vorticity"), ("time/2", "its times"),
     thorough("b/0", "values of b are")],
)  # fmt: skip
def test_a_missing_chunk_is_noticed(missing, complaint, tmp_path):
    """Zarr reads it as its fill value, and says nothing."""
    store = tmp_path / "run.zarr"
    assert small(scene="williamson5", days=0.25, out=store).completed
    (store / missing).unlink()
    time = {"h/1.0": 1.0, "vorticity/1.0": 1.0}.get(missing, 2.0) * 3.0 * 3600.0

    def read():
        RunFile(store).frame(time)

    def compared():
        compare(store, store, None if missing[0] in "tb" else missing.split("/")[0], time)

    def regridded():
        regrid_file(store, "latlon:18x36", tmp_path / "grid.nc")

    for use in (read, compared, regridded):
        with pytest.raises(ConfigError, match=f"damaged.*{complaint}"):
            use()
    assert not (tmp_path / "grid.nc").exists()


def test_a_store_without_a_chunk_is_not_resumed_in_place(tmp_path, monkeypatch):
    """Its frames would be copied with fill values."""
    monkeypatch.chdir(tmp_path)
    given = {"scene": "williamson2", "out": "run.zarr"}
    run_scene(make_config(given | {"ne": 2, "np": 4, "dt": 1800.0, "days": 0.25, "every": 1.0}))
    (tmp_path / "run.zarr" / "h" / "2.0").unlink()
    with pytest.raises(ConfigError, match=r"run\.zarr is .* damaged: .* of h are missing"):
        run_scene(make_config(given | {"restart": "run.zarr", "days": 0.5}))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run.zarr", "run.zarr.restart"]


def test_a_store_without_the_times_of_its_series_is_not_resumed_in_place(tmp_path):
    store = tmp_path / "run.zarr"
    assert small(scene="williamson5", days=0.25, out=store).completed
    (store / "diagnostic_time" / "0").unlink()
    reason = "run.zarr is incomplete or damaged: 13 values of diagnostic_time are missing"
    with pytest.raises(ConfigError, match=reason):
        RunFile(store).series()
    resumed = {"scene": "williamson5", "days": 0.5, "restart": store, "out": store}
    with pytest.raises(ConfigError, match=reason):
        run_scene(make_config(resumed))
