"""Telling somebody that kernels are being compiled, once it has taken a while."""

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

PATIENCE = 1.0
"""Seconds of compiling after which one is told."""

COMPILING = "compiling kernels, the first time only ..."


def tell_of_compiling() -> None:
    """In one line on stderr."""
    sys.stderr.write(f"swe-sphere: {COMPILING}\n")


class _Listener:
    """Is called once, when the blocks of `compiling` have taken so long together."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call, self._taken = call, 0.0
        self._once = threading.Lock()

    @contextmanager
    def waiting(self) -> Iterator[None]:
        timer = threading.Timer(max(0.0, PATIENCE - self._taken), self._tell)
        timer.daemon = True
        start = time.perf_counter()
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._taken += time.perf_counter() - start
            if self._taken >= PATIENCE:
                self._tell()

    def _tell(self) -> None:
        if self._once.acquire(blocking=False):
            self._call()


_listener: _Listener | None = None
"""Of the program; a Python session is told by `_by_itself`."""

_by_itself = _Listener(tell_of_compiling)


def is_watched() -> bool:
    """Return whether stderr of this very process is a terminal, or it is that of a notebook."""
    if multiprocessing.parent_process() is not None or sys.stderr is None:
        return False
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def on_compile(call: Callable[[], None]) -> Iterator[None]:
    """Within the block the call is made once, from another thread, where compiling takes long."""
    global _listener
    before, _listener = _listener, _Listener(call)
    try:
        yield
    finally:
        _listener = before


@contextmanager
def compiling() -> Iterator[None]:
    """Something is compiled within the block."""
    listener = _by_itself if _listener is None and is_watched() else _listener
    with nullcontext() if listener is None else listener.waiting():
        yield
