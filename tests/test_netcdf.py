"""Files of runs: structure, what survives failing disks and kills, restarts to the last bit."""

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.mesh import build_mesh
from swe_sphere.output.netcdf import FrameWriter, read_checkpoint
from swe_sphere.output.runfile import RunFile

NAMES = ("h", "u", "v", "vorticity", "divergence")


@pytest.fixture(scope="module")
def mesh():
    return build_mesh(3, 4, stretch=1.5, centre=(0.1, 0.2), spin=0.3)


def frame(mesh, seed):
    generator = np.random.default_rng(seed)
    return {name: generator.normal(size=mesh.size) for name in NAMES}


def memory(size, seed):
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
        writer.record(0.0, {"mass": 1.0, "l2_h": None})
        writer.write(0.0, frame(mesh, 0))
        writer.write(7200.0, frame(mesh, 1), {"mass": 2.0, "l2_h": 0.5})
        writer.checkpoint(memory(mesh.size, 1), 7200.0, 24, "bdf2")
        writer.set_attributes({"rhs_evaluations": 17})
    return path


def test_xarray_reads_fields_times_and_series(written, mesh):
    with xarray.open_dataset(written) as data:
        assert dict(data.sizes) == {
            "time": 2, "diagnostic_time": 2, "node": mesh.size, "face": mesh.size - 2, "corner": 4
        }  # fmt: skip
        for name in NAMES:
            np.testing.assert_array_equal(data[name][1], frame(mesh, 1)[name])
        np.testing.assert_array_equal(data["b"], np.arange(mesh.size))
        assert data["time"].values[1] - data["time"].values[0] == np.timedelta64(2, "h")
        np.testing.assert_array_equal(data["mass"], [1.0, 2.0])
        np.testing.assert_array_equal(data["l2_h"], [np.nan, 0.5])
        assert data["area"].sum() == pytest.approx(4.0 * np.pi * mesh.radius**2, rel=1e-6)
        np.testing.assert_allclose(np.radians(data["lon"]), mesh.lon, rtol=0.0, atol=1e-14)


def test_attributes_hold_the_configuration_and_the_mesh(written, mesh):
    run = RunFile(written)
    assert run.attributes["visc"] == '{"nu": 100000.0}'
    assert run.attributes["limit"] == "null"
    assert run.attributes["rhs_evaluations"] == 17
    assert run.attributes["ne"] == mesh.ne
    np.testing.assert_array_equal(run.mesh.xyz, mesh.xyz)


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
        for name in (*NAMES, "b", "area"):
            found = data[name].attrs
            assert (found["mesh"], found["location"]) == ("mesh", "node")
            assert found["units"] and found["long_name"]
            assert all(c in data for c in found["coordinates"].split())
            assert found["grid_mapping"] in data
        assert data["time"].attrs["units"] == "seconds since 2000-01-01 00:00:00"
        assert data["lat"].attrs["standard_name"] == "latitude"
        assert data["lon"].attrs["units"] == "degrees_east"


def test_faces_are_anticlockwise(written):
    with xarray.open_dataset(written, decode_cf=False) as data:
        lon, lat = np.radians(data["lon"].values), np.radians(data["lat"].values)
        xyz = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], -1)
        a, b, _, d = (xyz[corner] for corner in data["face_nodes"].values.T)
    assert (np.einsum("ij,ij->i", np.cross(b - a, d - a), a) > 0.0).all()


def test_a_reserved_name_is_no_diagnostic(tmp_path, mesh):
    with (
        FrameWriter(tmp_path / "run.nc", mesh, {}) as writer,
        pytest.raises(ValueError, match="divergence"),
    ):
        writer.record(0.0, {"divergence": 1.0})


def test_checkpoint_comes_back_bit_by_bit(written, mesh):
    found = read_checkpoint(written)
    assert (found.time, found.steps, found.stepper) == (7200.0, 24, "bdf2")
    assert found.attributes["scene"] == "x"
    for name, array in memory(mesh.size, 1).items():
        back = found.memory[name]
        assert (back.dtype, back.shape) == (np.asarray(array).dtype, np.shape(array))
        assert back.tobytes() == np.asarray(array).tobytes()


def test_latest_checkpoint_wins_also_after_the_memory_changed(tmp_path, mesh):
    path = tmp_path / "run.nc"
    sizes = (5, 5, 5, 9)
    with FrameWriter(path, mesh, {}) as writer:
        for step, size in enumerate(sizes):
            writer.checkpoint({"a": np.full(size, float(step))}, 60.0 * step, step, "rk4")
            writer.set_attributes({"steps": step})
    found = read_checkpoint(path)
    assert found.steps == 3
    np.testing.assert_array_equal(found.memory["a"], np.full(9, 3.0))


