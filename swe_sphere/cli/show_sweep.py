"""What a sweep shows on the terminal: notes, progress, the table at the end."""

from __future__ import annotations

import math
import sys
from collections import Counter
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from swe_sphere.studies.sweep import SweepPlan, SweepWatcher

if TYPE_CHECKING:
    import xarray as xr
    from rich.progress import Progress
    from rich.table import Table

    from swe_sphere.studies.report import Ranking
    from swe_sphere.studies.sweep.record import RunRecord
    from swe_sphere.studies.sweep.runspec import RunSpec

WIDE = 160
"""Columns of the screen where there is none."""


class SweepTerminal(SweepWatcher):
    """Notes on stderr; a progress bar there too if it is a terminal and nobody minds."""

    def __init__(self, plan: SweepPlan, quiet: bool) -> None:
        self._scene, self._quiet = plan.scene, quiet
        self._bar: Progress | None = None
        self._task: Any = None
        self._expected = self._done = self._made = 0

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

    def beside(self, record: RunRecord) -> None:
        """Say what was made."""
        self._made += 1
        self._show(what=f"{self._made} made, the last by {record.config.stepper}")

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
    """Who reaches which error at which cost, mesh by mesh, and how runs failed.

    search: of one for an error, what was asked for.
    """
    from rich.console import Console

    from swe_sphere.studies.report import sweep_rankings

    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = WIDE
    found = sweep_rankings(dataset) if search is None else _searched(dataset, search)
    for ranking in found:
        console.print(ranking.headline, soft_wrap=True)
        if any(ranking.winners(i) for i in range(len(ranking.targets))):
            console.print(_table(ranking))
    if found:
        console.print(found[-1].caption, soft_wrap=True)
    if not found:
        console.print(f"{dataset.attrs['scene']}: no run has an error that could be compared")
    columns = (dataset[name].values for name in ("stepper", "status", "reason"))
    failures = Counter(words for words in zip(*columns, strict=True) if words[-1])
    for (stepper, status, reason), count in failures.items():
        times = f"{count} × " if count > 1 else ""
        console.print(f"{times}{stepper}, {status}: {reason}", soft_wrap=True)


def _searched(dataset: xr.Dataset, search: SweepPlan) -> list[Ranking]:
    """Rankings by the error that was searched for, one for each mesh."""
    from swe_sphere.studies.report import Metric, sweep_rankings

    tried = dataset.isel(run=dataset["role"].values == "target")
    day, kind = float(dataset["report_day"].values[-1]), search.target_kind
    total = dataset["error"].sel(kind="total", field=search.target_field)
    if kind == "auto":
        kind = "total" if bool(total.notnull().any()) else "time"
    field = "vorticity" if kind == "slow" else search.target_field
    metric = Metric(kind, field, search.target_norm, day)
    return sweep_rankings(tried, metric, [search.target_error or math.inf])


def _table(ranking: Ranking) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0, collapse_padding=True)
    for head in ranking.heads:
        table.add_column(head, no_wrap=True)
    for line in ranking.body:
        table.add_row(*line)
    return table


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
