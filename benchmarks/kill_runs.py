"""Runs killed at random times: the contents of their files, and whether they resume bit for bit.

    python benchmarks/kill_runs.py [--kills 300] [--seed 1] [--folder FOLDER]

Kills `swe-sphere run` (SIGKILL) after a random time while it writes its file, opens the file with
netCDF4 and xarray, and compares every frame with that of an undisturbed run.  It then resumes the
run, whose frames must equal those of the undisturbed run to the last bit.  The runs are forked from
a process that has loaded all modules and kernels, which saves seconds for each run.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import netCDF4
import numpy as np
import xarray
from rich.console import Console
from rich.table import Table

from swe_sphere.cli.main import main as program
from swe_sphere.errors import ConfigError
from swe_sphere.io.checkpoint import checkpoint_path, read_checkpoint
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene

SCENE = {"scene": "williamson2", "ne": 4, "np": 4, "dt": 600.0, "days": 1.0, "every": 1 / 6}
"""Configuration of the runs: a frame after every step, so that writing takes most of the time."""
COUNTED = (
    "kills", "frames written", "files unreadable", "no checkpoint after the first frame",
    "checkpoints lost", "checkpoint one frame behind", "checkpoint further behind", "restarts",
    "restarts bit for bit",
)  # fmt: skip
FIELDS = ("h", "u", "v", "vorticity", "divergence")


def write(out: Path) -> None:
    """Run the program with the options of `SCENE`, and exit the process as the program does."""
    options = [f"--{name}={value}" for name, value in SCENE.items() if name != "scene"]
    program(["run", str(SCENE["scene"]), *options, f"--out={out}", "--quiet"])


def begun(out: Path) -> int:
    """Fork a process that runs the program; return its id once the file exists."""
    child = os.fork()
    if child == 0:
        try:
            write(out)
        finally:
            os._exit(0)
    while not out.exists():
        time.sleep(1e-4)
    return child


def killed(out: Path, delay: float) -> bool:
    """Kill a run `delay` [s] after its file has appeared; return whether it was still running."""
    child = begun(out)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def whole_run(out: Path) -> tuple[xarray.Dataset, float]:
    """Return the results of an undisturbed run, and the time from its file to its end [s]."""
    with suppress(SystemExit):
        write(out)
    remove(out)
    child, start = begun(out), time.perf_counter()
    os.waitpid(child, 0)
    return xarray.load_dataset(out), time.perf_counter() - start


def remove(out: Path) -> None:
    """Delete the files of a run."""
    for path in (out, checkpoint_path(out)):
        path.unlink(missing_ok=True)


def frames(out: Path, whole: xarray.Dataset) -> int:
    """Return the number of frames; ValueError if frames or samples differ from those of `whole`."""
    with xarray.open_dataset(out) as data, netCDF4.Dataset(out) as file:
        data.load()
        there = data.sizes["time"]
        for name in FIELDS:
            expected = whole[name].values[:there]
            if not np.array_equal(data[name].values, expected):
                raise ValueError(f"frames of {name} differ")
            if not np.array_equal(file[name][:], expected):
                raise ValueError(f"frames of {name} differ")
        taken = data.sizes["diagnostic_time"]
        if not np.array_equal(data["energy"].values, whole["energy"].values[:taken]):
            raise ValueError("samples differ")
    return there


def goes_on(out: Path, whole: xarray.Dataset) -> bool:
    """Resume a run in its file; return whether all frames equal those of `whole` bit for bit."""
    run_scene(make_config({"scene": SCENE["scene"], "restart": out, "out": out}))
    with xarray.open_dataset(out) as data:
        return all(data[name].values.tobytes() == whole[name].values.tobytes() for name in FIELDS)


def examine(out: Path, whole: xarray.Dataset, found: Counter[str]) -> None:
    """Count the state of the files after a kill in `found`."""
    try:
        there = frames(out, whole)
    except Exception as error:
        found["files unreadable"] += 1
        sys.stderr.write(f"{error!r}\n")
        return
    found["frames written"] += there
    try:
        behind = there - 1 - read_checkpoint(out).steps
    except ConfigError:  # killed between the first frame and the first checkpoint
        found["no checkpoint after the first frame" if there == 1 else "checkpoints lost"] += 1
        return
    found["checkpoint one frame behind"] += behind == 1
    found["checkpoint further behind"] += behind not in (0, 1)
    if there < whole.sizes["time"]:
        found["restarts"] += 1
        found["restarts bit for bit"] += goes_on(out, whole)


def main() -> None:
    """Kill runs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="where the files are written for a while")
    asked = parser.parse_args()
    chance, found = random.Random(asked.seed), Counter[str]()
    with tempfile.TemporaryDirectory(dir=asked.folder) as name:
        folder = Path(name)
        whole, span = whole_run(folder / "whole.nc")
        out = folder / "run.nc"
        while found["kills"] < asked.kills:
            remove(out)
            if killed(out, chance.uniform(0.0, span)):
                found["kills"] += 1
                examine(out, whole, found)
    table = Table(show_header=False, title="runs killed at random moments")
    for what in COUNTED:
        table.add_row(what, str(found[what]))
    Console().print(table)


if __name__ == "__main__":
    main()
