"""What tracers on steps of their own cost, and what that does to their errors.

    python benchmarks/tracer_steps.py [--rounds 3] [--write docs/results/tracer_steps.md]

Runs with one tracer step a step of the flow and with automatic ones go in turns, so that a busy
moment of the machine meets both; told are the least and the median CPU time of the steps.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import warp as wp
from rich.console import Console

from swe_sphere import Simulation
from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.scene import Scene
from swe_sphere.files.fingerprints import machine
from swe_sphere.testcases import get_scene

SCREEN = Console(width=140, highlight=False)
COUNT = 8
"""Tracers of every scene: those of deformational flow, twice."""
NE = 12


@dataclass
class Case:
    """A scene with a stepper, and its runs with each number of tracer steps."""

    scene: str
    stepper: str
    days: float
    limiter: bool
    steps: tuple[int | str, ...] = (1, "auto")
    seconds: dict[int | str, list[float]] = field(default_factory=dict)
    last: dict[int | str, Simulation] = field(default_factory=dict)

    def run(self, steps: int | str) -> None:
        """Run it once more."""
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
        """Cells of a table."""
        sim, times, single = self.last[steps], self.seconds[steps], self.seconds[1]
        ratio = statistics.median(a / b for a, b in zip(times, single, strict=True))
        name = self.scene + (", limiter" if self.limiter else "")
        return [
            name, self.stepper, f"{sim.plan.dt:.0f}", str(sim.plan.cycle), f"{min(times):.2f}",
            f"{statistics.median(times):.2f}", "" if steps == 1 else f"{ratio:.2f}",
            *self.errors(steps),
        ]  # fmt: skip

    def errors(self, steps: int | str) -> list[str]:
        """The l2 error of hills, bells and cylinders, or their change against short steps."""
        sim, single = self.last[steps], self.last[1]
        now, then = sim.snapshot.fields, single.snapshot.fields
        right = single.start if self.scene == "deformational" else then
        if right is then and steps == 1:
            return ["", "", ""]
        area, names = sim.mesh.area, ("gaussian_hills", "cosine_bells", "slotted_cylinders")
        return [f"{_l2(area, now[f'q_{name}'], right[f'q_{name}']):.2e}" for name in names]


def eight(which: str | Scene, limiter: bool) -> Scene:
    """The scene with eight tracers."""
    four = get_scene("deformational").tracers or {}
    tracers = {f"{tracer}{i}": formula for i in ("", "_2") for tracer, formula in four.items()}
    scene = get_scene(which) if isinstance(which, str) else which
    effects = tuple(effect for effect in scene.effects if effect.name != "tracers")
    return replace(
        scene, tracers=tracers, exact_tracers=None, effects=(*effects, Tracers(limiter=limiter))
    )


def _l2(area: Any, now: Any, right: Any) -> float:
    return float(np.sqrt(area @ (now - right) ** 2 / (area @ right**2)))


HEAD = """# Separate time steps for tracers

`--tracer-steps auto` takes one tracer step for several steps of the flow. The wind limits the steps
of tracers, while gravity waves limit those of the flow. Tracers are transported with the
time-averaged mass flux, as in CAM-SE. `--tracer-steps 3` takes one tracer step for three flow
steps. A run prints and writes states after whole tracer steps.

    swe-sphere run deformational --ne 6 --days 1 --tracer-steps auto

* **Mass flux.** The stepper integrates two more fields G with dG/dt = hV beside wind and depth. A
  scheme that is linear in states and tendencies treats them as it treats the depth, so that h + div
  G stays constant to round-off. A constant mixing ratio therefore stays constant and every tracer
  conserves its mass to round-off, with explicit and semi-implicit steppers, with the filter of
  leapfrog, and with a limiter once a tracer step. The residual of a semi-implicit solve, and
  diffusion, change the depth by other means than fluxes; tracers follow that change, and their
  masses are restored.
* **Custom steppers** can use the option if they combine tendencies linearly. A stepper that keeps
  earlier states must name them in `levels`, otherwise the option is refused. Implicit and
  exponential steppers solve for tracers together with the flow and refuse the option.
* **Prescribed wind.** There are no flow steps. Depth and tracers take the long step together, in
  two halves with the wind at the middle of each; tracers are stepped as the depth is, so that a
  constant mixing ratio stays constant.
* **Stages.** A tracer step needs few stages, since transport has no fast waves: 4 to 10 stages, of
  fourth order for a steady flux, reach 2.8 to 7.9 over the spectral radius
  (`benchmarks/tracer_stages.py`). At the initial state a tracer step has at most two such parts,
  which limits `--tracer-steps`; if the wind becomes stronger it has more. With a fixed flux the
  step is of second order (`tests/test_tracer_steps.py`). An automatic tracer step is at most three
  hours, except under a prescribed wind.
* **Sources of depth** (forcing, relaxation) add no tracer and cannot be distinguished from fluxes:
  the option is refused.

## Measured

Eight tracers at ne{ne} np4, automatic flow steps. The ratio is the median over {rounds} rounds of
the CPU time relative to one tracer step for each flow step. Errors are l2 norms after the run: for
deformational flow relative to the initial state, for other scenes the difference from one tracer
step for each flow step.

| scene | stepper | dt [s] | at once | least [s] | median [s] | ratio | hills | bells | cylinders |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
{rows}

Measured {machine}, with other programs running.
"""


def main(
    rounds: Annotated[int, typer.Option(help="Times that each run is made.")] = 3,
    write: Annotated[Path | None, typer.Option(help="Write the page here.")] = None,
) -> None:
    """Run all in turns and write the page."""
    wp.config.log_level = wp.LOG_WARNING
    cases = [
        Case("deformational", "rk4", 12.0, limiter=False),
        Case("deformational", "rk4", 12.0, limiter=True),
        Case("williamson5", "rk4", 2.0, limiter=False),
        Case("williamson5", "rk4", 2.0, limiter=True),
        Case("williamson5", "leapfrog", 2.0, limiter=True),
        Case("galewsky", "rk4", 2.0, limiter=True),
        Case("williamson5", "semi-implicit", 2.0, limiter=True),
    ]
    for _ in range(rounds):
        for case in cases:
            for steps in case.steps:
                case.run(steps)
    table = [case.row(steps) for case in cases for steps in case.steps]
    rows = "\n".join("| " + " | ".join(row) + " |" for row in table)
    SCREEN.print(rows)
    if write is not None:
        write.write_text(HEAD.format(ne=NE, rounds=rounds, rows=rows, machine=machine()))


if __name__ == "__main__":
    typer.run(main)
