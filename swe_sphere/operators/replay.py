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


_OPEN: "dict[str, _Recording]" = {}
"""Recording in progress, by device."""


def between(device: str, function: Callable[[], None], on_rim: bool = False) -> None:
    """Run a function on the host between the launches on a device, recorded or not.

    on_rim: True if it concerns the rim alone, so that launches over strips may run before it.
    """
    if device in _OPEN:
        _OPEN[device].insert(function, on_rim)
    else:
        function()


class _Recording:
    """Recording in progress: launches go into `pieces` instead of running."""

    def __init__(self, launch: Launcher, pieces: Pieces) -> None:
        self._launch, self._pieces = launch, pieces
        self._strips: StripLaunches | None = None  # unless other launches have followed them
        self._group: Callable[[], None] | None = None
        context, self._core = warp_internals(), None
        if context and wp.get_device(launch.device).is_cpu:
            launch.defer, self._core = self._defer, context.runtime.core

    def begin(self) -> None:
        wp.capture_begin(self._launch.device, force_module_load=False)
        self._launch.on_rim = 0

    def end(self) -> None:
        count = self._count()
        if count > self._launch.on_rim:
            self._strips = None
        graph = wp.capture_end(self._launch.device)
        if count:
            self._pieces.append(partial(wp.capture_launch, graph))

    def insert(self, function: Callable[[], None], on_rim: bool) -> None:
        """Put a function between the launches."""
        self.end()
        self._strips = self._strips if on_rim else None
        self._pieces.append(function)
        self.begin()

    def _count(self) -> int:
        """Return the number of launches since `begin`; 1 if it is unknown."""
        if (core := self._core) is None:
            return 1
        return int(core.wp_apic_get_operation_count(core.wp_apic_get_recording_state()))

    def _defer(self, known: tuple[Any, ...], cuts: Cuts) -> None:
        """Add a launch over strips to the preceding ones, if only the rim is between them."""
        if self._count() or not self._pieces or self._pieces[-1] is not self._group:
            self.end()
            self._strips = self._strips or StripLaunches(self._launch)
            self._group = self._strips.begin_group()
            self._pieces.append(self._group)
            self.begin()
        assert self._strips is not None
        self._strips.add(known, cuts)


@contextmanager
def _captured(launch: Launcher, pieces: Pieces) -> Iterator[None]:
    """Put the launches of the block into `pieces` instead of running them."""
    recording = _OPEN[launch.device] = _Recording(launch, pieces)
    try:
        recording.begin()
        yield
        recording.end()
    except BaseException:
        with suppress(RuntimeError):  # the error may have ended the recording
            wp.capture_end(launch.device)
        raise
    finally:
        launch.defer = None
        del _OPEN[launch.device]
