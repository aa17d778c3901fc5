"""Repeated sequences of launches: recorded once, then launched as a whole."""

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from typing import Any

import warp as wp

from swe_sphere.operators.launch import MOST_CACHED, Cuts, Launcher, warp_internals
from swe_sphere.operators.strips import StripLaunches

Pieces = list[Callable[[], None]]
"""Sequence of graphs of launches, with host functions between them."""


class Replay:
    """Records launches by a key: a CUDA graph on a GPU, a list in Warp's C++ on a CPU.

    On small meshes single launches cost more than their kernels. `replay(key, block, *arguments)`
    runs the block the first time, which loads all kernels; it records and launches it the second
    time, and from then on it only launches the recording. `launch` and `record` do the same for the
    block of a `with` statement. The block must make the same launches every time that the key is
    the same. The key must contain the addresses of all arrays of the caller; all other arrays must
    live as long as the replay. Replays inside the block run their blocks, as parts of this one.
    """

    def __init__(self, launch: Launcher, counters: dict[str, float] | None = None) -> None:
        """Create a replay; blocks may increase `counters`, which recordings increase as well."""
        self._launch, self._counters = launch, {} if counters is None else counters
        self._known: dict[Hashable, tuple[Pieces, dict[str, float]] | None] = {}
        """The recordings by key, with what they add to counters; None after the first run."""

    def __call__(self, key: Hashable, block: Callable[..., None], *arguments: Any) -> None:
        """Launch the recording of the key, or run the block."""
        if not self.launch(key):
            with self.record(key):
                block(*arguments)

    def launch(self, key: Hashable) -> bool:
        """Launch the recording of the key; return False if there is none."""
        if (known := self._known.get(key)) is None or not self._launch.records:
            return False
        pieces, counters = known
        for piece in pieces:
            piece()
        for name, calls in counters.items():
            self._counters[name] += calls
        return True

    @contextmanager
    def record(self, key: Hashable) -> Iterator[None]:
        """Run the block of the `with` statement; the second time, record and launch it."""
        if not self._launch.records:
            yield
            return
        first, counted, pieces = key not in self._known, dict(self._counters), Pieces()
        if first and len(self._known) >= MOST_CACHED:
            self._known.clear()
        self._launch.records = False  # in the block
        try:
            with nullcontext() if first else _captured(self._launch, pieces):
                yield
        finally:
            self._launch.records = True
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
    """Run a function on the host between the launches on a device, recorded or not."""
    if device in _OPEN:
        _OPEN[device] += [_end(device), function]
        wp.capture_begin(device, force_module_load=False)
    else:
        function()


@contextmanager
def _captured(launch: Launcher, pieces: Pieces) -> Iterator[None]:
    """Put the launches of the block into `pieces` instead of running them."""
    device = launch.device
    _OPEN[device] = pieces
    if context := warp_internals():
        launch.defer = partial(_defer, context.runtime.core, launch, pieces)
    try:
        wp.capture_begin(device, force_module_load=False)
        yield
        pieces.append(_end(device))
    except BaseException:
        with suppress(RuntimeError):  # the error may have ended the recording
            _end(device)
        raise
    finally:
        launch.defer = None
        del _OPEN[device]


def _defer(core: Any, launch: Launcher, pieces: Pieces, known: tuple[Any, ...], cuts: Cuts) -> None:
    """Add a launch over strips to the preceding ones, if nothing is between them."""
    last = pieces[-1] if pieces else None
    others = core.wp_apic_get_operation_count(core.wp_apic_get_recording_state())
    if others or not isinstance(last, StripLaunches):
        last = StripLaunches(launch)
        between(launch.device, last)
    last.add(known, cuts)


def _end(device: str) -> Callable[[], None]:
    return partial(wp.capture_launch, wp.capture_end(device))
