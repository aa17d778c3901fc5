"""Notice that kernels are being compiled, printed after `PATIENCE` seconds of compiling."""

import functools
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE = 1.0
"""Seconds of compiling after which it is reported."""

COMPILING = "compiling kernels, the first time only ..."


def is_watched() -> bool:
    """Return whether stderr is a terminal or belongs to a notebook; False in child processes."""
    if multiprocessing.parent_process() is not None or sys.stderr is None:
        return False
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@functools.cache
def _report_once() -> None:
    if is_watched():
        sys.stderr.write(f"swe-sphere: {COMPILING}\n")


_taken = 0.0
"""Seconds that blocks of `mark_compiling` have taken."""
_report: Callable[[], None] = _report_once
"""Function called after `PATIENCE` seconds; only its first call has an effect."""


@contextmanager
def on_compile(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once, from another thread, if compiling in the block takes long."""
    global _report, _taken
    before, _report, _taken = (_report, _taken), functools.cache(call), 0.0
    try:
        yield
    finally:
        _report, _taken = before


@contextmanager
def mark_compiling() -> Iterator[None]:
    """Mark a block in which something is compiled."""
    global _taken
    timer, start = threading.Timer(max(0.0, PATIENCE - _taken), _report), time.perf_counter()
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        _taken += time.perf_counter() - start
