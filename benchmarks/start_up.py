"""Wall time of a short run from the command line to its end.

    python benchmarks/start_up.py [SECTION ...] [--repeats N]    start, again, fine; all by default

Each run of `start` is a separate process; those of `again` follow one another in one process.
Python keeps its byte code, even if PYTHONDONTWRITEBYTECODE is set.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Annotated

import typer
from sections import Section, measure

RUN = ("run", "williamson2", "--ne", "8", "--days", "1", "--quiet")
CASES = {
    "rk4": (4.0,),
    "forward-backward": (4.0,),
    "semi-implicit": (15.0,),
    "bdf2": (15.0,),
    "tr-bdf2": (15.0,),
    "rk4, two ranks": (4.0, "--ranks", "2"),
}
"""Targets with an empty cache [s], and further arguments, by name of the case."""
WARM, COLD = 0.8, 2
"""Target with compiled kernels [s], and number of runs with an empty cache."""
AGAIN = """
import sys, time
from swe_sphere import Simulation
for _ in range(9):
    start = time.perf_counter()
    Simulation("williamson2", ne=8, np=4, stepper=sys.argv[1]).step()
    print(time.perf_counter() - start)
"""

FINE = """
import sys, time
from swe_sphere import Simulation
stepper = sys.argv[1]
dt = "auto" if sys.argv[2] == "auto" else float(sys.argv[2])
for ne in (4, *map(int, sys.argv[3:])):
    start = time.perf_counter()
    sim = Simulation("williamson5", ne=ne, np=4, stepper=stepper, dt=dt)
    times = [start]
    for act in (sim.begin, sim.step, sim.step):
        act()
        times.append(time.perf_counter())
    before, first, second = (b - a for a, b in zip(times, times[1:]))
    print(before, max(0.0, first - second))
"""
"""Seconds before the first step, and how much longer the first step takes than the second."""
MESHES = (30, 60, 120)
"""Elements along the edge of a cube face in `fine`."""

KEPT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
"""Environment of all processes."""


def seconds(arguments: tuple[str, ...], cache: str) -> float:
    """Return the wall time [s] of a run in a new process; cache: folder of kernels."""
    command = [sys.executable, "-m", "swe_sphere", *RUN, *arguments]
    start = time.perf_counter()
    subprocess.run(command, env=KEPT | {"WARP_CACHE_PATH": cache}, check=True)
    return time.perf_counter() - start


def row(name: str, repeats: int) -> list[str]:
    """Return the row of one of `CASES`: with empty caches, then with compiled kernels."""
    aim, *more = CASES[name]
    arguments = ("--stepper", name.split(",")[0], *map(str, more))
    cold: list[float] = []
    warm: list[float] = []
    for _ in range(COLD):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(seconds(arguments, cache))
            warm += [seconds(arguments, cache) for _ in range(repeats)]
    times = f"{min(warm):.2f}", f"{statistics.median(warm):.2f}", f"{min(cold):.2f}"
    return [name, *times, f"{max(cold):.2f}", f"{aim:.0f}"]


def again(name: str) -> list[str]:
    """Return the row of the first simulation of a process and of those after it."""
    command = [sys.executable, "-c", AGAIN, name]
    first, *later = map(float, subprocess.check_output(command, env=KEPT, text=True).split())
    return [name, f"{first:.3f}", f"{min(later):.3f}", f"{statistics.median(later):.3f}"]


def fine(name: str, dt: str) -> list[list[str]]:
    """Return the rows of a stepper on fine meshes: the shorter of two processes."""
    command = [sys.executable, "-c", FINE, name, dt, *map(str, MESHES)]
    outputs = [subprocess.check_output(command, env=KEPT, text=True) for _ in range(2)]
    runs = [[[float(x) for x in line.split()] for line in out.splitlines()] for out in outputs]
    least = [min(run[k] for run in runs) for k in range(1, len(MESHES) + 1)]
    return [
        [name, f"ne{ne} np4", f"{before:.2f}", f"{longer:.2f}"]
        for ne, (before, longer) in zip(MESHES, least, strict=True)
    ]


def main(
    sections: Annotated[list[str] | None, typer.Argument(help="Sections; default: all.")] = None,
    repeats: Annotated[int, typer.Option(help="Runs on each cache of compiled kernels.")] = 6,
) -> None:
    """Measure, print and write the page."""

    def start() -> Section:
        return Section(
            "A short run, from the command line to its end",
            f"Wall time [s] of a process: the least and the median of {COLD * repeats} runs with"
            f" compiled kernels, and the smaller and the larger of {COLD} with an empty cache of"
            f" kernels. The target is {WARM} s for rk4 with compiled kernels; the last column shows"
            " the targets without compiled kernels.",
            ["stepper", "warm, least", "median", "cold, smaller", "larger", "target, cold"],
            [row(name, repeats) for name in CASES],
        )

    def next_ones() -> Section:
        return Section(
            "One simulation after the other in a process",
            "Time [s] to build a simulation of williamson2, ne 8, np 4, and to take its first "
            "step, with compiled kernels, as in a notebook or a sweep. The first simulation of "
            "a process builds and loads its kernels and imports modules; of the eight that "
            "follow, the least and the median are shown.",
            ["stepper", "first", "later, least", "median"],
            [again(name) for name in CASES if "," not in name],
        )

    def fine_meshes() -> Section:
        return Section(
            "Set-up on fine meshes",
            "Wall time [s] on williamson5, with compiled kernels, the shorter of two processes:"
            " before the first step (mesh, operators and, for explicit steppers, the stability"
            " limit), and by how much the first step takes longer than the second (preconditioner"
            " of implicit steppers).",
            ["stepper", "mesh", "before the first step", "in the first step"],
            [*fine("rk4", "auto"), *fine("semi-implicit", "auto"), *fine("bdf2", "3600")],
        )

    measured = {"start": start, "again": next_ones, "fine": fine_meshes}
    measure("start_up", measured, sections or [])


if __name__ == "__main__":
    typer.run(main)
