"""How well modelled times repeat, and how well they agree with undisturbed wall times.

    python benchmarks/modelled_time.py [--repeats R] [--runs N]

The first steps of scene williamson5, a stepper each, of a length that suits it.  A repeat is what a
small study does: all steppers in turn, several times, and prices from these runs alone.  Beside
each of them there is a run without a stopwatch, whose wall time is taken.  The undisturbed time is
the sum over the steps of the shortest processor time that each of them took in any of these: they
do the same each time.
"""

from __future__ import annotations

import time
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from swe_sphere.operators.work import difference
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.setup import make_mesh, make_model, make_scene
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.costs import Stopwatch, modelled_seconds

MESHES = ((8, 4), (4, 8))
STEPS = {
    "rk4": 2.0, "leapfrog": 0.6, "semi-implicit": 4.0, "ark2": 4.0, "tr-bdf2": 12.0, "bdf2": 8.0,
    "rosenbrock-w": 8.0,
}  # fmt: skip
"""Step of each stepper in units of the gravity limit."""
COUNT = 8
"""Steps of a run: few, so that each of them is made often."""


class Case:
    """A stepper on a mesh."""

    def __init__(self, name: str, ne: int, np: int) -> None:
        config = make_config({"scene": "williamson5", "ne": ne, "np": np})
        scene = make_scene(config)
        self._model = make_model(config, scene, make_mesh(config, scene))
        self._state = self._model.initial_state()
        limit = 1.0 / self._model.spectrum(self._state).wave
        self._stepper = get_stepper(name)(self._model, STEPS[name] * limit)
        self._watch = Stopwatch()
        self.walls: list[float] = []
        """Of each run [s]."""
        self.processor: list[np.ndarray] = []
        """Of each run the processor time of each step [s]."""
        self.modelled: list[float] = []
        """Of each repeat [s]."""
        for _ in range(2):  # compiles, sets up, and records what repeats
            self._begin()
            self._steps()

    def begin(self) -> None:
        """Forget the prices."""
        self._watch = Stopwatch()

    def run(self) -> None:
        """Run twice: on the clock, the steps one by one, and under the stopwatch."""
        work = self._model.launch.work
        self._begin()
        began = time.perf_counter()
        self.processor.append(self._steps())
        self.walls.append(time.perf_counter() - began)
        self._begin()
        before, work.timer = work.counts(), self._watch
        self._watch.begin()
        self._steps()
        work.timer, self._counts = None, difference(work.counts(), before)

    def _begin(self) -> None:
        """With what it needs at hand: another stepper was at work before."""
        self._stepper.start(self._state)
        self._stepper.step()
        self._stepper.start(self._state)

    def end(self) -> None:
        """Keep the modelled time."""
        self.modelled.append(modelled_seconds(self._counts, self._watch.prices()))

    def _steps(self) -> np.ndarray:
        ends = [time.thread_time()]
        for _ in range(COUNT):
            self._stepper.step()
            ends.append(time.thread_time())
        return np.diff(ends)


def main(
    repeats: Annotated[int, typer.Option(help="Studies that are made.")] = 5,
    runs: Annotated[int, typer.Option(help="Runs of each stepper in each.")] = 25,
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
    walls = case.walls
    least = np.min(case.processor, axis=0).sum()
    modelled = float(np.median(case.modelled))
    return (
        f"{_ms(min(walls))} to {_ms(max(walls))} | {_ms(least)} | {_ms(modelled)} | "
        f"{_spread(walls):.0f} % | {_spread(case.modelled):.1f} % | {modelled / least:.2f}"
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def _spread(values: list[float]) -> float:
    """Largest less smallest over the median [%]."""
    return 100.0 * float(np.ptp(values) / np.median(values))


if __name__ == "__main__":
    typer.run(main)
