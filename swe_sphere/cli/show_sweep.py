"""What a sweep shows on the terminal: notes, progress, the table at the end."""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

import typer

from swe_sphere.cli.show import print_table
from swe_sphere.compiling import COMPILING, on_compile
from swe_sphere.simulation.loop import Interrupted
from swe_sphere.studies.sweep import SweepWatcher

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import xarray as xr

    from swe_sphere.studies.report import Ranking
    from swe_sphere.studies.sweep.runs import RunSpec


class SweepTerminal(SweepWatcher):
    """Notes on stderr; a progress bar there too if it is a terminal and nobody minds."""

    def __init__(self, title: str, quiet: bool) -> None:
        from tqdm import tqdm

        self._quiet = quiet
        self._bar: Any = tqdm(
            total=0, desc=title, unit="run", leave=False, file=sys.stderr,
            disable=quiet or not sys.stderr.isatty(),
        )  # fmt: skip
        self.close = self._bar.close

    def expect(self, runs: int) -> None:
        """Lengthen the bar."""
        self._bar.total += runs
        self._bar.refresh()

    def begin(self, spec: RunSpec) -> None:
        """Say what is running."""
        self._steps = 0 if spec.steps is None else spec.steps.steps
        self._label = spec.label
        self._bar.set_postfix_str(spec.label)

    def tick(self, step: int) -> None:
        """Say how far it is."""
        self._bar.set_postfix_str(f"{self._label}, step {step} of {self._steps}")

    def done(self) -> None:
        """Move the bar."""
        self._bar.update()

    def note(self, text: str) -> None:
        """Print it."""
        if not self._quiet:
            self._bar.write(text, file=sys.stderr)


@contextmanager
def watched(title: str, quiet: bool, interrupted: str) -> Iterator[SweepTerminal]:
    """Show how a sweep in the block goes; Ctrl-C stops the command with that text."""
    terminal = SweepTerminal(title, quiet)
    try:
        with closing(terminal), on_compile(lambda: terminal.note(COMPILING)):
            yield terminal
    except (Interrupted, KeyboardInterrupt):
        raise Interrupted(interrupted) from None


def show_sweep(dataset: xr.Dataset) -> None:
    """Who reaches which error at which cost, mesh by mesh, and how runs failed."""
    from swe_sphere.studies.report import sweep_rankings

    found = sweep_rankings(dataset)
    show_rankings(found)
    if not found:
        typer.echo(f"{dataset.attrs['scene']}: no run has an error that could be compared")
    ends = dataset[["stepper", "status", "reason"]].to_dataframe()
    for (stepper, status, reason), count in Counter(ends.itertuples(False, None)).items():
        times = f"{count} × " if count > 1 else ""
        if reason:
            typer.echo(f"{times}{stepper}, {status}: {reason}")


def show_rankings(found: Sequence[Ranking]) -> None:
    """The headline and the table of each, and how to read the last."""
    for ranking in found:
        typer.echo(ranking.headline)
        if any(run is not None for row in ranking.lines.values() for run in row[:-1]):
            print_table(ranking.heads, ranking.body)
    if found:
        typer.echo(found[-1].caption)
