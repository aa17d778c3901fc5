"""Launches that repeat: recorded once, then launched as a whole."""

from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import partial
from typing import Any

import warp as wp

from swe_sphere.operators.launch import REMEMBERED, Launcher

Pieces = list[Callable[[], None]]
"""What is launched one after the other: graphs of launches, and host functions between them."""


class Replay:
    """Records launches by a key: a CUDA graph on a GPU, a list in Warp's C++ on a CPU.

    On small meshes single launches cost more than their kernels.  `replay(key, block, *arguments)`
    runs the block the first time, which loads all kernels; it records and launches it the second
    time, and from then on it only launches the recording.  The block must make the same launches
    every time that the key is the same.  The key must name the addresses of all arrays of the
    caller; all others must live as long as the replay.  Replays inside the block only run their
    blocks: these launches belong to its recording.
    """

    def __init__(self, launch: Launcher, counters: dict[str, int] | None = None) -> None:
        """counters: what the blocks count beside their launches, if anything."""
        self._launch, self._counters = launch, {} if counters is None else counters
        self._known: dict[Hashable, tuple[Pieces, dict[str, int]] | None] = {}
        """The recordings by key, with what they add to counters; None after the first run."""

    def __call__(self, key: Hashable, block: Callable[..., None], *arguments: Any) -> None:
        """Launch the recording of the key, or run the block."""
        known = self._known.get(key)
        if not self._launch.records:
            block(*arguments)
        elif known is None:
            self._record(key, partial(block, *arguments))
        else:
            pieces, counters = known
            for piece in pieces:
                piece()
            for name, calls in counters.items():
                self._counters[name] += calls

    def _record(self, key: Hashable, block: Callable[[], None]) -> None:
        """Run the block the first time for a key, and record and launch it the second time."""
        first, counted, pieces = key not in self._known, dict(self._counters), Pieces()
        if first and len(self._known) >= REMEMBERED:
            self._known.clear()
        with self._launch.one_by_one():
            if first:
                block()
            else:
                pieces = _captured(self._launch.device, block)
        added = {name: n - counted.get(name, 0) for name, n in self._counters.items()}
        self._known[key] = None if first else (pieces, added)
        for piece in pieces:
            piece()


def recorded(
    launch: Launcher, function: Callable[[wp.array, wp.array], None]
) -> Callable[[wp.array, wp.array], None]:
    """Return a function (x, out) that only launches kernels, recorded for each pair of arrays."""
    replay = Replay(launch)
    return lambda x, out: replay((x.ptr, out.ptr), function, x, out)


_OPEN: dict[str, Pieces] = {}
"""Pieces of the recording in progress, by device."""


def between(device: str, function: Callable[[], None]) -> None:
    """Run a function on the host in its place among the launches on a device, recorded or not."""
    if device in _OPEN:
        _OPEN[device] += [_end(device), function]
        wp.capture_begin(device, force_module_load=False)
    else:
        function()


def _captured(device: str, block: Callable[[], None]) -> Pieces:
    """Return the pieces of a block, whose launches are recorded and not made."""
    pieces = _OPEN[device] = Pieces()
    wp.capture_begin(device, force_module_load=False)
    try:
        block()
        pieces.append(_end(device))
    except BaseException:
        with suppress(RuntimeError):  # what went wrong may have ended the recording
            _end(device)
        raise
    finally:
        del _OPEN[device]
    return pieces


def _end(device: str) -> Callable[[], None]:
    return partial(wp.capture_launch, wp.capture_end(device))
