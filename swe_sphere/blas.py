"""The libraries of linear algebra behind numpy and scipy, and their threads."""

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
