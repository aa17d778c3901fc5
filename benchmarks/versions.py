"""Time of right-hand sides and steps, now and at an earlier commit, measured in turns.

    python benchmarks/versions.py [COMMIT] [--rounds N] [--pairs P] [--only NAMES]

Each version runs in a separate process and takes steps on request, so that both versions see the
same load of the machine.  Times depend on the placement of memory, by 20 % at ne16; therefore each
case is measured in several pairs of new processes.  The script needs the git history.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from sections import Section, load, measure

ROOT = Path(__file__).parents[1]
THEN = "8e73fdc"
"""Commit of 22 November 2026, before the Python API existed."""
LONG = 3600.0
CASES = (
    ("right-hand side", 16, 4, 0.0, 200),
    ("right-hand side", 8, 8, 0.0, 200),
    ("rk4", 16, 4, 240.0, 60),
    ("rk4", 30, 4, 120.0, 20),
    ("rk4", 60, 4, 60.0, 4),
    ("rk4", 120, 4, 30.0, 2),
    ("leapfrog", 16, 4, 120.0, 150),
    ("leapfrog", 60, 4, 30.0, 8),
    ("forward-backward", 16, 4, 120.0, 150),
    ("forward-backward", 60, 4, 60.0, 8),
    ("forward-backward", 120, 4, 30.0, 4),
    ("semi-implicit", 16, 4, 1200.0, 6),
    ("ars343", 16, 4, 1200.0, 4),
    ("semi-implicit", 30, 4, 600.0, 4),
    ("semi-implicit", 60, 4, 400.0, 2),
    ("ark2", 30, 4, 1200.0, 2),
    ("ars343", 30, 4, 1800.0, 1),
    ("bdf2", 16, 4, LONG, 5),
    ("bdf2", 30, 4, LONG, 3),
    ("bdf2", 60, 4, LONG, 1),
    ("tr-bdf2", 16, 4, LONG, 3),
    ("tr-bdf2", 16, 4, 4.0 * LONG, 2),
    ("tr-bdf2", 30, 4, 4.0 * LONG, 1),
    ("tr-bdf2", 60, 4, 4.0 * LONG, 1),
    ("tr-bdf2", 8, 8, LONG, 3),
    ("esdirk4", 16, 4, LONG, 2),
    ("gauss-legendre", 16, 4, LONG, 2),
)
"""Name of the call, ne, np, Δt [s] and the number of calls that are timed together."""
WORKER = """
import json, sys, time
import warp as wp
wp.config.log_level = wp.LOG_WARNING
sys.path.insert(0, sys.argv[1])
import swe_sphere.mesh as meshes
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene
try:
    from swe_sphere.equations.model import Model
except ImportError:  # what it was called then
    from swe_sphere.model import Model
assert meshes.__file__.startswith(sys.argv[1])
build = getattr(meshes, "build_mesh", None) or meshes.Mesh.build

def call_of(what, ne, points, dt):
    model = Model(build(ne, points), get_scene("williamson5"))
    state = model.initial_state()
    if what == "right-hand side":
        out = model.zeros()
        return lambda count: [model.tendency(state, 0.0, out) for _ in range(count)]
    stepper = STEPPERS[what](model, dt)
    stepper.start(state)
    if not hasattr(stepper, "take"):
        return lambda count: [stepper.step() for _ in range(count)]
    def steps(count):
        end = stepper.steps + count
        while stepper.steps < end:
            stepper.take(end - stepper.steps)
    return steps

calls = {}
for line in sys.stdin:
    *case, count = json.loads(line)
    if line not in calls:
        calls[line] = call_of(*case)
        for _ in range(4):
            calls[line](count)
    start = time.process_time()
    calls[line](count)
    print((time.process_time() - start) / count, flush=True)
"""


@contextmanager
def version(commit: str) -> Iterator[subprocess.Popen[str]]:
    """Start a process that runs the sources of a commit on request; it ends with the block."""
    with tempfile.TemporaryDirectory() as folder:
        packed = subprocess.check_output(["git", "archive", commit], cwd=ROOT)
        subprocess.run(["tar", "-x", "-C", folder], input=packed, check=True)
        with subprocess.Popen(
            [sys.executable, "-c", WORKER, folder], cwd=folder, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        ) as process:  # fmt: skip
            yield process


def seconds(process: subprocess.Popen[str], case: tuple[object, ...]) -> float:
    """Return the mean CPU time [s] of a call of one of `CASES`."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(json.dumps(case) + "\n")
    process.stdin.flush()
    return float(process.stdout.readline())


def measured(commit: str, rounds: int, pairs: int, names: list[str]) -> list[list[str]]:
    """Return a row for each of `CASES`; the version that goes first changes with the round."""
    cases = [case for case in CASES if case[0] in names or not names]
    times: dict[tuple[object, ...], list[list[tuple[float, float]]]] = {case: [] for case in cases}
    for case in pairs * cases:
        with version(commit) as old, version("HEAD") as new:
            times[case].append([])
            for process in (old, new):
                seconds(process, case)
            for number in range(rounds):
                order = (old, new) if number % 2 else (new, old)
                found = {process: seconds(process, case) for process in order}
                times[case][-1].append((found[old], found[new]))
    return [_row(case, of) for case, of in times.items()]


def _row(case: tuple[object, ...], pairs: list[list[tuple[float, float]]]) -> list[str]:
    what, ne, points, dt, _ = case
    least = [
        1e3 * min(each) for each in zip(*(time for pair in pairs for time in pair), strict=True)
    ]
    medians = sorted(statistics.median(now / then for then, now in pair) for pair in pairs)
    return [
        f"{what}, Δt {dt:g} s" if dt else str(what), f"ne{ne} np{points}",
        f"{least[0]:.3g}", f"{least[1]:.3g}", f"{least[1] / least[0]:.2f}",
        f"{statistics.median(medians):.2f} ({medians[0]:.2f} to {medians[-1]:.2f})",
    ]  # fmt: skip


def main(
    commit: Annotated[str, typer.Argument(help="The earlier commit.")] = THEN,
    rounds: Annotated[int, typer.Option(help="Number of turns of a pair of processes.")] = 9,
    pairs: Annotated[int, typer.Option(help="Number of pairs of processes.")] = 3,
    only: Annotated[str, typer.Option(help="Names of the calls to measure; empty: all.")] = "",
) -> None:
    """Measure, print and write the page."""

    def section() -> Section:
        return Section(
            f"williamson5, now and at {commit}",
            f"CPU time [ms] of a right-hand side or a step with default settings on one core: the"
            f" least of {pairs} pairs of processes with {rounds} rounds each, their ratio, and"
            " the median ratio of a pair (of the pairs: the middle one, the least, the largest).",
            ["", "mesh", "then", "now", "now / then", "median ratio of a pair"],
            measured(commit, rounds, pairs, only.split(",") if only else []),
        )

    kept = dict.fromkeys((*load("versions"), commit), section)
    measure("versions", kept, [commit])


if __name__ == "__main__":
    typer.run(main)