def test_a_spoilt_checkpoint_leaves_the_one_before(tmp_path, mesh):
    path = tmp_path / "run.nc"
    with FrameWriter(path, mesh, {}) as writer:
        for step in (1, 2):
            pattern = np.full(1000, 1.2345e6 + step)
            writer.checkpoint({"a": pattern}, 60.0 * step, step, "rk4")
    content = path.read_bytes()
    assert content.count(pattern.tobytes()) == 1
    half_written = np.append(pattern[:500], np.zeros(500)).tobytes()
    path.write_bytes(content.replace(pattern.tobytes(), half_written))
    found = read_checkpoint(path)
    assert found.steps == 1
    np.testing.assert_array_equal(found.memory["a"], pattern - 1.0)
    other = (pattern - 1.0).tobytes()
    path.write_bytes(path.read_bytes().replace(other, other[:-8] + bytes(8)))
    with pytest.raises(ConfigError, match="damaged") as error:
        read_checkpoint(path)
    one_line(error)


def test_files_that_hold_no_checkpoint(tmp_path, mesh, written):
    with FrameWriter(tmp_path / "plain.nc", mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
    content = written.read_bytes()
    (tmp_path / "short.nc").write_bytes(content[: len(content) // 2])
    (tmp_path / "noise.nc").write_bytes(b"no netCDF at all" * 100)
    (tmp_path / "empty.nc").write_bytes(b"")
    (tmp_path / "hole.nc").write_bytes(content[:64] + bytes(4096) + content[4160:])
    for name, reason in {
        "plain": "no checkpoint", "short": "cut short", "noise": "not a file of this kind",
        "empty": "cut short", "hole": "damaged", "missing": "there is no file",
    }.items():  # fmt: skip
        with pytest.raises(ConfigError, match=reason) as error:
            read_checkpoint(tmp_path / f"{name}.nc")
        assert name in one_line(error)


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
    """HDF5 would cut the first one's file to nothing before it notices."""
    path = tmp_path / "run.nc"
    with FrameWriter(path, mesh, {}) as writer:
        writer.write(0.0, frame(mesh, 0))
        with pytest.raises(ConfigError, match="another program"):
            FrameWriter(path, mesh, {})
        writer.write(60.0, frame(mesh, 1))
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
            writer.checkpoint(memory(mesh.size, step), 60.0 * step, step, "rk4")
            checkpoints = step
    return frames, checkpoints, one_line(error)


def check_kept(path, mesh, frames, checkpoints):
    run = RunFile(path)
    np.testing.assert_array_equal(run.times, 60.0 * np.arange(frames))
    for name, values in frame(mesh, frames - 1).items():
        np.testing.assert_array_equal(run.frame()[name], values)
    found = read_checkpoint(path)
    assert found.steps == checkpoints
    np.testing.assert_array_equal(found.memory["state"], memory(mesh.size, checkpoints)["state"])


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
        with pytest.raises(ConfigError, match="No space left on device"):
            FrameWriter(tmp_path / "more.nc", mesh, {})
        assert not (tmp_path / "more.nc").exists()
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def test_no_room_for_a_first_frame(tmp_path, mesh, file_limit):
    file_limit(10_000)
    with pytest.raises(ConfigError, match="File too large"):
        FrameWriter(tmp_path / "run.nc", mesh, {})
    assert not (tmp_path / "run.nc").exists()


ENDLESS = """
import itertools, sys
import numpy as np
from swe_sphere.mesh import build_mesh
from swe_sphere.output.netcdf import FrameWriter
mesh = build_mesh(3, 4)
with FrameWriter(sys.argv[1], mesh, {}) as writer:
    for step in itertools.count(1):
        values = np.full(mesh.size, float(step))
        names = ("h", "u", "v", "vorticity", "divergence")
        writer.write(step, dict.fromkeys(names, values))
        if step % 7 == 1:
            writer.checkpoint({"a": np.full(5000, float(step))}, step, step, "rk4")
        print(step, flush=True)
"""


def test_a_kill_leaves_the_last_checkpoint(tmp_path):
    path: Path = tmp_path / "run.nc"
    run = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, path], stdout=subprocess.PIPE, text=True
    )  # fmt: skip
    lines = [run.stdout.readline() for _ in range(18)]
    run.send_signal(signal.SIGKILL)
    last = int((lines + run.stdout.readlines())[-1])
    run.wait()
    run.stdout.close()
    found = read_checkpoint(path)
    assert found.steps >= (last - 1) // 7 * 7 + 1
    np.testing.assert_array_equal(found.memory["a"], np.full(5000, float(found.steps)))
    read = RunFile(path)
    assert read.times.size >= last
    np.testing.assert_array_equal(read.frame()["h"], read.times[-1])
