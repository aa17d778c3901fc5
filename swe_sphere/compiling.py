"""Telling somebody that kernels are being compiled, once it has taken a while."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE = 1.0
"""Seconds of compiling after which one is told."""


class _Listener:
    """Is called once, when the blocks of `compiling` have taken so long together."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call, self._left = call, PATIENCE
        self._once = threading.Lock()

    @contextmanager
    def waiting(self) -> Iterator[None]:
        timer = threading.Timer(max(0.0, self._left), self._tell)
        timer.daemon = True
        start = time.perf_counter()
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._left -= time.perf_counter() - start
            if self._left <= 0.0:
                self._tell()

    def _tell(self) -> None:
        if self._once.acquire(blocking=False):
            self._call()


_listener: _Listener | None = None


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
    if _listener is None:
        yield
        return
    with _listener.waiting():
        yield
