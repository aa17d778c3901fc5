"""Cost of hyperviscosity: steps, CPU time and errors of steppers that apply it apart or as a whole.

python benchmarks/diffusion.py --write docs/explanation/time_integration.md
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import warp as wp
from rich.console import Console
from rich.table import Table
from sections import stamp, stamp_text

from swe_sphere.equations.effects import Hyperviscosity
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.io.integrals import by_name, field_errors
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.testcases import get_scene

HEAD = (
    "scene", "stepper", "Δt without [s]", "Δt, at the stages", "Δt, apart", "evaluations a step",
    "CPU a step", "l2(h), a day", "l2(v), a day",
)  # fmt: skip
IMPLICIT_HEAD = (
    "Δt [s]", "Krylov a step: without", "whole", "apart", "CPU a step: whole", "apart",
    "l2(h): whole", "apart", "l2(v): whole", "apart",
)  # fmt: skip
IMPLICIT, STEPS = "tr-bdf2", (1800.0, 3600.0, 7200.0, 14400.0)
CASES = {"williamson5": 16, "galewsky": 16}
NAMES = ("rk4", "kg5", "forward-backward", "leapfrog", "semi-implicit", "ark2", "ars343")
BATCH = 10
"""Number of steps that are timed together."""
FINE = 8
"""Number of steps of the time-converged reference run per automatic step of rk4."""


class Pair:
    """One scene on one mesh, without hyperviscosity and with the default one of the mesh."""

    def __init__(self, name: str, ne: int) -> None:
        scene, self.mesh = get_scene(name), Mesh.build(ne, 4)
        self.name = name
        self.plain = Model(self.mesh, scene)
        self.thick = Model(self.mesh, scene.with_effect(Hyperviscosity(factor=30.0)))
        self._exact = self._after_a_day("rk4", self.automatic("rk4", self.thick) / FINE)

    def automatic(self, name: str, model: Model, at_stages: bool = False) -> float:
        """Return the automatic step [s]; at_stages: as if stages evaluated hyperviscosity."""
        kind, start = STEPPERS[name], model.initial_state()
        wave = kind.spectral_radii(model, start)
        more = model.spectral_radii(start).dissipation if at_stages else wave.dissipation
        return kind.safety * kind.stable_dt(SpectralRadii(wave.wave, more))

    def _after_a_day(self, name: str, dt: float) -> dict[str, np.ndarray]:
        return self.thick.fields(a_day(STEPPERS[name](self.thick, DAY / np.ceil(DAY / dt))).state)

    def row(self, name: str, rounds: int) -> list[str]:
        """Return the row of one stepper; rounds: number of pairs of timed batches."""
        free, now = (self.automatic(name, model) for model in (self.plain, self.thick))
        within = self.automatic(name, self.thick, at_stages=True)
        pair = [started(name, model, free) for model in (self.plain, self.thick)]
        ratios = [seconds(pair[1]) / seconds(pair[0]) for _ in range(rounds)]
        error = by_name(field_errors(self.mesh.area, self._after_a_day(name, now), self._exact))
        split = pair[1].diffusion
        return [
            self.name, name, f"{free:.0f}", f"{within:.0f}", f"{now:.0f}",
            "" if split is None else f"{len(split.stages)}", f"× {statistics.median(ratios):.2f}",
            f"{error['l2_h']:.1e}", f"{error['l2_v']:.1e}",
        ]  # fmt: skip

    def implicit_row(self, dt: float) -> list[str]:
        """Return the row of the implicit stepper with steps of dt [s] over a day."""
        kind: Any = STEPPERS[IMPLICIT]
        counts, times, found = [], [], []
        for model, how in ((self.plain, "whole"), (self.thick, "whole"), (self.thick, "apart")):
            a_day(kind(model, dt, diffusion=how))  # compiles
            began = time.process_time()
            stepper = a_day(kind(model, dt, diffusion=how))
            times.append(time.process_time() - began)
            counts.append(stepper.counters["krylov_iterations"] / stepper.steps)
            end = model.fields(stepper.state)
            found.append(by_name(field_errors(self.mesh.area, end, self._exact)))
        return [
            f"{dt:.0f}", *(f"{count:.1f}" for count in counts),
            *(f"× {seconds / times[0]:.2f}" for seconds in times[1:]),
            *(f"{error[norm]:.1e}" for norm in ("l2_h", "l2_v") for error in found[1:]),
        ]  # fmt: skip


def a_day(stepper: Stepper) -> Stepper:
    """Return the stepper after a day from the initial state."""
    stepper.start(stepper.model.initial_state())
    for _ in range(round(DAY / stepper.dt)):
        stepper.step()
    return stepper


def started(name: str, model: Model, dt: float) -> Stepper:
    """Return a stepper of that name after a first batch of steps, which loads kernels."""
    stepper = STEPPERS[name](model, dt)
    stepper.start(model.initial_state())
    seconds(stepper)
    return stepper


def seconds(stepper: Stepper) -> float:
    """Return the CPU time [s] of `BATCH` steps."""
    began = time.process_time()
    for _ in range(BATCH):
        stepper.step()
    return time.process_time() - began


def main(
    rounds: Annotated[int, typer.Option(min=3, help="Batches a row.")] = 9,
    write: Annotated[Path | None, typer.Option(help="Also replace the table of this page.")] = None,
) -> None:
    """Measure and print the table."""
    wp.config.log_level = wp.LOG_WARNING
    pairs = [Pair(*case) for case in CASES.items()]
    explicit = [pair.row(name, rounds) for pair in pairs for name in NAMES]
    implicit = [pairs[0].implicit_row(dt) for dt in STEPS]
    note = f"CPU: median of {rounds} alternating batches. {stamp_text(stamp())}"
    for mark, head, rows, told in (
        ("hyperviscosity", HEAD, explicit, note),
        ("hyperviscosity, implicit", IMPLICIT_HEAD, implicit, stamp_text(stamp())),
    ):
        table = Table(*head)
        for row in rows:
            table.add_row(*row)
        Console(width=160).print(table)
        if write:
            _replace_table(write, mark, [head, tuple("---" for _ in head), *rows], told)


def _replace_table(page: Path, mark: str, lines: list[Sequence[str]], note: str) -> None:
    start, end = f"<!-- {mark} -->", f"<!-- end of {mark} -->"
    text = page.read_text()
    before, after = text.split(start)[0], text.split(end)[1]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    page.write_text(f"{before}{start}\n{body}\n\n{note}\n{end}{after}")


if __name__ == "__main__":
    typer.run(main)
