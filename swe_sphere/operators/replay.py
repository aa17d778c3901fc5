"""Work that is the same launches every time: recorded once, then launched as a whole."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.work import Tally


@dataclass(frozen=True)
class _Recorded:
    """Graphs of launches, with the work between them, and what they add to the counts."""

    parts: list[Any]
    work: list[tuple[Tally, int]]
    counters: dict[str, int]

    def __call__(self) -> None:
        for part in self.parts:
            if isinstance(part, wp.Graph):
                wp.capture_launch(part)
            else:
                part()


class Replay:
    """Runs functions that launch kernels: a CUDA graph on a GPU, a list in Warp's C++ on a CPU.

    What is launched one by one costs more than the kernels themselves where meshes are small.
    """

    def __init__(self, launch: Launcher, counters: dict[str, int] | None = None) -> None:
        """counters: what the functions count beside the launches, if anything."""
        self._launch, self._counters = launch, {} if counters is None else counters
        self._seen: set[Hashable] = set()
        self._recorded: dict[Hashable, _Recorded] = {}

    def __call__(
        self,
        key: Hashable,
        function: Callable[[], None],
        instead: Callable[[], None] = lambda: None,
    ) -> None:
        """Do what the function does, which is to launch the same kernels each time for a key.

        It is run the first time, so that all kernels are loaded, and the second time to record
        them.  Then `instead` is run beside them: what else the function does.
        """
        if self._launch.work.timer is not None:  # which wants to see each of them
            function()
        elif (known := self._recorded.get(key)) is not None:
            known()
            self._count(known)
            instead()
        elif key in self._seen:
            self._recorded[key] = self._record(function)
            self._recorded[key]()
        else:
            self._seen.add(key)
            function()

    def _record(self, function: Callable[[], None]) -> _Recorded:
        work, counters = self._launch.work, self._counters
        before, counted = work.counts(), dict(counters)
        parts = self._capture(function)
        calls = {name: n - before.get(name, (0, 0))[0] for name, (n, _) in work.counts().items()}
        return _Recorded(
            parts,
            [(work.tally(name), n) for name, n in calls.items() if n],
            {name: n - counted[name] for name, n in counters.items()},
        )

    def _capture(self, function: Callable[[], None]) -> list[Any]:
        """Its launches, in as many graphs as there is work of ranks between them, and that work."""
        device, comm, parts = self._launch.device, self._launch.comm, list[Any]()

        def cut(work: Callable[[], None]) -> None:
            parts.extend((wp.capture_end(device), work))
            wp.capture_begin(device, force_module_load=False)

        wp.capture_begin(device, force_module_load=False)
        comm.recorder = cut
        try:
            function()
        finally:
            comm.recorder = None
            parts.append(wp.capture_end(device))
        return parts

    def _count(self, known: _Recorded) -> None:
        for tally, calls in known.work:
            tally.calls += calls
        for name, calls in known.counters.items():
            self._counters[name] += calls
