"""Work that is the same launches every time: recorded once, then launched as a whole."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass

import warp as wp

from swe_sphere.operators.launch import REMEMBERED, Launcher


@dataclass(frozen=True)
class _Recorded:
    """Pieces that are launched one after the other, and what they add to counters."""

    pieces: list[Callable[[], None]]
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
        if not self._launch.records:
            function()  # part of what is recorded as a whole
        elif (known := self._recorded.get(key)) is not None:
            for piece in known.pieces:
                piece()
            for name, calls in known.counters.items():
                self._counters[name] += calls
            instead()
        elif key in self._seen:
            self._seen.discard(key)
            recorded = self._recorded[key] = self._record(function)
            for piece in recorded.pieces:
                piece()
        else:
            if len(self._recorded) + len(self._seen) >= REMEMBERED:
                self._seen.clear()
                self._recorded.clear()
            with self._launch.one_by_one():
                function()
            self._seen.add(key)

    def _record(self, function: Callable[[], None]) -> _Recorded:
        counted = dict(self._counters)
        with self._launch.one_by_one():
            pieces = self._capture(function)
        added = {name: n - counted[name] for name, n in self._counters.items()}
        return _Recorded(pieces, added)

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
