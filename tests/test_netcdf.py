"""Files of runs: structure, what survives failing disks and other programs, checkpoints."""

import json
import os
import re
import resource
import subprocess

import numpy as np
import pytest
import xarray
from scipy.io import netcdf_file

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.io.checkpoint import checkpoint_path, read_checkpoint
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh

NAMES = ("h", "u", "v", "vorticity", "divergence")


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(3, 4, stretch=1.5, centre=(6.0, 11.0), spin=17.0)


def frame(mesh, seed):
    generator = np.random.default_rng(seed)
    return {name: generator.normal(size=mesh.size) for name in NAMES}


def state_dict(size, seed):
    generator = np.random.default_rng(seed)
    return {
        "state": generator.normal(size=3 * size),
        "previous": generator.normal(size=(2, size)).astype(np.float32),
        "count": np.array([1, 2, 3]),
        "started": np.array(True),
        "ratio": np.float64(0.1),
        "none": np.zeros((0, 4)),
    }


def one_line(error):
    text = str(error.value)
    assert text and "\n" not in text
    return text


@pytest.fixture
def written(tmp_path, mesh):
    path = tmp_path / "run.nc"
    attributes = {"scene": "x", "dt": 300.0, "limit": None, "visc": {"nu": 1e5}, "ne": 99}
    with FrameWriter(path, mesh, attributes, bottom=np.arange(mesh.size)) as writer:
        writer.write(0.0, frame(mesh, 0), {"mass": 1.0, "l2_h": None})
        writer.record(3600.0, {"mass": 1.5})
        writer.write(7200.0, frame(mesh, 1), {"mass": 2.0, "l2_h": 0.5})
        writer.checkpoint(state_dict(mesh.size, 1), 24)
        writer.finish({"rhs_evaluations": 17, "cuts": ["a", "b"]})
    return path


def test_xarray_reads_fields_times_and_series(written, mesh):
    with xarray.open_dataset(written) as data:
        assert dict(data.sizes) == {
            "time": 2, "diagnostic_time": 3, "node": mesh.size, "face": mesh.size - 2, "corner": 4
        }  # fmt: skip
        for name in NAMES:
            np.testing.assert_array_equal(data[name][1], frame(mesh, 1)[name])
        np.testing.assert_array_equal(data["b"], np.arange(mesh.size))
        assert data["time"].values[1] - data["time"].values[0] == np.timedelta64(2, "h")
        np.testing.assert_array_equal(data["mass"], [1.0, 1.5, 2.0])
        np.testing.assert_array_equal(data["l2_h"], [np.nan, np.nan, 0.5])
        assert data["diagnostic_time"].values[1] - data["time"].values[0] == np.timedelta64(1, "h")
        assert json.loads(data.attrs["summary"]) == {"rhs_evaluations": 17, "cuts": ["a", "b"]}
        assert data["area"].sum() == pytest.approx(4.0 * np.pi * mesh.radius**2, rel=1e-6)
        np.testing.assert_allclose(np.radians(data["lon"]), mesh.lon, rtol=0.0, atol=1e-14)


def test_attributes_hold_the_configuration_and_the_mesh(written, mesh):
    run = RunFile(written)
    assert run.attributes["visc"] == '{"nu": 100000.0}'
    assert run.attributes["limit"] == "null"
    assert run.attributes["rhs_evaluations"] == 17
    assert run.attributes["ne"] == mesh.ne
    np.testing.assert_array_equal(run.mesh.xyz, mesh.xyz)


def test_only_the_fields_asked_for_are_written(tmp_path, mesh):
    with FrameWriter(tmp_path / "run.nc", mesh, {"scene": "x"}, only=("v", "h")) as writer:
        for k in range(2):
            writer.write(60.0 * k, frame(mesh, k), {"mass": 1.0})
    run = RunFile(tmp_path / "run.nc")
    assert [*run.frame()] == ["b", "h", "v"]
    np.testing.assert_array_equal(run.frame()["v"], frame(mesh, 1)["v"])
    with pytest.raises(ConfigError, match="unknown field 'vortiticy'; did you mean 'vorticity'"):
        FrameWriter(tmp_path / "more.nc", mesh, {}, only=["vortiticy"])
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"]


