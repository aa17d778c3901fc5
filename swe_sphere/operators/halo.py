"""What the elements of other ranks leave for the nodes on the rim, fetched before DSS."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.parallel import Alone


class Halo:
    """Exchanges numbers at fixed positions of one array (n,) with the neighbours of a rank.

    Only of an array in the memory of a CPU.
    """

    def __init__(
        self,
        comm: Alone,
        flat: wp.array,
        sends: Mapping[int, NDArray[Any]],
        receives: Mapping[int, NDArray[Any]],
    ) -> None:
        """sends, receives: positions (...) in the array, by neighbour."""
        self._flat = flat.numpy()
        self._going, self._out, outgoing = _room(sends, self._flat.dtype)
        self._coming, self._in, incoming = _room(receives, self._flat.dtype)
        self._channel = comm.channel(outgoing, incoming)

    def __call__(self) -> int:
        """Exchange them; returns how many bytes this rank has sent."""
        np.take(self._flat, self._going, out=self._out, mode="clip")
        self._channel.start()
        self._channel.wait()
        self._flat[self._coming] = self._in
        return self._out.nbytes


def _room(
    positions: Mapping[int, NDArray[Any]], dtype: Any
) -> tuple[NDArray[Any], NDArray[Any], dict[int, NDArray[Any]]]:
    """All positions, room for as many numbers, and that of each neighbour."""
    everything = np.concatenate([*(p.ravel() for p in positions.values()), np.zeros(0, np.int64)])
    room = np.empty(everything.size, dtype)
    ends = np.cumsum([p.size for p in positions.values()], dtype=int)
    return everything, room, dict(zip(positions, np.split(room, ends[:-1]), strict=False))
