"""What a sweep shows on the terminal: notes, progress, the table at the end."""

from __future__ import annotations

import math
import sys
from collections import Counter
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from swe_sphere.studies.sweep import SweepPlan, SweepWatcher
from swe_sphere.studies.sweep.answer import Setting, best_kind, cheapest, settings

if TYPE_CHECKING:
    import xarray as xr
    from rich.progress import Progress
    from rich.table import Table

    from swe_sphere.studies.sweep.record import RunRecord
    from swe_sphere.studies.sweep.runspec import RunSpec

__all__ = ["SweepTerminal", "show_sweep"]


HEADS = (
    "stepper", "solver", "mesh", "dt [s]", "/ limit", "time", "total", "slow", "seconds", "±",
    "Krylov",
)  # fmt: skip
WIDE = 120
"""Columns of the screen where there is none."""
WORDS = ("stepper", "solver", "mesh")
OPTIONAL = ("solver", "mesh", "total", "slow", "Krylov")
"""Columns that are left out where all rows have the same in them."""


class SweepTerminal(SweepWatcher):
    """Notes on stderr; a progress bar there too if it is a terminal and nobody minds."""

    def __init__(self, plan: SweepPlan, quiet: bool) -> None:
        self._scene, self._quiet = plan.scene, quiet
        self._bar: Progress | None = None
        self._task: Any = None
        self._expected = self._done = 0

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            self._bar = _progress_bar()
            self._task = self._bar.add_task(self._scene, total=None, what="")
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def expect(self, runs: int) -> None:
        """Lengthen the bar."""
        self._expected += runs
        self._show(total=self._expected)

    def begin(self, spec: RunSpec) -> None:
        """Say what is running."""
        self._steps = 0 if spec.steps is None else spec.steps.steps
        self._label = spec.label
        self._show(what=spec.label)

    def tick(self, step: int) -> None:
        """Say how far it is."""
        self._show(what=f"{self._label}, step {step} of {self._steps}")

    def done(self, spec: RunSpec, record: RunRecord) -> None:
        """Move the bar."""
        self._done += 1
        self._show(completed=self._done)

    def note(self, text: str) -> None:
        """Print it."""
        if self._bar is not None:
            self._bar.console.print(text, markup=False, highlight=False)
        elif not self._quiet:
            sys.stderr.write(f"{text}\n")

    def _show(self, **values: Any) -> None:
        if self._bar is not None:
            self._bar.update(self._task, **values)


def show_sweep(dataset: xr.Dataset, search: SweepPlan | None = None) -> None:
    """The runs as a table; of a search for an error the cheapest setting of each stepper."""
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = WIDE
    if search is None:
        found = settings(dataset)
        title = f"{dataset.attrs['scene']}: errors l2(h), in time and in total, and what they cost"
        console.print(title, _table(found), sep="\n")
    else:
        found = settings(dataset, search.target_field, search.target_norm)
        _show_answer(console, search, found)
    for reason, count in Counter(s.reason for s in found if s.reason).items():
        console.print(f"{count} × {reason}" if count > 1 else reason, soft_wrap=True)
    if search is None:
        _show_rankings(console, dataset)


def _show_rankings(console: Any, dataset: xr.Dataset) -> None:
    """Which stepper reaches which error at the least cost: the table and the sentence."""
    from rich import box
    from rich.table import Table

    from swe_sphere.studies.report import sweep_rankings  # matplotlib takes its time to import

    for ranking in sweep_rankings(dataset):
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for i, head in enumerate(ranking.heads):
            table.add_column(head, justify="right" if i else "left", no_wrap=True)
        for line in ranking.body:
            table.add_row(*line)
        console.print("", ranking.caption, table, ranking.headline, sep="\n", soft_wrap=True)


def _show_answer(console: Any, search: SweepPlan, found: list[Setting]) -> None:
    target = search.target_error or math.inf
    kind = best_kind(found) if search.target_kind == "auto" else search.target_kind
    what = f"{kind} error {search.target_norm}({search.target_field}) of {target:g}"
    best = cheapest(found, target, kind)
    if best:
        console.print(f"{search.scene}: cheapest ways to a {what}", _table(best), sep="\n")
    else:
        console.print(f"{search.scene}: no stepper reaches a {what}")


def _table(found: list[Setting]) -> Table:
    """Settings as rows; what is the same in all of them is left out."""
    from rich import box
    from rich.table import Table

    cells = [_cells(setting) for setting in found]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0, collapse_padding=True)
    heads = [name for name in HEADS if name not in OPTIONAL or _differs(cells, name)]
    for name in heads:
        table.add_column(name, justify="left" if name in WORDS else "right", no_wrap=True)
    for row in cells:
        table.add_row(*(row[name] for name in heads))
    return table


def _differs(cells: list[dict[str, str]], name: str) -> bool:
    return len({row[name] for row in cells} - {""}) > 1


def _cells(s: Setting) -> dict[str, str]:
    """A setting as text, by the heads of columns."""
    values = {
        "time": _number(s.errors["time"]),
        "total": _number(s.errors["total"]),
        "slow": _number(s.errors["slow"]),
        "seconds": f"{s.wall:.3g}",
        "±": f"{50.0 * s.spread:.0f} %",
    }
    if s.status != "completed":
        values = {**dict.fromkeys(values, ""), "time": s.status}
    return {
        "stepper": s.stepper,
        "solver": s.preconditioner,
        "mesh": s.mesh,
        "dt [s]": f"{s.dt:.4g}" if s.dt < 1e4 else f"{s.dt:.0f}",
        "/ limit": f"{s.gravity_limits:.2g}"
        if s.gravity_limits < 10.0
        else f"{s.gravity_limits:.0f}",
        "Krylov": f"{s.krylov:.1f}" if s.krylov > 0.0 else "",
        **values,
    }


def _number(value: float) -> str:
    return f"{value:.1e}".replace("e-0", "e-") if math.isfinite(value) else ""


def _progress_bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[what]}"),
        Remaining(),
        console=Console(stderr=True),
        transient=True,
    )
