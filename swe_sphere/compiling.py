"""Report that kernels are being compiled, once that has taken a while."""

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE = 1.0
"""Seconds of compiling after which it is reported."""

COMPILING = "compiling kernels, the first time only ..."


def tell_of_compiling() -> None:
    """Print one line on stderr."""
    sys.stderr.write(f"swe-sphere: {COMPILING}\n")


class _Listener:
    """Calls a function once, when the blocks of `compiling` together have taken so long."""

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
"""Listener of the program; None in a Python session, for which `_of_session` stands in."""
_of_session = _Listener(tell_of_compiling)


def is_watched() -> bool:
    """Return whether stderr of this very process is a terminal, or belongs to a notebook."""
    if multiprocessing.parent_process() is not None or sys.stderr is None:
        return False
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def on_compile(call: Callable[[], None]) -> Iterator[None]:
    """Within the block, call a function once, from another thread, if compiling takes long."""
    global _listener
    before, _listener = _listener, _Listener(call)
    try:
        yield
    finally:
        _listener = before


@contextmanager
def compiling() -> Iterator[None]:
    """Mark a block in which something is compiled."""
    listener = _of_session if _listener is None and is_watched() else _listener
    if listener is None:
        yield
        return
    with listener.waiting():
        yield
