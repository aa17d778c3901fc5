"""What it costs that a sweep's stopwatch sees every launch, where runs record what repeats.

python benchmarks/launches.py      CPU time of a step with all seen over that of recorded steps
"""

from __future__ import annotations

import time
from itertools import product

import warp as wp
from rich.console import Console
from rich.table import Table

from swe_sphere.equations import Model
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import get_stepper
from swe_sphere.steppers.stepper import Stepper
from swe_sphere.studies.modelled_time import Stopwatch
from swe_sphere.testcases import get_scene

STEPS = {"rk4": 400.0, "forward-backward": 200.0, "semi-implicit": 600.0, "tr-bdf2": 7200.0}
"""Stable at all meshes [s]."""
MESHES = (4, 4), (8, 4), (16, 4), (8, 8)
TURNS, SECONDS = 7, 0.2
"""Turns of each way, and the length of one [s]."""


def main() -> None:
    """Measure and print."""
    wp.config.log_level = wp.LOG_WARNING
    table = Table("stepper", *(f"ne{ne} np{np_}" for ne, np_ in MESHES))
    ratios = {case: f"{_ratio(*case):.2f}" for case in product(STEPS, MESHES)}
    for name in STEPS:
        table.add_row(name, *(ratios[name, mesh] for mesh in MESHES))
    Console().print(table)


def _ratio(name: str, mesh: tuple[int, int]) -> float:
    """Of the least times of a step, in turns."""
    dt = STEPS[name] * min(1.0, 32.0 / (mesh[0] * (mesh[1] - 1)))
    seen, recorded = (_stepper(name, mesh, dt) for _ in range(2))
    seen.model.launch.work.timer = Stopwatch()
    times = [(_seconds(seen), _seconds(recorded)) for _ in range(TURNS)]
    return min(t for t, _ in times) / min(t for _, t in times)


def _stepper(name: str, mesh: tuple[int, int], dt: float) -> Stepper:
    model = Model(Mesh.build(*mesh), get_scene("williamson5"))
    stepper = get_stepper(name)(model, dt)
    stepper.start(model.initial_state())
    for _ in range(4):
        stepper.step()
    return stepper


def _seconds(stepper: Stepper) -> float:
    """CPU time of a step [s]."""
    began, steps = time.process_time(), 0
    while time.process_time() - began < SECONDS:
        stepper.step()
        steps += 1
    return (time.process_time() - began) / steps


if __name__ == "__main__":
    main()