def test_derived_fields_have_the_values_of_their_formulas(tmp_path, mesh):
    values = {"u": 3.0, "v": 4.0, "h": 100.0, "vorticity": 1e-5, "divergence": 0.0, "f": 1e-4}
    expected = {"kinetic_energy": 12.5, "potential_vorticity": 1.1e-6}
    with FrameWriter(tmp_path / "run.nc", mesh, {}, only=[*expected]) as writer:
        writer.write(0.0, {name: np.full(mesh.size, x) for name, x in values.items()})
    frame = RunFile(tmp_path / "run.nc").frame()
    for name, value in expected.items():
        np.testing.assert_allclose(frame[name], value, rtol=1e-14)


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_a_frame_of_another_length_is_not_written(tmp_path, mesh, ending):
    with FrameWriter(tmp_path / f"run.{ending}", mesh, {"scene": "x"}) as writer:
        writer.write(0.0, frame(mesh, 0))
        for wrong in (np.zeros(mesh.size - 1), np.zeros(mesh.size + 1)):
            with pytest.raises(ValueError):
                writer.write(60.0, frame(mesh, 1) | {"v": wrong})
        writer.write(120.0, frame(mesh, 2))
    run = RunFile(writer.path)
    assert run.times.tolist() == [0.0, 120.0]
    for k in (0, 2):
        for name, values in frame(mesh, k).items():
            np.testing.assert_array_equal(run.frame(60.0 * k)[name], values)


def test_a_run_goes_on_under_its_own_run_id_and_on_its_own_mesh_alone(written, mesh):
    before, run_id = written.read_bytes(), RunFile(written).attributes["run_id"]
    with FrameWriter(written, mesh, {}, append_from=7200.0) as writer:
        assert writer.run_id == run_id
    with FrameWriter(written.with_name("other.nc"), mesh, {}) as writer:
        assert writer.run_id != run_id
    other = Mesh.build(2, 4)
    with pytest.raises(ConfigError, match=rf"its mesh has {mesh.size} nodes, not {other.size}"):
        FrameWriter(written, other, {}, append_from=7200.0)
    assert written.read_bytes() == before


def test_a_run_resumes_in_a_file_with_times_in_hours(written, mesh):
    """xarray saves times so, once it has decoded them."""
    with xarray.open_dataset(written) as decoded:
        hours = decoded.load()
    hours.assign_coords(time=hours.time + np.timedelta64(0, "h")).to_netcdf(written)
    with FrameWriter(written, mesh, {}, append_from=7200.0) as writer:
        writer.write(7200.0, frame(mesh, 1))
        writer.write(10800.0, frame(mesh, 2))
    assert RunFile(written).times.tolist() == [0.0, 7200.0, 10800.0]


def test_history_and_coriolis(tmp_path, mesh):
    with FrameWriter(tmp_path / "run.nc", mesh, {"scene": "x"}, coriolis=mesh.lat) as writer:
        writer.write(0.0, frame(mesh, 0))
    with xarray.open_dataset(tmp_path / "run.nc") as data:
        np.testing.assert_array_equal(data["f"], mesh.lat)
        assert re.fullmatch(r"\d{4}-[\dT:-]+Z swe-sphere [\d.]+: run x", data.attrs["history"])
        assert data.attrs["source"].startswith("swe_sphere ")


def test_conventions(written, mesh):
    with xarray.open_dataset(written, decode_cf=False) as data:
        assert data.attrs["Conventions"] == "CF-1.11 UGRID-1.0"
        topology = data["mesh"].attrs
        assert topology["cf_role"] == "mesh_topology"
        assert topology["topology_dimension"] == 2
        assert all(name in data for name in topology["node_coordinates"].split())
        faces = data[topology["face_node_connectivity"]]
        assert faces.attrs["start_index"] == 0
        np.testing.assert_array_equal(np.unique(faces), np.arange(mesh.size))
        for name in (*NAMES, "b", "f", "area"):
            found = data[name].attrs
            assert (found["mesh"], found["location"]) == ("mesh", "node")
            assert found["units"] and found["long_name"]
            assert all(c in data for c in found["coordinates"].split())
            assert found["grid_mapping"] in data
        for name in ("time", "diagnostic_time"):
            assert data[name].attrs["units"] == "seconds since 2000-01-01 00:00:00"
            assert data[name].attrs["calendar"] == "proleptic_gregorian"
        assert data["lat"].attrs["standard_name"] == "latitude"
        assert data["lon"].attrs["units"] == "degrees_east"


