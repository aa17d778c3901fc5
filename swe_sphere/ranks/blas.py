"""The libraries of linear algebra behind numpy and scipy, and their threads."""

import os
import sys
from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries(scipy: bool) -> ThreadpoolController:
    """The BLAS libraries loaded by now: scipy brings its own when it is first needed."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Within the block BLAS keeps to one thread; afterwards it has as many as before.

    numpy's and scipy's BLAS each spin on threads of their own: together fifty times slower.
    """
    libraries = _libraries("scipy.linalg" in sys.modules)
    limited: AbstractContextManager[object] = libraries.limit(limits=1, user_api="blas")
    return limited


def keep_to_one_thread() -> None:
    """One thread for good, those of libraries that are yet to be loaded too, unless told otherwise.

    For a process beside others, each of which has a core of its own: spinning threads of all of
    them would wait for each other.
    """
    if os.environ.setdefault("OPENBLAS_NUM_THREADS", "1") == "1":
        ThreadpoolController().limit(limits=1, user_api="blas")
