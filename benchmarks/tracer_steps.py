"""Cost and errors of tracers with separate time steps.

Runs with one tracer step per flow step and with automatic tracer steps alternate, so that other
load on the machine affects both.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import typer
from sections import Section, command

from swe_sphere import Simulation
from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.scene import Scene
from swe_sphere.testcases import get_scene

COUNT = 8
"""Number of tracers of every scene: those of the deformational flow, twice."""
NE = 12


@dataclass
class Case:
    """A scene with a stepper, and its runs by the number of tracer steps."""

    scene: str
    stepper: str
    days: float
    limiter: bool
    steps: tuple[int | str, ...] = (1, "auto")
    seconds: dict[int | str, list[float]] = field(default_factory=dict)
    last: dict[int | str, Simulation] = field(default_factory=dict)

    def run(self, steps: int | str) -> None:
        """Run the case once more; steps: tracer steps per flow step, or "auto"."""
        sim = Simulation(
            eight(self.scene, self.limiter), ne=NE, np=4, stepper=self.stepper, days=self.days,
            tracer_steps=steps,
        )  # fmt: skip
        summary = sim.run(progress=False)
        if summary.status != "completed":
            raise SystemExit(f"{self.scene} {self.stepper} {steps}: {summary.reason}")
        self.seconds.setdefault(steps, []).append(sim.cpu_seconds)
        self.last[steps] = sim

    def row(self, steps: int | str) -> list[str]:
        """Return the cells of a row."""
        sim, times, single = self.last[steps], self.seconds[steps], self.seconds[1]
        ratio = statistics.median(a / b for a, b in zip(times, single, strict=True))
        name = self.scene + (", limiter" if self.limiter else "")
        return [
            name, self.stepper, f"{sim.plan.dt:.0f}", str(sim.plan.cycle), f"{min(times):.2f}",
            f"{statistics.median(times):.2f}", "" if steps == 1 else f"{ratio:.2f}",
            *self.errors(steps),
        ]  # fmt: skip

    def errors(self, steps: int | str) -> list[str]:
        """Return l2 errors of hills, bells and cylinders, or their change from one tracer step."""
        sim, single = self.last[steps], self.last[1]
        now, then = sim.snapshot.fields, single.snapshot.fields
        right = single.initial_fields if self.scene == "deformational" else then
        if right is then and steps == 1:
            return ["", "", ""]
        area, names = sim.mesh.area, ("gaussian_hills", "cosine_bells", "slotted_cylinders")
        return [f"{_l2(area, now[f'q_{name}'], right[f'q_{name}']):.2e}" for name in names]


def eight(which: str | Scene, limiter: bool) -> Scene:
    """Return the scene with eight tracers."""
    four = get_scene("deformational").tracers or {}
    tracers = {f"{tracer}{i}": formula for i in ("", "_2") for tracer, formula in four.items()}
    scene = get_scene(which) if isinstance(which, str) else which
    effects = tuple(effect for effect in scene.effects if effect.name != "tracers")
    return replace(
        scene, tracers=tracers, exact_tracers=None, effects=(*effects, Tracers(limiter=limiter))
    )


def _l2(area: Any, now: Any, right: Any) -> float:
    return float(np.sqrt(area @ (now - right) ** 2 / (area @ right**2)))


ROUNDS = 3
"""Number of repetitions of each run."""


def tracers() -> Section:
    """Cost and errors of separate time steps of tracers; all cases run in turns."""
    cases = [
        Case("deformational", "rk4", 12.0, limiter=False),
        Case("deformational", "rk4", 12.0, limiter=True),
        Case("williamson5", "rk4", 2.0, limiter=False),
        Case("williamson5", "rk4", 2.0, limiter=True),
        Case("williamson5", "leapfrog", 2.0, limiter=True),
        Case("galewsky", "rk4", 2.0, limiter=True),
        Case("williamson5", "semi-implicit", 2.0, limiter=True),
    ]
    for _ in range(ROUNDS):
        for case in cases:
            for steps in case.steps:
                case.run(steps)
    return Section(
        "Separate time steps for eight tracers",
        f"ne{NE} np4, automatic flow steps. *at once*: flow steps for each tracer step. *ratio*:"
        f" median over {ROUNDS} rounds of the CPU time relative to one tracer step for each flow"
        " step. *hills*, *bells*, *cylinders*: l2 errors of three of the tracers: for"
        " deformational flow after 12 days relative to the initial state, for other scenes after 2"
        " days the difference from one tracer step for each flow step.",
        ["scene", "stepper", "dt [s]", "at once", "least [s]", "median [s]", "ratio", "hills",
         "bells", "cylinders"],
        [case.row(steps) for case in cases for steps in case.steps],
    )  # fmt: skip


main = command("tracer_steps", {"tracers": tracers})

if __name__ == "__main__":
    typer.run(main)