def test_faces_are_anticlockwise(written):
    with xarray.open_dataset(written, decode_cf=False) as data:
        lon, lat = np.radians(data["lon"].values), np.radians(data["lat"].values)
        xyz = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], -1)
        a, b, _, d = (xyz[corner] for corner in data["face_nodes"].values.T)
    assert (np.einsum("ij,ij->i", np.cross(b - a, d - a), a) > 0.0).all()


@pytest.mark.parametrize("name", ["divergence", "lat", "diagnostic_time"])
def test_a_reserved_name_is_no_diagnostic(tmp_path, mesh, name):
    with (
        FrameWriter(tmp_path / "run.nc", mesh, {}) as writer,
        pytest.raises(ConfigError, match=f"cannot be called '{name}'"),
    ):
        writer.write(0.0, frame(mesh, 0), {name: 1.0})
    assert [*tmp_path.iterdir()] == []


def test_series_are_those_of_the_first_frame_and_have_their_room(tmp_path, mesh):
    with FrameWriter(tmp_path / "run.nc", mesh, {}, samples=2) as writer:
        with pytest.raises(ValueError, match="must be a frame"):
            writer.record(0.0, {"mass": 1.0})
        writer.write(0.0, frame(mesh, 0), {"mass": 1.0})
        with pytest.raises(RunFailed, match="no series of energy"):
            writer.record(60.0, {"mass": 2.0, "energy": 3.0})
        writer.record(60.0, {"mass": 2.0})
        with pytest.raises(ValueError, match="room for 2 samples only"):
            writer.record(120.0, {"mass": 3.0})
    times, series = RunFile(tmp_path / "run.nc").series()
    assert (times.tolist(), series["mass"].tolist()) == ([0.0, 60.0], [1.0, 2.0])


def test_a_summary_that_is_too_long_loses_its_end(tmp_path, mesh):
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
        assert RunFile(writer.path).attributes["completed"] is False
        writer.finish({"completed": True, "reason": "ü" * 1000, "cuts": "x" * 100_000})
    attributes = RunFile(tmp_path / "run.nc").attributes
    assert (attributes["completed"], attributes["reason"]) == (True, "ü" * 1000)
    assert "cuts" not in attributes


def test_plain_readers_of_the_format_read_it_too(written, mesh):
    with netcdf_file(written, mmap=False) as file:
        np.testing.assert_array_equal(file.variables["mass"][:], [1.0, 1.5, 2.0])
        np.testing.assert_array_equal(file.variables["u"][1], frame(mesh, 1)["u"])


def test_checkpoint_comes_back_bit_by_bit(written, mesh):
    found = read_checkpoint(written)
    assert (found.steps, found.attributes["scene"]) == (24, "x")
    for name, array in state_dict(mesh.size, 1).items():
        back = found.state_dict[name]
        assert (back.dtype, back.shape) == (np.asarray(array).dtype, np.shape(array))
        assert back.tobytes() == np.asarray(array).tobytes()


