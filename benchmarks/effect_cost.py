"""Cost of each effect: arrays, loads, operations and time of one right-hand side.

    python benchmarks/effect_cost.py [--rounds 25] [--steps] [--write docs/reference/effects.md]

Arrays, loads and operations are counted in the generated code (`generated.py`); times are CPU times
of batches that alternate with and without the effect, so that other load on the machine affects
both.  The tables show the median of the ratios.  --write replaces the table of the page and keeps
its prose.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer
import warp as wp
from generated import Cost, cost
from rich.console import Console
from rich.table import Table
from sections import stamp, stamp_text

from swe_sphere.equations.effects import (
    Drag,
    EdgePenalty,
    Forcing,
    Hyperviscosity,
    LinearisedDynamics,
    PrescribedWind,
    Relaxation,
    Tracers,
    Viscosity,
)
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene
from swe_sphere.mesh import Mesh
from swe_sphere.operators import Launcher
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene

NE, NP = 16, 4
BATCH = 0.02
"""Time of one batch [s]."""
START, END = "<!-- table -->", "<!-- end of table -->"
STEPS_START, STEPS_END = "<!-- steps -->", "<!-- end of steps -->"
MESHES = ((4, 5), (16, 4), (8, 8))
STEPPED = ("rk4", "forward-backward", "leapfrog", "semi-implicit", "bdf2", "esdirk4")
STEPS_HEAD = ("stepper", *(f"ne{ne} np{np_}" for ne, np_ in MESHES))
HOUR = 3600.0
HEAD = ("effect", "compared with", "kernels", "arrays", "loads", "flops", "time")


def forced(lon: np.ndarray, lat: np.ndarray, t: float) -> tuple[np.ndarray, ...]:
    """Return a forcing of wind and depth that changes in time."""
    phase = lon - 1e-4 * t
    return 1e-5 * np.cos(lat) * np.sin(phase), 1e-5 * np.cos(phase), 1e-3 * np.cos(lat)


def cases() -> Iterator[tuple[str, str, Scene, Scene | None]]:
    """Yield the names of an effect and its reference, and scenes with and without the effect."""
    whole = get_scene("williamson5")
    plain = whole.without_effect("orography")
    yield "all of williamson5", "", whole, None
    for name in ("momentum-advection", "rotation", "orography"):
        yield name, "williamson5 without it", whole, whole.without_effect(name)
    added: dict[str, Scene] = {
        "forcing, unsteady": replace(plain, effects=(*plain.effects, Forcing()), forcing=forced),
        "forcing, steady": replace(
            plain, effects=(*plain.effects, Forcing()), forcing=forced, steady_forcing=True
        ),
        "drag, linear": plain.with_effect(Drag(linear=1e-6)),
        "drag, linear and quadratic": plain.with_effect(Drag(1e-6, 1e-8)),
        "relaxation": plain.with_effect(Relaxation(1e6)),
        "linearised": replace(
            plain, effects=(*plain.effects, LinearisedDynamics()), base=plain.initial
        ),
        "viscosity": plain.with_effect(Viscosity(1e5)),
        "hyperviscosity": plain.with_effect(Hyperviscosity()),
        "edge-penalty": plain.with_effect(EdgePenalty()),
        "tracers, one": replace(
            plain, effects=(*plain.effects, Tracers()), tracers={"q": lambda lon, lat: np.cos(lat)}
        ),
    }
    for name, scene in added.items():
        yield name, "williamson5 without orography", scene, plain
    wind = get_scene("williamson1")
    assert isinstance(wind.effects[0], PrescribedWind)
    yield "prescribed-wind (alone)", "williamson5 without orography", wind, plain


class Measured:
    """Right-hand side of a scene: the contents of its kernels, and its CPU time."""

    def __init__(self, scene: Scene) -> None:
        mesh = Mesh.build(NE, NP)
        launches = recorded(Model(mesh, scene, shape="node"))
        self._model = Model(mesh, scene)
        self._state, self._out = self._model.initial_state(), self._model.zeros()
        self.kernels = len(launches)
        self.arrays = sum(arrays(arguments) for _, _, arguments in launches)
        """Number of array arguments of all kernels, including members of structures."""
        self.cost = Cost()
        """Loads, stores and operations per node of the state."""
        for kernel, threads, _ in launches:
            self.cost += cost(kernel, mesh.nodes.size / mesh.size) * (threads / mesh.size)
        self._times = 3
        self._times = max(3, round(BATCH / min(self.seconds() for _ in range(3))))

    def seconds(self) -> float:
        """Return the mean CPU time [s] of a right-hand side over a batch of scene times."""
        start = time.process_time()
        for i in range(self._times):
            self._model.tendency(self._state, float(i), self._out)
        return (time.process_time() - start) / self._times


def step_ratio(name: str, ne: int, np_: int, rounds: int) -> str:
    """CPU time of a step of williamson5 with the edge penalty over that without it, interleaved.

    The steps are automatic ones, at most an hour long; a batch has whole cycles of the penalty.
    """
    mesh, scene, kind = Mesh.build(ne, np_), get_scene("williamson5"), STEPPERS[name]
    models = [Model(mesh, each) for each in (scene.with_effect(EdgePenalty()), scene)]
    limits = [kind.stable_dt(kind.spectral_radii(model, model.initial_state())) for model in models]
    assert limits[0] >= 0.97 * limits[1]
    pair = [kind(model, min(HOUR, kind.safety * limits[1])) for model in models]
    for model, stepper in zip(models, pair, strict=True):
        stepper.start(model.initial_state())
    cycle = pair[0].penalty.every if pair[0].penalty else 8
    times = [[seconds_of(stepper, cycle) for stepper in pair] for _ in range(rounds + 2)][2:]
    least = [min(of) for of in zip(*times, strict=True)]
    median = statistics.median(first / second for first, second in times)
    return f"× {median:.2f} (least {least[0] / least[1]:.2f})"


def seconds_of(stepper: Any, cycle: int) -> float:
    """Return the mean CPU time [s] of a step over at least one cycle of the penalty.

    The run starts anew, because a long one without the penalty may become unstable.
    """
    stepper.start(stepper.model.initial_state())
    for _ in range(cycle):
        stepper.step()
    steps, start = 0, time.process_time()
    while steps == 0 or time.process_time() - start < BATCH:
        for _ in range(cycle):
            stepper.step()
        steps += cycle
    return (time.process_time() - start) / steps


def recorded(model: Model) -> list[tuple[Any, int, tuple[Any, ...]]]:
    """Return kernel, number of threads and arguments of each launch of a right-hand side."""
    state, out = model.initial_state(), model.zeros()
    launches: list[tuple[Any, int, tuple[Any, ...]]] = []
    launch = Launcher.__call__

    def record(self: Launcher, kernel: Any, dim: Any, *arguments: Any, **cuts: Any) -> None:
        launches.append((kernel, int(np.prod(dim)), arguments))
        launch(self, kernel, dim, *arguments, **cuts)

    Launcher.__call__ = record  # type: ignore[method-assign]
    try:
        model.tendency(state, 0.0, out)
    finally:
        Launcher.__call__ = launch  # type: ignore[method-assign]
    return launches


def arrays(arguments: tuple[Any, ...]) -> int:
    """Return the number of array arguments of a kernel, including those in structures."""
    found = 0
    for argument in arguments:
        found += isinstance(argument, wp.array) and argument.size > 0
        if hasattr(argument, "_cls"):
            found += arrays(tuple(getattr(argument, name) for name in argument._cls.vars))
    return found


@dataclass
class Row:
    """An effect, the right-hand sides with and without it, and the ratios of their times."""

    name: str
    other: str
    with_it: Measured
    without: Measured | None
    ratios: list[float] = field(default_factory=list)

    def batch(self) -> None:
        """Time one more batch with and one without the effect."""
        if self.without is None:
            self.ratios.append(1e9 * self.with_it.seconds())
            return
        first = self.with_it.seconds()
        self.ratios.append(first / self.without.seconds())

    def cells(self) -> list[str]:
        """Return the row of the table."""
        mine, zero = self.with_it, Cost()
        other = self.without or mine
        loads, flops = (
            self._figure(
                getattr(mine.cost, name), getattr(other.cost if self.without else zero, name)
            )
            for name in ("loads", "flops")
        )
        kernels = self._figure(mine.kernels, other.kernels if self.without else 0)
        held = self._figure(mine.arrays, other.arrays if self.without else 0)
        return [self.name, self.other, kernels, held, loads, flops, self._time()]

    def _figure(self, mine: float, other: float) -> str:
        return f"{mine:.3g}" if self.without is None else f"{mine - other:+.3g}"

    def _time(self) -> str:
        low, middle, high = statistics.quantiles(self.ratios, n=4)
        if self.without is None:
            return f"{middle / 1e3:.0f} µs ± {50 * (high - low) / middle:.0f} %"
        return f"× {middle:.2f} ± {0.5 * (high - low):.2f}"


def main(
    rounds: Annotated[int, typer.Option(min=3, help="Batches a row.")] = 25,
    write: Annotated[Path | None, typer.Option(help="Also replace the table of this page.")] = None,
    steps: Annotated[bool, typer.Option("--steps", help="Only steps with the penalty.")] = False,
) -> None:
    """Measure and print the tables."""
    wp.config.log_level = wp.LOG_WARNING
    if steps:
        penalised_steps(rounds, write)
        return
    with TemporaryDirectory() as cache:
        wp.config.kernel_cache_dir = cache
        rows = [
            Row(name, other, Measured(scene), None if without is None else Measured(without))
            for name, other, scene, without in cases()
        ]
        for _ in range(rounds):
            for row in rows:
                row.batch()
    table = Table(*HEAD)
    for row in rows:
        table.add_row(*row.cells())
    Console(width=140).print(table)
    if write:
        note = "± half the interquartile range"
        _replace_table(write, (START, END), HEAD, [row.cells() for row in rows], rounds, note)
        penalised_steps(rounds, write)


def penalised_steps(rounds: int, write: Path | None = None) -> None:
    """Measure and print what a step with the edge penalty costs."""
    rows = [[name, *(step_ratio(name, *mesh, rounds) for mesh in MESHES)] for name in STEPPED]
    table = Table(*STEPS_HEAD)
    for row in rows:
        table.add_row(*row)
    Console(width=140).print(table)
    if write:
        ends = STEPS_START, STEPS_END
        _replace_table(write, ends, STEPS_HEAD, rows, rounds, "and the ratio of the least times")


def _replace_table(
    page: Path, ends: tuple[str, str], head: tuple[str, ...], rows: list[list[str]], rounds: int,
    note: str,
) -> None:  # fmt: skip
    lines = [head, tuple("---" for _ in head), *rows]
    text = page.read_text()
    before, after = text.split(ends[0])[0], text.split(ends[1])[1]
    note = f"Median of {rounds} alternating batches, {note}. {stamp_text(stamp())}"
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    page.write_text(f"{before}{ends[0]}\n{body}\n\n{note}\n{ends[1]}{after}")


if __name__ == "__main__":
    typer.run(main)
