"""What a run costs where nothing disturbs it: counted work at prices of this machine; memory.

Wall times of a busy machine scatter by tens of percent.  How often a run calls each kernel, each
vector operation and each solve on the host does not (`swe_sphere.operators.work`), and the shortest
of many timings of a call hardly does.  The modelled time of a run is the sum over the kinds of work
of calls times price.

Prices come from the runs themselves: a stopwatch looks at some of the calls of every run, so that
all steppers and all moments of a study meet in them.
"""

from __future__ import annotations

import ctypes
import gc
import math
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swe_sphere.operators.work import Counts, Tally

Prices = Mapping[str, tuple[float, float]]
"""Seconds (a call, a row) by kind of work."""
Context = tuple[str, str, int]
"""The kinds of the two calls before, and the rows of this one."""

ENOUGH = 12
"""From so many calls on one of them was hardly disturbed."""
LOOKS, PERIOD = 64, 257
"""The stopwatch looks at so many calls in a row out of so many, a prime: no part of a step is
missed for good.  Runs begin with a look, as what is done once is done then; the first calls of each
kind are looked at wherever they come."""


@dataclass(slots=True)
class _Shortest:
    """Calls that were timed, and the shortest time among them [s]."""

    calls: int = 0
    seconds: float = math.inf

    def add(self, seconds: float, calls: int = 1) -> None:
        self.calls += calls
        if seconds < self.seconds:
            self.seconds = seconds


class Stopwatch:
    """A timer of the work of any number of models, one after the other: see `Work.timer`.

    The time of a call runs from the end of the call before it, so that what Python does in between
    is part of it.  Calls of a kind differ by the two calls before, which tell where in a step they
    are, and by the number of rows: the shortest time of each is kept.

    Calls have to be done when they return, as on a CPU.  clock: seconds; by default processor time,
    in which a call does not wait for other programs.
    """

    def __init__(self, clock: Callable[[], float] = time.thread_time) -> None:
        self._clock = clock
        self._found: dict[str, dict[Context, _Shortest]] = {}
        self._looks = Counter[str]()
        self.begin()

    def begin(self) -> None:
        """A run begins now: what came before is no part of its first call."""
        self._place, self._before, self._last = 0, ("", ""), self._clock()

    def __call__(
        self, tally: Tally, rows: int, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Any:
        """Call the function, and look at the clock now and then."""
        self._place = (self._place + 1) % PERIOD
        rare = self._place > LOOKS and self._looks[tally.name] < ENOUGH
        if rare:  # the call before was not looked at
            self._before, self._last = ("", ""), self._clock()
        result = function(*arguments)
        if rare or self._place <= LOOKS:
            self._look(tally.name, rows)
        return result

    def _look(self, name: str, rows: int) -> None:
        if self._place:  # else the call before was not looked at
            now = self._clock()
            by_context = self._found.setdefault(name, {})
            by_context.setdefault((*self._before, rows), _Shortest()).add(now - self._last)
            self._looks[name] += 1
        self._before, self._last = (self._before[1], name), self._clock()

    def prices(self) -> dict[str, tuple[float, float]]:
        """What is known so far."""
        return {name: _price(found) for name, found in self._found.items()}


def _price(found: Mapping[Context, _Shortest]) -> tuple[float, float]:
    """(a call, a row): the mean over the calls, each taken for as short as its shortest like.

    Calls with few like them are taken to be alike.
    """
    if len({rows for *_, rows in found}) == 1:
        usual = [one for one in found.values() if one.calls >= ENOUGH]
        rare = [one for one in found.values() if one.calls < ENOUGH]
        if rare:
            together = sum(one.calls for one in rare)
            usual.append(_Shortest(together, min(one.seconds for one in rare)))
        calls = sum(one.calls for one in usual)
        return sum(one.calls * one.seconds for one in usual) / calls, 0.0
    by_rows: dict[int, _Shortest] = {}
    for (*_, rows), one in found.items():
        by_rows.setdefault(rows, _Shortest()).add(one.seconds, one.calls)
    return _tangent(by_rows)


def _tangent(by_rows: Mapping[int, _Shortest]) -> tuple[float, float]:
    """The line below all points (rows, seconds) that is highest at the mean number of rows.

    Where a number of rows was never timed undisturbed its point lies high and is not touched.
    """
    calls = sum(one.calls for one in by_rows.values())
    mean = sum(rows * one.calls for rows, one in by_rows.items()) / calls
    left = [(r, one.seconds) for r, one in by_rows.items() if r <= mean]
    right = [(r, one.seconds) for r, one in by_rows.items() if r > mean]
    lines = (_line(a, b) for a in left for b in right)
    return min(lines, key=lambda line: line[0] + line[1] * mean)


def _line(a: tuple[int, float], b: tuple[int, float]) -> tuple[float, float]:
    """The line through `a` and not above `b`; neither a call nor a row costs less than nothing."""
    slope = max((b[1] - a[1]) / (b[0] - a[0]), 0.0)
    if slope * a[0] > a[1]:  # few calls, and the long ones disturbed more than the short ones
        return 0.0, a[1] / a[0]
    return a[1] - slope * a[0], slope


def lowest(several: Iterable[Prices]) -> dict[str, tuple[float, float]]:
    """Of prices found at several times, for each kind of work the lowest."""
    found: dict[str, tuple[float, float]] = {}
    for prices in several:
        for name, price in prices.items():
            found[name] = min(price, found.get(name, price), key=sum)
    return found


def modelled_seconds(counts: Counts, prices: Prices) -> float:
    """What the counted work costs [s]; NaN where none of it has a price.

    Rare work that has none is taken to cost what a call costs on average.
    """
    priced = {name: count for name, count in counts.items() if name in prices}
    seconds = sum(
        calls * prices[name][0] + rows * prices[name][1] for name, (calls, rows) in priced.items()
    )
    known = sum(calls for calls, _ in priced.values())
    return seconds / known * sum(calls for calls, _ in counts.values()) if known else math.nan


CLEAR = Path("/proc/self/clear_refs")
STATUS = Path("/proc/self/status")
RESET_PEAK = "5"
"""What Linux takes for: set the peak to what is resident now (proc(5), since 4.0)."""


@contextmanager
def settled_objects() -> Iterator[None]:
    """Within the block, garbage is looked for only among what is made in it, which is quick."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def begin_peak() -> bool:
    """Give back what earlier runs have left, and begin a new peak.

    False where the system cannot, so that the peak is that of all runs so far.
    """
    gc.collect()
    with suppress(OSError, AttributeError):  # where the C library can (glibc)
        ctypes.CDLL(None).malloc_trim(0)
    try:
        CLEAR.write_text(RESET_PEAK)
    except OSError:
        return False
    return True


def peak_memory() -> float:
    """Most memory resident since `begin_peak` [bytes], the interpreter and libraries included.

    Where there is no /proc it is the most since the process began; NaN where nothing tells.
    """
    try:
        found = re.search(r"VmHWM:\s+(\d+)", STATUS.read_text())
    except OSError:
        found = None
    return 1024.0 * float(found[1]) if found else _since_the_start()


def _since_the_start() -> float:
    try:
        import resource
    except ImportError:  # not on this system
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
