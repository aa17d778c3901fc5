"""Work that is the same launches every time: recorded once, then launched as a whole."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass

import warp as wp

from swe_sphere.operators.launch import REMEMBERED, Launcher
from swe_sphere.operators.work import RECORDING, Counts, difference


@dataclass(frozen=True)
class _Recorded:
    """What launches it all, counted as one kind of work, and what it adds to other counters."""

    launch: Callable[[], None]
    counters: dict[str, int]


def recorded(
    launch: Launcher, function: Callable[[wp.array, wp.array], None]
) -> Callable[[wp.array, wp.array], None]:
    """A function (x, out) that only launches kernels, recorded for each pair of arrays."""
    replay = Replay(launch)
    return lambda x, out: replay((x.ptr, out.ptr), lambda: function(x, out))


_OPEN: dict[str, list[Callable[[], None]]] = {}
"""Pieces of what is being recorded, by device: graphs, and what is done between them."""


def between(device: str, function: Callable[[], None]) -> None:
    """Do what is no launch on the device in its place among those that are, recorded or not."""
    if device in _OPEN:
        _OPEN[device] += [_end(device), function]
        wp.capture_begin(device, force_module_load=False)
    else:
        function()


def _end(device: str) -> Callable[[], None]:
    graph = wp.capture_end(device)
    return lambda: wp.capture_launch(graph)


class Replay:
    """Runs functions that launch kernels: a CUDA graph on a GPU, a list in Warp's C++ on a CPU.

    What is launched one by one costs more than the kernels themselves where meshes are small.
    """

    def __init__(self, launch: Launcher, counters: dict[str, int] | None = None) -> None:
        """counters: what the functions count beside the launches, if anything."""
        self._launch, self._counters = launch, {} if counters is None else counters
        self._seen: dict[Hashable, Counts] = {}
        """What doing it once has added to the counts of work."""
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
        if not (self._launch.records and self._launch.work.counting):
            function()  # part of what is recorded or counted as a whole
        elif (known := self._recorded.get(key)) is not None:
            known.launch()
            for name, calls in known.counters.items():
                self._counters[name] += calls
            instead()
        elif key in self._seen:
            self._recorded[key] = self._record(function, self._seen.pop(key))
            self._recorded[key].launch()
        else:
            if len(self._recorded) + len(self._seen) >= REMEMBERED:
                self._seen.clear()
                self._recorded.clear()
            before = self._launch.work.counts()
            with self._launch.one_by_one():
                function()
            self._seen[key] = difference(self._launch.work.counts(), before)

    def _record(self, function: Callable[[], None], launches: Counts) -> _Recorded:
        """Work of the same launches is of one kind, whichever run it is recorded in.

        Having done it once, to load kernels, then counts as one piece of that kind.  Recording is
        work of its own, the more the more launches.
        """
        work, counted = self._launch.work, dict(self._counters)
        size = sum(calls for calls, _ in launches.values())
        pieces = work.section(RECORDING, self._capture, rows=lambda _: size)(function)
        named = zlib.crc32(repr(sorted(launches.items())).encode())
        name = f"recorded {named:08x}"
        work.merge(launches, name)
        return _Recorded(
            work.counted(name, lambda: [piece() for piece in pieces]),
            {each: n - counted[each] for each, n in self._counters.items()},
        )

    def _capture(self, function: Callable[[], None]) -> list[Callable[[], None]]:
        device = self._launch.device
        pieces = _OPEN[device] = []
        wp.capture_begin(device, force_module_load=False)
        try:
            function()
            pieces.append(_end(device))
        except BaseException:
            with suppress(RuntimeError):  # what went wrong may have ended the recording
                _end(device)
            raise
        finally:
            del _OPEN[device]
        return pieces
