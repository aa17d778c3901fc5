"""Work that is the same launches every time: recorded once, then launched as a whole."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.operators.launch import Launcher


@dataclass(frozen=True)
class _Recorded:
    """What launches it all, counted as one kind of work, and what it adds to other counters."""

    launch: Callable[[], None]
    counters: dict[str, int]


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
        if (known := self._recorded.get(key)) is not None:
            known.launch()
            for name, calls in known.counters.items():
                self._counters[name] += calls
            instead()
        elif key in self._seen and self._launch.records:
            record = self._launch.work.section("recording", self._record)
            self._recorded[key] = record(function)
            self._recorded[key].launch()
        else:
            self._seen.add(key)
            function()

    def _record(self, function: Callable[[], None]) -> _Recorded:
        """Work of the same launches is of one kind, whichever run it is recorded in."""
        work, counted = self._launch.work, dict(self._counters)
        before = work.counts()
        parts = self._capture(function)
        launches = sorted(
            (name, n - before.get(name, (0,))[0]) for name, (n, _) in work.counts().items()
        )
        named = zlib.crc32(repr([each for each in launches if each[1]]).encode())

        def launch() -> None:
            for part in parts:
                if isinstance(part, wp.Graph):
                    wp.capture_launch(part)
                else:
                    part()

        return _Recorded(
            work.counted(f"recorded {named:08x}", launch),
            {name: n - counted[name] for name, n in self._counters.items()},
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
