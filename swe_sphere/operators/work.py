"""How much work a model has done, by kind: launches of each kernel, vector operations, host solves.

Counts are exact and the same on every machine; with the price of each kind they say what a run
costs where nothing else disturbs it (see `swe_sphere.studies.costs`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["RECORDING", "Counts", "Tally", "Timer", "Work", "difference"]

RECORDING = "recording"
"""The kind of work by which other work is recorded: once, however long a run is."""

Counts = Mapping[str, tuple[int, int]]
"""(calls, rows) by kind of work, see `Tally`."""


@dataclass(slots=True, eq=False)
class Tally:
    """One kind of work."""

    name: str
    calls: int = 0
    rows: int = 0
    """Vectors that all calls together have read, where a call may read any number of them."""


Timer = Callable[[Tally, int, Callable[..., Any], tuple[Any, ...]], Any]
"""timer(tally, rows, function, arguments) returns function(*arguments), which it may time."""


class Work:
    """Tallies by name.  While `timer` is set, all counted calls go through it."""

    def __init__(self) -> None:
        self._tallies: dict[str, Tally] = {}
        self.timer: Timer | None = None
        self.counting = True
        """Not inside of what is counted as a whole."""

    def tally(self, name: str) -> Tally:
        """The tally of that name, a new one where there is none."""
        return self._tallies.setdefault(name, Tally(name))

    def counts(self) -> dict[str, tuple[int, int]]:
        """(calls, rows) so far, by name."""
        return {name: (t.calls, t.rows) for name, t in self._tallies.items() if t.calls}

    def counted(
        self, name: str, function: Callable[..., Any], rows: Callable[..., int] | None = None
    ) -> Callable[..., Any]:
        """The function with its calls counted; `rows` tells from its arguments how many it reads.

        It must not call anything else that is counted: see `section`.
        """
        tally = self.tally(name)

        def call(*arguments: Any) -> Any:
            size = 0 if rows is None else rows(*arguments)
            tally.calls += 1
            tally.rows += size
            if self.timer is None:
                return function(*arguments)
            return self.timer(tally, size, function, arguments)

        return call

    def section(
        self, name: str, function: Callable[..., Any], rows: Callable[..., int] | None = None
    ) -> Callable[..., Any]:
        """The function with its calls counted, and what is counted inside of it left out."""
        return self.counted(name, lambda *arguments: self.uncounted(function, *arguments), rows)

    def uncounted(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function returns, with nothing counted nor timed that it does."""
        before = {each: (each.calls, each.rows) for each in self._tallies.values()}
        timer, counting, self.timer, self.counting = self.timer, self.counting, None, False
        try:
            return function(*arguments)
        finally:
            self.timer, self.counting = timer, counting
            for each in self._tallies.values():
                each.calls, each.rows = before.get(each, (0, 0))

    def merge(self, counts: Counts, name: str) -> None:
        """Count work that was counted one by one as one call of the kind `name` instead."""
        for each, (calls, rows) in counts.items():
            self._tallies[each].calls -= calls
            self._tallies[each].rows -= rows
        self.tally(name).calls += 1


def difference(after: Counts, before: Counts) -> dict[str, tuple[int, int]]:
    """The work between two moments."""
    return {
        name: (calls - before.get(name, (0, 0))[0], rows - before.get(name, (0, 0))[1])
        for name, (calls, rows) in after.items()
        if calls > before.get(name, (0, 0))[0]
    }
