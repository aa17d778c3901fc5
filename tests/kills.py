"""Writes a short run again and again, killed at every call that changes its files in turn.

Once as a new file; once as a run that goes on in its file, which has a frame after its checkpoint.

Started by test_kills.py with the library made of kills.c preloaded; prints what it found as JSON.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import sys
from collections import Counter
from pathlib import Path

import netCDF4
import numpy as np
import xarray

from swe_sphere.errors import ConfigError
from swe_sphere.io.checkpoint import checkpoint_path, read_checkpoint
from swe_sphere.io.netcdf import FrameWriter
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh

MESH = Mesh.build(2, 3)
NAMES = ("h", "u", "v", "vorticity", "divergence")
FRAMES = 3
COUNTED = (
    "positions", "no_file_yet", "unreadable", "frames_lost", "checkpoints_lost", "runs_to_the_end"
)  # fmt: skip


def frame(k: int) -> dict[str, np.ndarray]:
    """Fields that tell which frame they are of, and whether all of it is there."""
    return {n: np.random.default_rng([k, i]).normal(size=MESH.size) for i, n in enumerate(NAMES)}


def state_dict(k: int) -> dict[str, np.ndarray]:
    """Arrays of a stepper that stood at that frame."""
    return {"state": np.random.default_rng([k, 99]).normal(size=3 * MESH.size), "n": np.array(k)}


def numbers(k: float) -> dict[str, float]:
    """Diagnostics at that frame."""
    return {"mass": 1.0 + k, "energy": 2.0 + k}


def write(path: Path, progress: int, first: int = 0, last: int = FRAMES) -> None:
    """Frames of a run with samples between them; a letter for all that is finished."""
    start = 60.0 * first if first else None
    with FrameWriter(path, MESH, {"scene": "x"}, samples=9, append_from=start) as writer:
        for k in range(first, last):
            writer.write(60.0 * k, frame(k), numbers(k))
            os.write(progress, b"f")
            writer.checkpoint(state_dict(k), k)
            os.write(progress, b"c")
            writer.record(60.0 * k + 30.0, numbers(k + 0.5))
        writer.finish({"completed": True, "steps": last})
        os.write(progress, b"e")


def unfinished(path: Path) -> None:
    """Three frames, with the checkpoint of the second."""
    silent = os.open(os.devnull, os.O_WRONLY)
    write(path, silent, last=FRAMES - 1)
    early = checkpoint_path(path).read_bytes()
    write(path, silent, FRAMES - 1)
    checkpoint_path(path).write_bytes(early)
    os.close(silent)


def killed(path: Path, call: int, half: bool, appends: bool) -> tuple[str, bool]:
    """What a process had finished when it was killed at that call, and whether it was."""
    shim = ctypes.CDLL(None)
    reading, progress = os.pipe()
    child = os.fork()
    if child == 0:
        shim.kill_at(os.fsencode(path.parent), ctypes.c_long(call), int(half))
        write(path, progress, *((FRAMES - 2, FRAMES + 1) if appends else ()))
        os._exit(0)
    os.close(progress)
    with os.fdopen(reading) as pipe:
        done = pipe.read()
    status = os.waitpid(child, 0)[1]
    if appends:  # what was there before; of it, one frame and its checkpoint are written again
        new = done.partition("fc")[2]
        done = "fc" * (FRAMES - 1) + (new if new.startswith("fc") else "f")
    return done, os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL


def check_frames(path: Path, finished: int) -> None:
    """Every frame and sample that is there is whole, and those that were finished are there."""
    with xarray.open_dataset(path) as data, netCDF4.Dataset(path) as file:
        data.load()
        there = data.sizes["time"]
        assert finished <= there <= finished + 1
        for name in NAMES:
            expected = np.reshape([frame(k)[name] for k in range(there)], (there, MESH.size))
            np.testing.assert_array_equal(data[name], expected)
            np.testing.assert_array_equal(file[name][:], expected)
        times = [60.0 * k for k in range(there)]
        assert RunFile(path).times.tolist() == file["time"][:].tolist() == times
        taken = [0.5 * k for k in range(data.sizes["diagnostic_time"])]
        assert data["mass"].values.tolist() == [1.0 + k for k in taken]
        assert file["diagnostic_time"][:].tolist() == [60.0 * k for k in taken]


def check_checkpoint(path: Path, finished: int) -> None:
    """What was put down last, or was just about to be, comes back to the last bit."""
    found = read_checkpoint(path)
    assert finished <= found.steps + 1 <= finished + 1
    for name, array in state_dict(found.steps).items():
        assert found.state_dict[name].tobytes() == array.tobytes()


def examine(path: Path, done: str, found: Counter[str], good: set[tuple[bytes, int]]) -> None:
    """Count what a kill has left; files of which all bytes were found good once are so again."""
    frames, checkpoints = done.count("f"), done.count("c")
    found["no_file_yet"] += not path.exists()
    contents = path.read_bytes() if path.exists() else b""
    try:
        if (path.exists() or frames) and (contents, frames) not in good:
            check_frames(path, frames)
            good.add((contents, frames))
    except AssertionError as error:
        found["frames_lost"] += 1
        sys.stderr.write(f"{done}: {error}\n")
    except Exception as error:
        found["unreadable"] += 1
        sys.stderr.write(f"{done}: {error!r}\n")
    try:
        if checkpoints:
            check_checkpoint(path, checkpoints)
    except (ConfigError, AssertionError) as error:
        found["checkpoints_lost"] += 1
        sys.stderr.write(f"{done}: {error}\n")


def main(folder: Path) -> None:
    found: Counter[str] = Counter()
    good: set[tuple[bytes, int]] = set()
    begun, empty = folder / "begun", folder / "empty"
    begun.mkdir()
    empty.mkdir()
    unfinished(begun / "run.nc")
    for half, appends in ((False, False), (True, False), (False, True), (True, True)):
        call, alive = 0, False
        while not alive:
            call += 1 + 2 * (half and appends)
            place = folder / f"{call}{half}{appends}"
            shutil.copytree(begun if appends else empty, place)
            done, was_killed = killed(place / "run.nc", call, half, appends)
            alive = not was_killed
            examine(place / "run.nc", done, found, good)
            found["positions"] += was_killed
            shutil.rmtree(place)
        found["runs_to_the_end"] += done == "fc" * (FRAMES + appends) + "e"
    print(json.dumps({name: found[name] for name in COUNTED}))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
