"""Ensembles, sweeps, regriddings and films killed at random times: their files and resumption.

    python benchmarks/kill_studies.py [--kills 40] [--seed 1] [--only ensemble,sweep,regrid,animate]

Kills each command (SIGKILL), with all processes that it started, at a random time, and reads every
file that exists then.  The command is then started again and runs to its end.  Its results must be
those of an undisturbed command: members, fields and pictures to the last bit, and rows of a sweep
except for measured times.  No temporary files may remain.  The commands are forked from a process
that has loaded all modules and kernels, which saves seconds for each of them.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import redirect_stdout, suppress
from pathlib import Path

import typer
import xarray as xr
from PIL import Image

import swe_sphere.cli.main as program
from swe_sphere.io.checkpoint import read_checkpoint
from swe_sphere.io.runfile import RunFile
from swe_sphere.pictures import plot

RUN = "--ne=2 --np=4 --dt=1800"
COMMANDS = {
    "ensemble": f"ensemble galewsky --seeds=1,2,3 --days=0.25 --every=1 {RUN} --out=e",
    "sweep": "sweep williamson2 --steppers=rk4,leapfrog --dt=900,450 --ne=2 --np=4 --days=0.25"
    " --repeats=2 --jobs=2 --quiet --out=s",
    "regrid": "regrid old.nc --grid=latlon:31x60 --out=grid.nc --overwrite",
    "animate": "animate old.nc --out=film.gif --overwrite",
}  # fmt: skip
COUNTED = (
    "kills", "files read", "files unreadable", "a result in its place", "resumed", "same result",
    "temporary files left",
)  # fmt: skip
TIMES = ("seconds", "cpu", "wall", "spread")
"""Parts of the names of columns with measured times, which differ between sweeps."""


def tell(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def load(folder: Path, words: str) -> None:
    """Run a command in this process, which loads all modules and kernels for forked processes."""
    os.chdir(folder)
    with suppress(SystemExit), Path(os.devnull).open("w") as silent, redirect_stdout(silent):
        program.main(words.replace("--jobs=2", "--jobs=1").split())
    os.chdir("/")


def started(folder: Path, words: str) -> int:
    """Start a command in a separate process group; return the id of the process."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        os.chdir(folder)
        for stream in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        try:
            program.main(words.split())
        except SystemExit as end:
            os._exit(int(end.code or 0))
        finally:
            os._exit(99)
    return child


def finish(folder: Path, words: str) -> float:
    """Run a command to its end; return how long it took [s]."""
    begin = time.monotonic()
    status = os.waitstatus_to_exitcode(os.waitpid(started(folder, words), 0)[1])
    if status:
        raise SystemExit(f"status {status}: {words}")
    return time.monotonic() - begin


def killed(folder: Path, words: str, delay: float) -> bool:
    """Return whether a command was killed, with its processes, before its end."""
    child = started(folder, words)
    time.sleep(delay)
    os.killpg(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def contents(path: Path) -> object:
    """Return the contents of a file; raise an exception if it is incomplete."""
    if path.name.endswith(".restart"):
        return {name: x.tobytes() for name, x in read_checkpoint(path).state_dict.items()
                if not name.startswith("counter_")}  # fmt: skip
    if path.suffix == ".nc":
        with xr.open_dataset(path, decode_times=False) as data:
            data.load()
            if "time" in data.dims and "run_id" in data.attrs:
                RunFile(path).frame()
        kept = [n for n in data.variables if not any(part in str(n) for part in TIMES)]
        return {n: data[n].values.tolist() if data[n].dtype == object else data[n].values.tobytes()
                for n in kept}  # fmt: skip
    if path.suffix in (".png", ".gif"):
        with Image.open(path) as image:
            for number in range(getattr(image, "n_frames", 1)):
                image.seek(number)
                image.load()
        return path.read_bytes()
    text = path.read_text("utf-8")
    return json.loads(text) if path.suffix == ".json" else text


def is_temporary(path: Path) -> bool:
    """Return whether a file has a temporary name, or is in a folder that has one."""
    return any(".part" in part or ".old" in part for part in path.parts)


def files(folder: Path) -> list[Path]:
    """Return the files in a folder that are not temporary, in order."""
    return sorted(p for p in folder.rglob("*") if p.is_file() and not is_temporary(p))


def results(folder: Path, name: str) -> dict[str, object]:
    """Return the results that must be equal: rows of a sweep, otherwise contents of files."""
    if name == "sweep":  # whose rows are in the order in which two processes finished them
        with xr.open_dataset(folder / "s" / "sweep.nc") as data:
            kept = [n for n in data.data_vars if n != "jobs" and not any(t in n for t in TIMES)]
            return {"rows": sorted(str({n: data[n].values[i].tolist() for n in kept})
                                   for i in range(data.sizes["run"]))}  # fmt: skip
    return {str(p.relative_to(folder)): contents(p) for p in files(folder)}


def main(kills: int = 40, seed: int = 1, only: str = ",".join(COMMANDS)) -> None:
    """Print a table of kills by command, and each kill with a wrong result."""
    chance, failed = random.Random(seed), 0
    plot.ROWS, plot.FILM_DOTS_PER_INCH = 19, 30
    tell(f"| {' | '.join(('command', *COUNTED))} |")
    with tempfile.TemporaryDirectory() as place:
        sound, work = Path(place) / "sound", Path(place) / "work"
        for name in only.split(","):
            words, found = COMMANDS[name], Counter[str]()
            shutil.rmtree(sound, ignore_errors=True)
            sound.mkdir()
            load(sound, f"run galewsky --days=0.25 --every=1 {RUN} --quiet --out=old.nc")
            if name in ("regrid", "animate"):
                load(sound, words.replace("31x60", "7x12"))  # an older result, to be replaced
            else:
                load(sound, words)
                shutil.rmtree(sound)
                sound.mkdir()
            shutil.copytree(sound, whole := Path(place) / f"whole-{name}")
            span = finish(whole, words)
            expected = results(whole, name)
            while found["kills"] < kills:
                shutil.rmtree(work, ignore_errors=True)
                shutil.copytree(sound, work)
                if not killed(work, words, chance.uniform(0.0, span)):
                    continue
                found["kills"] += 1
                for path in files(work):
                    found["files read"] += 1
                    try:
                        contents(path)
                    except Exception as error:
                        found["files unreadable"] += 1
                        tell(f"{name}: {path.relative_to(work)}: {error!r}")
                for old in ("grid.nc", "film.gif"):
                    found["a result in its place"] += (work / old).exists()
                finish(work, words)
                found["resumed"] += 1
                now = results(work, name)
                found["same result"] += now == expected
                if now != expected:
                    others = [k for k in {*now, *expected} if now.get(k) != expected.get(k)]
                    tell(f"{name}: other results: {others}")
                left = [p for p in work.rglob("*") if is_temporary(p.relative_to(work))]
                found["temporary files left"] += len(left)
            failed += found["kills"] - found["same result"] + found["files unreadable"]
            tell(f"| {name} | {' | '.join(str(found[what]) for what in COUNTED)} |")
    raise typer.Exit(min(failed, 100))


if __name__ == "__main__":
    typer.run(main)
