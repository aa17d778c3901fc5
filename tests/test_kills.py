"""A process killed at any moment leaves whole files: every frame that was finished can be read."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray

from swe_sphere.io.checkpoint import read_checkpoint
from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """The library that kills a process at a call of our choice."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("there is no C compiler, or it is not that of Linux")
    library = tmp_path_factory.mktemp("shim") / "kills.so"
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", library, HERE / "kills.c", "-ldl"]
    subprocess.run(command, check=True)
    return library


@pytest.fixture
def quick_folder(tmp_path):
    """In memory where there is such a place: what is tested has nothing to do with disks."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.mark.exhaustive
def test_a_kill_at_any_call_leaves_whole_files(shim, quick_folder):
    """Before each write, truncation, sync, rename and removal in turn, and amid each write.

    Of a new run, and of one that goes on in its file.
    """
    found = json.loads(
        subprocess.check_output(
            [sys.executable, HERE / "kills.py", quick_folder],
            text=True, env=os.environ | {"LD_PRELOAD": str(shim)}, timeout=300,
        )
    )  # fmt: skip
    assert found["positions"] > 800
    assert found["runs_to_the_end"] == 4
    assert 0 < found["no_file_yet"] < found["positions"]
    assert found["unreadable"] == found["frames_lost"] == found["checkpoints_lost"] == 0


DT = 1200.0
ENDLESS = (
    "run", "williamson6", "--ne=2", "--np=4", f"--dt={DT}", f"--every={DT / 3600.0}",
    "--days=20000", "--quiet",
)  # fmt: skip


@pytest.mark.parametrize("delay", [0.0, 0.37])
@pytest.mark.thorough
def test_a_killed_run_goes_on_bit_for_bit(tmp_path, delay):
    file, rest, whole = (tmp_path / f"{name}.nc" for name in ("killed", "rest", "whole"))
    program = Path(sys.executable).with_name("swe-sphere")
    with subprocess.Popen([program, *ENDLESS, f"--out={file}"]) as process:
        _wait_for_frames(file, 5)
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    with xarray.open_dataset(file) as data, netCDF4.Dataset(file) as raw:
        frames = data.load().sizes["time"]
        assert np.isfinite(raw["h"][:]).all() and len(raw["h"]) == frames >= 5
    steps = read_checkpoint(file).steps
    assert steps in (frames - 2, frames - 1)
    days = (steps + 3) * DT / DAY
    run_scene(make_config({"scene": "williamson6", "restart": file, "out": rest, "days": days}))
    asked = {"ne": 2, "np": 4, "dt": DT, "every": DT / 3600.0, "days": days}
    run_scene(make_config({"scene": "williamson6", **asked, "out": whole}))
    assert RunFile(rest).times[-1] == RunFile(whole).times[-1]
    for name, values in RunFile(whole).frame().items():
        assert RunFile(rest).frame()[name].tobytes() == values.tobytes()
    first = RunFile(file).frame(0.0)["vorticity"]
    assert first.tobytes() == RunFile(whole).frame(0.0)["vorticity"].tobytes()


def _wait_for_frames(file, count):
    """Until a run has written so many; its file can be read all the while."""
    end = time.monotonic() + 300.0
    while time.monotonic() < end:
        if file.exists() and RunFile(file).times.size >= count:
            return
        time.sleep(0.01)
    raise AssertionError(f"no {count} frames in five minutes")
