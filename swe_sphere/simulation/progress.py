"""How a run tells what it is doing: nothing, warnings, or a progress bar."""

import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from swe_sphere.planet import DAY
from swe_sphere.ranks.terminal import screen
from swe_sphere.simulation.running import Running


class Watcher:
    """Told how a run is going; this one does not care, but passes warnings on where told to."""

    def __init__(self, warn: Callable[[str], None] | None = None) -> None:
        self._warn = warn

    def warn(self, text: str) -> None:
        """Something the user should know, in one line."""
        if self._warn is not None:
            self._warn(text)

    def begin(self, sim: Running) -> None:
        """The first step is about to be taken."""

    def tick(self, sim: Running) -> None:
        """Steps have been taken; told about ten times a second."""

    def end(self) -> None:
        """The last step has been taken."""


class ProgressBar(Watcher):
    """A bar on stderr, or in a notebook; one that has lost its terminal is no reason to stop."""

    _bar: Any = None

    def begin(self, sim: Running) -> None:
        """Show the bar."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of tqdm, in notebooks without widgets: text will do
            from tqdm.auto import tqdm
        plan = sim.plan
        self._days = plan.time(plan.steps) / DAY
        label = f"{sim.scene.name}  dt {plan.dt:.4g} s"
        self._bar = tqdm(
            total=plan.steps, initial=sim.steps, desc=label, unit="step", leave=False,
            file=screen("stderr"), dynamic_ncols=True,
        )  # fmt: skip

    def tick(self, sim: Running) -> None:
        """Move the bar."""
        if self._bar is not None:
            with suppress(OSError):
                self._bar.set_postfix_str(f"day {sim.time / DAY:.2f} of {self._days:g}", False)
                self._bar.update(sim.steps - self._bar.n)

    def end(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            with suppress(OSError):
                self._bar.close()


class LogLines(Watcher):
    """A line on stderr now and then, for a run whose output goes to a file."""

    PATIENCE = 30.0
    """Seconds before the first line; each further one waits a tenth of the time gone, at least."""

    def begin(self, sim: Running) -> None:
        """Start the clock."""
        self._start, self._from = time.perf_counter(), sim.time
        self._due = self._start + self.PATIENCE

    def tick(self, sim: Running) -> None:
        """Tell the day, the speed and how long it will take, where a line is due."""
        now = time.perf_counter()
        if now < self._due:
            return
        gone = now - self._start
        self._due = now + max(self.PATIENCE, 0.1 * gone)
        end = sim.plan.time(sim.plan.steps)
        speed = (sim.time - self._from) / gone
        left = (end - sim.time) / speed if speed > 0.0 else float("inf")
        with suppress(OSError):  # nobody reads it any more, or the disk is full
            sys.stderr.write(
                f"swe-sphere: day {sim.time / DAY:.2f} of {end / DAY:g} after {gone:.0f} s,"
                f" {60.0 * speed / DAY:.3g} days a minute, {left:.0f} s to go\n"
            )
            sys.stderr.flush()


def notebook(progress: bool | None) -> Watcher:
    """What is shown where Python is used by hand: warnings of its own kind, and a bar.

    progress: whether to show a bar; None: where there is a notebook, or a terminal.
    """
    if progress is None:
        terminal = sys.stderr is not None and sys.stderr.isatty()
        progress = terminal or "ipykernel" in sys.modules
    return (ProgressBar if progress else Watcher)(partial(warnings.warn, stacklevel=4))
