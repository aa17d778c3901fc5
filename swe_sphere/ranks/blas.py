"""Threads of the BLAS libraries behind numpy and scipy."""

import os
import sys
from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries(scipy: bool) -> ThreadpoolController:
    """Return the BLAS libraries loaded so far; scipy loads its own with `scipy.linalg`."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Limit BLAS to one thread within a block.

    The libraries of numpy and scipy each have threads that spin: together fifty times slower.
    """
    libraries = _libraries("scipy.linalg" in sys.modules)
    limited: AbstractContextManager[object] = libraries.limit(limits=1, user_api="blas")
    return limited


def keep_to_one_thread() -> None:
    """Limit BLAS to one thread in this process, unless OPENBLAS_NUM_THREADS says otherwise.

    The limit holds for libraries loaded later, too.  Processes that share a machine need it: their
    spinning threads would wait for each other.
    """
    if os.environ.setdefault("OPENBLAS_NUM_THREADS", "1") == "1":
        ThreadpoolController().limit(limits=1, user_api="blas")