def test_latest_checkpoint_wins_also_after_the_memory_changed(tmp_path, mesh):
    path = tmp_path / "run.nc"
    with FrameWriter(path, mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
        for step, size in enumerate((5, 5, 5, 9)):
            writer.checkpoint({"file": np.full(size, float(step))}, step)
    for place in (path, checkpoint_path(path)):
        found = read_checkpoint(place)
        assert found.steps == 3
        np.testing.assert_array_equal(found.state_dict["file"], np.full(9, 3.0))


@pytest.mark.parametrize("stride", [61, pytest.param(5, marks=pytest.mark.thorough)])
def test_a_spoilt_checkpoint_is_never_taken_for_a_whole_one(tmp_path, mesh, stride):
    """Whatever byte is wrong or missing: the same numbers come back, or one line."""
    path = tmp_path / "run.nc"
    arrays = {"a": np.arange(3.0), "b": np.array([1, 2])}
    with FrameWriter(path, mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
        writer.checkpoint(arrays, 1)
    beside = checkpoint_path(path)
    whole = beside.read_bytes()
    refused = 0
    for place in range(0, len(whole), stride):
        spoilt = whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :]
        for content in (spoilt, whole[:place]):
            beside.write_bytes(content)
            try:
                found = read_checkpoint(path)
            except ConfigError as error:
                assert "damaged" in str(error) and "\n" not in str(error)
                refused += 1
                continue
            assert found.steps == 1
            for name, array in arrays.items():
                assert found.state_dict[name].tobytes() == array.tobytes()
    assert refused > len(whole) // stride


def test_a_checkpoint_left_behind_by_another_run_is_not_taken(tmp_path, mesh, written):
    with FrameWriter(written, mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 2))
    with pytest.raises(ConfigError, match="checkpoint of another run") as error:
        read_checkpoint(written)
    one_line(error)
    assert read_checkpoint(checkpoint_path(written)).steps == 24


