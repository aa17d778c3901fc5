"""Cost of a sweep beyond its runs: records, errors, queries of the machine, the dataset.

    python benchmarks/sweep_overhead.py [SCENE] [--ne N] [--np N] [--days D] [--repeats R]

The script measures processor time, which varies less than wall time on a busy machine.  A run
counts from building its model to its last step; compilation is excluded.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from swe_sphere.studies.sweep import SweepWatcher, make_plan
from swe_sphere.studies.sweep.engine import Sweep
from swe_sphere.studies.sweep.record import write_dataset
from swe_sphere.studies.sweep.runner import run_timed, warm_up

STEPPERS = ["leapfrog", "rk4", "semi-implicit", "tr-bdf2"]


class Meter:
    """Sum of the processor time spent in a function."""

    def __init__(self, function: object) -> None:
        self._function, self.seconds = function, 0.0

    def __call__(self, *args: object, **options: object) -> object:
        began = time.process_time()
        try:
            return self._function(*args, **options)
        finally:
            self.seconds += time.process_time() - began


def main(
    scene: Annotated[str, typer.Argument(help="Name of a scene.")] = "lauter",
    ne: Annotated[int, typer.Option(help="Elements along an edge.")] = 8,
    np: Annotated[int, typer.Option(help="Nodes along an edge of an element.")] = 4,
    days: Annotated[float, typer.Option(help="Length of the runs.")] = 5.0,
    repeats: Annotated[int, typer.Option(help="How often each run is made.")] = 3,
) -> None:
    """Run a sweep and print the share of time outside of its runs."""
    import swe_sphere.studies.sweep.runner as runner

    runs, warm = Meter(run_timed), Meter(warm_up)
    runner.run_timed, runner.warm_up = runs, warm
    plan = make_plan({"scene": scene, "steppers": STEPPERS, "ne": ne, "np": np, "days": days,
                      "repeats": repeats, "levels": 4})  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        Sweep(plan, Path(folder), SweepWatcher()).run()
        dataset = write_dataset(Path(folder))
        total = time.process_time() - began
    steps = float(dataset["cpu"].sum())
    rest = total - runs.seconds - warm.seconds
    console = Console()
    console.print(f"{scene} ne{ne} np{np}, {days:g} days, {dataset.sizes['run']} settings")
    console.print(f"steps of the runs      {steps:8.2f} s")
    console.print(f"runs, with their start {runs.seconds:8.2f} s")
    console.print(f"warming up             {warm.seconds:8.2f} s")
    console.print(
        f"the sweep around them  {rest:8.2f} s, {100 * rest / runs.seconds:.1f} % of runs"
    )


if __name__ == "__main__":
    typer.run(main)
