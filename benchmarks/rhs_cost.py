"""Cost of one right-hand side with DSS, in nanoseconds per element node, on one core.

    python benchmarks/rhs_cost.py [--rounds 15] [--write docs/rhs_cost.md]

Every case advances through the same rounds, so that a busy moment of the machine meets all of them;
the figure is the median over the rounds.  Meshes have about 25 000 element nodes.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
import warp as wp
from rich.console import Console
from rich.table import Table

from swe_sphere.equations import Model
from swe_sphere.machine import machine
from swe_sphere.mesh import Mesh
from swe_sphere.testcases import get_scene

ELEMENTS = {4: 16, 6: 11, 8: 8, 12: 5}
"""Elements along a face's edge for each np."""
SCENE = "williamson5"
BATCH = 0.02
"""Time of one batch [s]."""


@dataclass
class Case:
    """One kernel: np, launch shape, precision, and the batches measured."""

    np: int
    shape: str
    precision: str
    compile_seconds: float = 0.0
    nodes: int = 0
    batches: list[float] = field(default_factory=list)

    @property
    def label(self) -> str:
        """The case in words."""
        return f"ne{ELEMENTS[self.np]} np{self.np}, {self.precision}, {self.shape} launch shape"

    @property
    def nanoseconds(self) -> float:
        """Median time of a right-hand side per element node [ns]."""
        return 1e9 * statistics.median(self.batches) / self.nodes

    @property
    def spread(self) -> float:
        """Half the interquartile range over the median."""
        low, middle, high = statistics.quantiles(self.batches, n=4)
        return 0.5 * (high - low) / middle


class Timer:
    """A model ready to evaluate its right-hand side again and again."""

    def __init__(self, case: Case) -> None:
        mesh = Mesh.build(ELEMENTS[case.np], case.np)
        self.case = case
        self.model = Model(mesh, get_scene(SCENE), precision=case.precision, shape=case.shape)
        self.state, self.out = self.model.initial_state(), self.model.zeros()
        case.compile_seconds, case.nodes = self.model.compile_seconds, mesh.nodes.size
        self.count = 1
        self.count = max(3, round(BATCH / min(self._evaluate() for _ in range(3))))

    def batch(self) -> None:
        """Measure once more."""
        self.case.batches.append(self._evaluate())

    def _evaluate(self) -> float:
        start = time.perf_counter()
        for _ in range(self.count):
            self.model.tendency(self.state, 0.0, self.out)
        return (time.perf_counter() - start) / self.count


def measure(cases: Sequence[tuple[int, str, str]], rounds: int = 15) -> list[Case]:
    """The cost of (np, shape, precision) cases, all measured in turn in every round."""
    timers = [Timer(Case(*case)) for case in cases]
    for _ in range(rounds):
        for timer in timers:
            timer.batch()
    return [timer.case for timer in timers]


def main(
    rounds: Annotated[int, typer.Option(min=3, help="Batches a case.")] = 15,
    write: Annotated[Path | None, typer.Option(help="Also write a Markdown page here.")] = None,
) -> None:
    """Measure and print the table."""
    wp.config.log_level = wp.LOG_WARNING
    with TemporaryDirectory() as cache:
        wp.config.kernel_cache_dir = cache  # an empty one, so that compilation is seen
        cases = measure(
            [(n, s, p) for n in ELEMENTS for s in ("element", "node") for p in _PRECISIONS], rounds
        )
    table = Table("np", "mesh", *_COLUMNS, title=f"ns per element node, {SCENE}")
    rows = [_row(n, [case for case in cases if case.np == n]) for n in ELEMENTS]
    for row in rows:
        table.add_row(*row)
    console = Console()
    console.print(table)
    console.print(f"{machine()}; median of {rounds} interleaved batches of {BATCH * 1e3:.0f} ms")
    if write:
        write.write_text(_page(rows, rounds))


_PRECISIONS = ("float64", "float32")
_COLUMNS = [f"{s}, {p}" for s in ("element", "node") for p in _PRECISIONS] + ["compile, s"]


def _row(np_: int, cases: list[Case]) -> list[str]:
    cells = [f"{case.nanoseconds:.1f} ± {100 * case.spread:.0f} %" for case in cases]
    compiled = " / ".join(f"{case.compile_seconds:.1f}" for case in cases)
    return [str(np_), f"ne{ELEMENTS[np_]}", *cells, compiled]


def _page(rows: list[list[str]], rounds: int) -> str:
    head = ["np", "mesh", *_COLUMNS]
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(r) for r in rows)]
    return (
        "# Cost of one right-hand side\n\n"
        f"Nanoseconds per element node for one right-hand side of {SCENE} with DSS, on one core,\n"
        "by launch shape and precision; made by\n"
        "`python benchmarks/rhs_cost.py --write docs/rhs_cost.md`.\n"
        f"Median of {rounds} interleaved batches, ± half the interquartile range.\n{machine()}.\n\n"
        + "\n".join(f"| {line} |" for line in lines)
        + "\n"
    )


if __name__ == "__main__":
    typer.run(main)
