"""Disks that fail at each write in turn: the messages of the program, and the files that it leaves.

    python benchmarks/attack_disk.py [--part 1/4] [--only NAME] [--errors EIO,ENOSPC,EDQUOT]

Each command runs repeatedly in a forked process whose n-th call that writes, truncates, syncs or
renames a file in its folder fails.  With EIO only this call fails; with ENOSPC and EDQUOT all later
calls fail too.  Part i of n tests every n-th call, beginning with the i-th.  A case fails if it
ends with a traceback, an unexpected error, more or less than one line, or status 0 without its
result, or if a file that existed before cannot be read afterwards.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

import swe_sphere.cli.main as program
from swe_sphere.io.runfile import RunFile
from swe_sphere.pictures import plot

SHIM = Path(__file__).parents[1] / "tests" / "kills.c"
ERRORS = {"EIO": (errno.EIO, 0), "ENOSPC": (errno.ENOSPC, 1), "EDQUOT": (errno.EDQUOT, 1)}
"""Errors, and whether all later calls fail as well."""
SMALL = "--ne=2 --np=4 --dt=1800 --days=0.125 --every=0.5 --quiet"
SHORT = SMALL.replace("0.125", "0.0625")
COMMANDS = {
    "run": (f"run williamson2 {SMALL} --out=new.nc", "new.nc"),
    "run to Zarr": (f"run williamson2 {SHORT} --out=new.zarr", "new.zarr"),
    "restart": ("run williamson2 --restart=old.nc --out=old.nc --days=0.25 --quiet", "old.nc"),
    "picture": ("plot old.nc --out=new.png", "new.png"),
    "regrid": ("regrid old.nc --grid=latlon:7x12 --out=grid.nc", "grid.nc"),
    "sweep": (
        "sweep williamson2 --steppers=rk4 --dt=900 --ne=2 --np=4 --days=0.0625 --repeats=1 --quiet"
        " --out=s",
        "s/index.html",
    ),
}  # fmt: skip
"""Commands, and the file that each leaves."""


def run(words: list[str]) -> int:
    """Run the program; return its exit status."""
    try:
        program.main(words)
    except SystemExit as end:
        return int(end.code or 0)
    return 1


def forked(folder: Path, words: list[str], call: int, kind: str) -> tuple[int, str, int]:
    """Return status, messages and number of calls of a command whose call `call` fails."""
    shim, (error, on) = ctypes.CDLL(None), ERRORS[kind]
    reading, notes = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(notes, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.chdir(folder)
        shim.fail_at(os.fsencode(folder), ctypes.c_long(call), error, on)
        try:
            status = run(words)
        except BaseException as escaped:
            os.write(2, f"Traceback: {escaped!r}\n".encode())
            status = 1
        os.write(2, f"calls {shim.calls()}".encode())
        os._exit(status)
    os.close(notes)
    with os.fdopen(reading, errors="replace") as pipe:
        told, _, calls = pipe.read().rpartition("calls ")
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return status, told, int(calls or 0)


def fault(folder: Path, name: str, status: int, told: str) -> str:
    """Return what is wrong with the way a command ended; empty if nothing is."""
    lines = [line for line in told.splitlines() if "warning:" not in line]
    if status not in (0, 1, 2) or "Traceback" in told or "unexpected" in told:
        return f"status {status}: {told.strip()[:400]}"
    if status and [line.startswith("swe-sphere: ") for line in lines] != [True]:
        return f"{len(lines)} lines: {told.strip()[:400]}"
    if not status and not (folder / COMMANDS[name][1]).exists():
        return "status 0 without a result"
    before = RunFile(folder / "old.nc")
    if not np.isfinite(before.frame(0.0)["h"]).all() or before.times.size < 3:
        return "an old file has lost its frames"
    return ""


def fresh(sound: Path, work: Path) -> Path:
    """Return the new folder of a case, with a copy of the valid files."""
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(sound, work)
    return work


def main() -> int:
    """Print a table of the cases by command, and each that fails."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--part", default="1/1")
    parser.add_argument("--only", default="")
    parser.add_argument("--errors", default=",".join(ERRORS))
    asked = parser.parse_args()
    part, parts = map(int, asked.part.split("/"))
    if "kills" not in os.environ.get("LD_PRELOAD", ""):
        with tempfile.TemporaryDirectory() as name:
            library = Path(name) / "kills.so"
            compiler = ["cc", "-shared", "-fPIC", "-O1", "-o", library, SHIM, "-ldl"]
            subprocess.run(compiler, check=True)
            environment = os.environ | {"LD_PRELOAD": str(library)}
            return subprocess.run(
                [sys.executable, *sys.argv], env=environment, check=False
            ).returncode
    warnings.simplefilter("ignore")
    plot.ROWS, plot.DOTS_PER_INCH = 19, 30
    tried: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(dir="/dev/shm") as name:
        home = Path(name)
        sound, work = home / "sound", home / "work"
        sound.mkdir()
        os.chdir(sound)
        for words in (f"run williamson2 {SMALL} --out=old.nc", *(c for c, _ in COMMANDS.values())):
            run(words.split())  # loads all that the forked processes need
        for path in sound.iterdir():
            if not path.name.startswith("old.nc"):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        run(f"run williamson2 {SMALL} --out=old.nc --overwrite".split())
        for command, (words, _) in COMMANDS.items():
            for kind in asked.errors.split(",") if asked.only in command else ():
                calls = forked(fresh(sound, work), words.split(), 10**6, kind)[2]
                for call in range(part, calls + 1, parts):
                    status, told, _ = forked(fresh(sound, work), words.split(), call, kind)
                    wrong = fault(work, command, status, told)
                    tried[command] += 1
                    if wrong:
                        failed[command] += 1
                        sys.stdout.write(f"{command}, {kind} at call {call}: {wrong}\n")
                        sys.stdout.flush()
                sys.stdout.write(f"| {command}, {kind} | {calls} calls | part {asked.part} |\n")
                sys.stdout.flush()
    for command, count in tried.items():
        sys.stdout.write(f"| {command} | {count} | {failed[command]} |\n")
    return min(failed.total(), 100)


if __name__ == "__main__":
    sys.exit(main())
