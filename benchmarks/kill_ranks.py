"""Ranks killed at random times: end of the job, contents of its file, and whether it resumes.

    python benchmarks/kill_ranks.py [--kills 10] [--seed 1] [--ranks 4] [--rest 3] [--write FILE.md]

Kills (SIGKILL) one rank of `swe-sphere run --ranks 4` a random time after its file has appeared,
opens its file, and resumes the run in this file on three ranks: all frames must equal those of an
undisturbed run to the last bit.  Only on Linux: ranks are found in /proc.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
import xarray
from kill_runs import frames
from sections import machine

STEPPERS = {"rk4": 900, "semi-implicit": 1800}
"""Steppers, which are used in turns, with their time steps [s]."""
RUN = ["run", "williamson5", "--ne=2", "--np=4", "--days=1", "--every=1", "--quiet"]
MARK = "SWE_SPHERE_KILL_RANKS"
"""Environment variable that identifies the processes of a job."""
HEADS = ["kill", "stepper", "rank", "after [s]", "job ended in [s]", "status", "lines on stderr",
         "intact frames left", "resumes"]  # fmt: skip


def started(token: str, *arguments: str) -> subprocess.Popen[str]:
    """Start a job whose processes have `MARK`=token in their environment."""
    command = [sys.executable, "-m", "swe_sphere", *RUN, *arguments]
    environment = os.environ | {MARK: token}
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)


def alive(token: str, *also: str) -> Iterator[int]:
    """Yield the ids of the processes of a job whose environment also contains these settings."""
    wanted = {f"{MARK}={token}", *also}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            settings = (entry / "environ").read_bytes().decode(errors="replace").split("\0")
        except OSError:  # has ended, or is not ours
            continue
        if wanted <= set(settings):
            yield int(entry.name)


def whole_run(out: Path, ranks: int, *arguments: str) -> tuple[xarray.Dataset, float]:
    """Return the results of an undisturbed run, and the time from its file to its end [s]."""
    job = started("whole", *arguments, f"--out={out}", f"--ranks={ranks}")
    begin = appeared(out)
    if job.wait():
        raise SystemExit(f"the undisturbed run fails: {job.communicate()[1]}")
    return xarray.load_dataset(out), time.monotonic() - begin


def appeared(out: Path) -> float:
    """Wait until the file exists; return the monotonic time [s]."""
    while not out.exists():
        time.sleep(1e-3)
    return time.monotonic()


def killed(out: Path, ranks: int, rank: int, delay: float, *arguments: str) -> list[str]:
    """Kill a rank `delay` [s] after the file has appeared; return cells on how the job ended."""
    token = uuid.uuid4().hex
    job = started(token, *arguments, f"--out={out}", f"--ranks={ranks}")
    appeared(out)
    time.sleep(delay)
    for pid in alive(token, f"PMI_RANK={rank}"):
        os.kill(pid, signal.SIGKILL)
    begin = time.monotonic()
    told = job.communicate()[1]
    seconds = time.monotonic() - begin
    left = len([*alive(token)])
    lines = f"{told.count(chr(10))}" + (f", {left} processes left" if left else "")
    return [f"{delay:.2f}", f"{seconds:.2f}", str(job.returncode), lines]


def goes_on(out: Path, whole: xarray.Dataset, ranks: int, *arguments: str) -> str:
    """Resume the run on `ranks` ranks; return as text whether all frames equal those of `whole`."""
    job = started("rest", *arguments, f"--restart={out}", f"--out={out}", f"--ranks={ranks}")
    told = job.communicate()[1]
    if job.returncode:
        return f"no: {told.strip()}"
    complete = frames(out, whole) == whole.sizes["time"]
    return f"on {ranks} ranks, the same bits" if complete else "too few frames"


def main(
    kills: int = 10,
    seed: int = 1,
    ranks: int = 4,
    rest: int = 3,
    write: Annotated[Path | None, typer.Option(help="For the table.")] = None,
) -> None:
    """Kill ranks and print the table."""
    chance, rows = random.Random(seed), [HEADS, ["---"] * len(HEADS)]
    with tempfile.TemporaryDirectory() as name:
        out, wholes = Path(name) / "run.nc", {}
        for stepper, dt in STEPPERS.items():
            given = [f"--stepper={stepper}", f"--dt={dt}"]
            wholes[stepper] = given, *whole_run(Path(name) / f"{stepper}.nc", ranks, *given)
        while len(rows) < kills + 2:
            number = len(rows) - 1
            stepper = [*STEPPERS][number % len(STEPPERS)]
            given, whole, span = wholes[stepper]
            for path in out.parent.glob("run.*"):
                path.unlink()
            rank, delay = chance.randrange(ranks), chance.uniform(0.0, span)
            ended, left = killed(out, ranks, rank, delay, *given), frames(out, whole)
            if left < whole.sizes["time"]:  # else it had nothing more to do
                kept = f"{left} of {whole.sizes['time']}"
                rest_of = goes_on(out, whole, rest, *given)
                rows.append([str(number), stepper, str(rank), *ended, kept, rest_of])
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    sys.stdout.write(f"{machine()}\n\n{table}\n")
    if write is not None:
        write.write_text(table + "\n")


if __name__ == "__main__":
    typer.run(main)