def test_files_that_hold_no_checkpoint(tmp_path, mesh, written):
    with FrameWriter(tmp_path / "plain.nc", mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
    content = written.read_bytes()
    (tmp_path / "short.nc").write_bytes(content[:1000])
    (tmp_path / "noise.nc").write_bytes(b"no netCDF at all" * 100)
    (tmp_path / "empty.nc").write_bytes(b"")
    (tmp_path / "hole.nc").write_bytes(content[:64] + bytes(4096) + content[4160:])
    for name, reason in {
        "plain": "no checkpoint: there is no file", "short": "cut short",
        "noise": "not a file of this kind", "empty": "cut short", "hole": "damaged",
        "missing": "there is no file",
    }.items():  # fmt: skip
        with pytest.raises(ConfigError, match=reason) as error:
            read_checkpoint(tmp_path / f"{name}.nc")
        assert name in one_line(error)


def test_a_file_that_was_cut_short_is_not_read(tmp_path, written):
    content = written.read_bytes()
    for part in (1, 8, len(content) // 2):
        written.write_bytes(content[:-part])
        with pytest.raises(ConfigError, match="cut short") as error:
            RunFile(written)
        one_line(error)


@pytest.mark.parametrize("where", ["missing/run.nc", "", "file/run.nc"])
def test_places_that_cannot_be_written(tmp_path, mesh, where):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(ConfigError, match="cannot write") as error:
        FrameWriter(tmp_path / where, mesh, {})
    one_line(error)


def test_a_folder_without_permission(tmp_path, mesh):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match="Permission denied"):
        FrameWriter(tmp_path / "run.nc", mesh, {})


def test_two_runs_do_not_write_one_file(tmp_path, mesh):
    """Neither before nor after the first frame has made the file."""
    path = tmp_path / "run.nc"
    with FrameWriter(path, mesh, {}) as writer:
        for k in range(2):
            with pytest.raises(ConfigError, match="another program writes it"):
                FrameWriter(path, mesh, {})
            writer.write(60.0 * k, frame(mesh, k))
    np.testing.assert_array_equal(RunFile(path).frame()["u"], frame(mesh, 1)["u"])


@pytest.fixture
def file_limit():
    """Lets files grow to so many bytes only: a disk that fills up, for every user."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def write_until_full(path, mesh, most=1000):
    """Write frames and checkpoints until that fails; how many of each there should be."""
    frames = checkpoints = 0
    with pytest.raises(RunFailed, match="cannot write") as error, FrameWriter(
        path, mesh, {}
    ) as writer:  # fmt: skip
        for step in range(most):
            writer.write(60.0 * step, frame(mesh, step), {"mass": 1.0, "energy": 2.0})
            frames = step + 1
            writer.checkpoint({"state": np.full(8 * mesh.size, step)}, step)
            checkpoints = step
    return frames, checkpoints, one_line(error)


def check_kept(path, mesh, frames, checkpoints):
    run = RunFile(path)
    np.testing.assert_array_equal(run.times, 60.0 * np.arange(frames))
    for name, values in frame(mesh, frames - 1).items():
        np.testing.assert_array_equal(run.frame()[name], values)
    found = read_checkpoint(path)
    assert found.steps == checkpoints
    state = np.full(8 * run.bottom.size, checkpoints)
    np.testing.assert_array_equal(found.state_dict["state"], state)
    assert sorted(file.name for file in path.parent.iterdir()) == ["run.nc", "run.nc.restart"]


def test_a_full_disk_keeps_every_frame(tmp_path, mesh, file_limit):
    file_limit(1_200_000)
    frames, checkpoints, text = write_until_full(tmp_path / "run.nc", mesh)
    assert "File too large" in text
    assert frames > 5
    check_kept(tmp_path / "run.nc", mesh, frames, checkpoints)


def test_a_full_file_system_keeps_every_frame(tmp_path, mesh):
    if os.geteuid() != 0 or subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1200k", "tmpfs", str(tmp_path)],
        check=False, capture_output=True,
    ).returncode:  # fmt: skip
        pytest.skip("only root can mount a small file system")
    try:
        frames, checkpoints, text = write_until_full(tmp_path / "run.nc", mesh)
        assert "No space left on device" in text
        check_kept(tmp_path / "run.nc", mesh, frames, checkpoints)
        (tmp_path / "rest").write_bytes(bytes(os.statvfs(tmp_path).f_bavail * 4096))
        with pytest.raises(RunFailed, match="No space left on device"):
            FrameWriter(tmp_path / "more.nc", mesh, {})
        assert not (tmp_path / "more.nc").exists()
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def test_no_room_for_a_first_frame(tmp_path, mesh, file_limit):
    file_limit(10_000)
    with pytest.raises(ConfigError, match="File too large"):
        FrameWriter(tmp_path / "run.nc", mesh, {})
    assert not (tmp_path / "run.nc").exists()


def removed(path):
    path.unlink()


def moved(path):
    path.rename(path.with_name("elsewhere.nc"))


def replaced(path):
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)


def emptied(path):
    path.write_bytes(b"")


def cut(path):
    os.truncate(path, path.stat().st_size - 8)


def overwritten(path):
    with path.open("r+b") as file:
        file.write(bytes(100))


@pytest.mark.parametrize("harm", [removed, moved, replaced, emptied, cut, overwritten])
@pytest.mark.parametrize("call", ["write", "record", "checkpoint", "finish"])
def test_a_file_that_others_remove_or_change_is_noticed_at_once(tmp_path, mesh, harm, call):
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0), {"mass": 1.0})
        harm(writer.path)
        arguments = {
            "write": (60.0, frame(mesh, 1)), "record": (60.0, {"mass": 1.0}),
            "checkpoint": (state_dict(mesh.size, 1), 1),
            "finish": ({"completed": True},),
        }  # fmt: skip
        with pytest.raises(RunFailed, match=r"run\.nc was .* while the run") as error:
            getattr(writer, call)(*arguments[call])
        one_line(error)


def test_an_old_file_stays_until_there_is_a_first_frame(tmp_path, mesh, written):
    before = written.read_bytes()
    with FrameWriter(written, mesh, {}):
        assert written.read_bytes() == before
    assert written.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.nc", "run.nc.restart"]


def test_a_link_leads_to_the_file(tmp_path, mesh):
    (tmp_path / "disk").mkdir()
    (tmp_path / "link.nc").symlink_to(tmp_path / "disk" / "run.nc")
    with FrameWriter(tmp_path / "link.nc", mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
    assert (tmp_path / "link.nc").is_symlink()
    assert RunFile(tmp_path / "disk" / "run.nc").times.tolist() == [0.0]


def test_what_is_no_file_is_not_replaced(tmp_path, mesh):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="it is not a file"):
        FrameWriter(tmp_path / "pipe", mesh, {})


def test_a_file_can_be_read_while_it_is_written(tmp_path, mesh):
    with FrameWriter(tmp_path / "run.nc", mesh, {}) as writer:
        for k in range(3):
            writer.write(60.0 * k, frame(mesh, k))
            run = RunFile(writer.path)
            assert run.times.size == k + 1
            np.testing.assert_array_equal(run.frame()["divergence"], frame(mesh, k)["divergence"])
