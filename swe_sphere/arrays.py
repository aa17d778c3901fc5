"""Types of numpy arrays of float64, int64 and int32, and the inverse of a permutation."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Int32 = NDArray[np.int32]


def inverse_permutation(order: NDArray[np.integer]) -> Int32:
    """Return the index (n,) at which each of 0 to n - 1 occurs in the permutation `order` (n,)."""
    places = np.empty(order.size, dtype=np.int32)
    places[order] = np.arange(order.size, dtype=np.int32)
    return places
