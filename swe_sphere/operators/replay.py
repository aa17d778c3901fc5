"""Launches that repeat: recorded once, then launched as a whole."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial

import warp as wp

from swe_sphere.operators.launch import REMEMBERED, Launcher


@dataclass(frozen=True)
class _Recorded:
    """Pieces that are launched one after the other, and what they add to counters."""

    pieces: list[Callable[[], None]]
    counters: dict[str, int]


class Replay:
    """Records launches by a key: a CUDA graph on a GPU, a list in Warp's C++ on a CPU.

    On small meshes single launches cost more than their kernels.  A caller writes

        if not replay(key):
            with replay.record(key):
                ...

    where the block makes the same launches every time that the key is the same.  The key must name
    the addresses of all arrays of the caller; all others must live as long as the replay.  Replays
    inside the block do nothing: their launches belong to its recording.
    """

    def __init__(self, launch: Launcher, counters: dict[str, int] | None = None) -> None:
        """counters: what the blocks count beside their launches, if anything."""
        self._launch, self._counters = launch, {} if counters is None else counters
        self._known: dict[Hashable, _Recorded | None] = {}
        """The recordings by key; None after the first run, which loads all kernels."""

    def __call__(self, key: Hashable) -> bool:
        """Launch the recording of the key; return False where the caller has to run the block."""
        known = self._known.get(key)
        if known is None or not self._launch.records:
            return False
        for piece in known.pieces:
            piece()
        for name, calls in known.counters.items():
            self._counters[name] += calls
        return True

    @contextmanager
    def record(self, key: Hashable) -> Iterator[None]:
        """Run the block the first time for a key, and record and launch it the second time."""
        if not self._launch.records:
            yield
            return
        first = key not in self._known
        if first and len(self._known) >= REMEMBERED:
            self._known.clear()
        counted, pieces = dict(self._counters), list[Callable[[], None]]()
        with self._launch.one_by_one():
            if first:
                yield
            else:
                with _captured(self._launch.device, pieces):
                    yield
        added = {name: n - counted.get(name, 0) for name, n in self._counters.items()}
        self._known[key] = None if first else _Recorded(pieces, added)
        for piece in pieces:
            piece()


def recorded(
    launch: Launcher, function: Callable[[wp.array, wp.array], None]
) -> Callable[[wp.array, wp.array], None]:
    """Return a function (x, out) that only launches kernels, recorded for each pair of arrays."""
    replay = Replay(launch)

    def launched(x: wp.array, out: wp.array) -> None:
        key = x.ptr, out.ptr
        if not replay(key):
            with replay.record(key):
                function(x, out)

    return launched


_OPEN: dict[str, list[Callable[[], None]]] = {}
"""Pieces of the recording in progress, by device: graphs, and host functions between them."""


def between(device: str, function: Callable[[], None]) -> None:
    """Run a function on the host in its place among the launches on a device, recorded or not."""
    if device in _OPEN:
        _OPEN[device] += [_end(device), function]
        wp.capture_begin(device, force_module_load=False)
    else:
        function()


@contextmanager
def _captured(device: str, pieces: list[Callable[[], None]]) -> Iterator[None]:
    """Put the launches of the block into `pieces` instead of making them."""
    _OPEN[device] = pieces
    wp.capture_begin(device, force_module_load=False)
    try:
        yield
        pieces.append(_end(device))
    except BaseException:
        with suppress(RuntimeError):  # what went wrong may have ended the recording
            _end(device)
        raise
    finally:
        del _OPEN[device]


def _end(device: str) -> Callable[[], None]:
    graph = wp.capture_end(device)
    return partial(wp.capture_launch, graph)
