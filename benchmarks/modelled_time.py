"""How well modelled times repeat, and how well they agree with undisturbed wall times.

    python benchmarks/modelled_time.py [--repeats R] [--runs N]

The first day of scene williamson5, a stepper each, at a step that suits it.  A repeat is what a
small study does: all steppers in turn, several times, and prices from these runs alone.  The
undisturbed wall time is the sum over the steps of the shortest time that each of them took in any
run of any repeat: they do the same each time.
"""

from __future__ import annotations

import time
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.setup import make_mesh, make_model, make_scene
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.modelled_time import Stopwatch, difference, modelled_seconds

MESHES = ((8, 4), (4, 8))
STEPS = {
    "rk4": 2.0, "leapfrog": 0.6, "semi-implicit": 4.0, "ark2": 4.0, "tr-bdf2": 12.0, "bdf2": 8.0,
    "rosenbrock-w": 8.0,
}  # fmt: skip
"""Step of each stepper in units of the gravity limit."""
DAY = 86400.0


class Case:
    """A stepper on a mesh."""

    def __init__(self, name: str, ne: int, np: int) -> None:
        config = make_config({"scene": "williamson5", "ne": ne, "np": np})
        scene = make_scene(config)
        self._model = make_model(config, scene, make_mesh(config, scene))
        self._state = self._model.initial_state()
        limit = 1.0 / self._model.spectrum(self._state).wave
        self.steps = round(DAY / (STEPS[name] * limit))
        self._stepper = get_stepper(name)(self._model, DAY / self.steps)
        self._watch = Stopwatch()
        self.walls: list[np.ndarray] = []
        """Of each run the time of each step [s]."""
        self.modelled: list[float] = []
        """Of each repeat [s]."""
        self._steps()  # compiles and sets up

    def begin(self) -> None:
        """Forget the prices."""
        self._watch = Stopwatch()
        self._model.launch.work.timer = self._watch

    def run(self) -> None:
        """Run, the steps timed one by one."""
        before = self._model.launch.work.counts()
        self._watch.begin()
        self.walls.append(self._steps())
        self._counts = difference(self._model.launch.work.counts(), before)

    def end(self) -> None:
        """Keep the modelled time."""
        self.modelled.append(modelled_seconds(self._counts, self._watch.prices()))

    def _steps(self) -> np.ndarray:
        self._stepper.start(self._state)
        ends = [time.perf_counter()]
        for _ in range(self.steps):
            self._stepper.step()
            ends.append(time.perf_counter())
        return np.diff(ends)


def main(
    repeats: Annotated[int, typer.Option(help="Studies that are made.")] = 5,
    runs: Annotated[int, typer.Option(help="Runs of each stepper in each.")] = 8,
) -> None:
    """Print a table in Markdown."""
    console = Console(width=200, highlight=False, markup=False)
    console.print(
        "| mesh | stepper | wall, shortest to longest | undisturbed | modelled | wall repeats to |"
        " modelled repeats to | modelled / undisturbed |"
    )
    console.print("|---|---|---|---|---|---|---|---|")
    for ne, points in MESHES:
        cases = {name: Case(name, ne, points) for name in STEPS}
        for _ in range(repeats):
            _study(list(cases.values()), runs)
        for name, case in cases.items():
            console.print(f"| ne{ne} np{points} | {name} | {_line(case)} |")


def _study(cases: list[Case], runs: int) -> None:
    for case in cases:
        case.begin()
    for _ in range(runs):
        for case in cases:
            case.run()
    for case in cases:
        case.end()


def _line(case: Case) -> str:
    walls = [steps.sum() for steps in case.walls]
    least = np.min(case.walls, axis=0).sum()
    modelled = float(np.median(case.modelled))
    return (
        f"{min(walls):.3g} to {max(walls):.3g} s | {least:.3g} s | {modelled:.3g} s | "
        f"{_spread(walls):.0f} % | {_spread(case.modelled):.1f} % | {modelled / least:.2f}"
    )


def _spread(values: list[float]) -> float:
    """Largest less smallest over the median [%]."""
    return 100.0 * float(np.ptp(values) / np.median(values))


if __name__ == "__main__":
    typer.run(main)
