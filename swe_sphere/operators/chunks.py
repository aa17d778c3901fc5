"""The pieces of a mesh by which sums are taken, in the same order for any number of ranks."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.mesh.partition import Part
from swe_sphere.parallel import Alone


class Chunks:
    """Pieces of the nodes of this rank; partial sums of all ranks are added up on the host.

    A single process cuts the nodes, as they stand in memory, into pieces of equal length.
    """

    def __init__(self, part: Part, comm: Alone, device: str) -> None:
        starts = part.starts
        if not comm.shared:
            size = part.nodes.size
            span = math.isqrt(size) + 1
            starts = np.minimum(span * np.arange(-(-size // span) + 1), size)[None]
        self._comm, self.count = comm, starts.shape[1] - 1
        self.starts = wp.array(starts, dtype=wp.int32, device=device)
        """(kinds, count + 1): a chunk is the nodes from starts[k, c] to starts[k, c + 1], all k."""
        self._counts = comm.tell_all(self.count)
        self.total = sum(self._counts)
        """Of all ranks."""
        self._rooms: dict[int, tuple[list[int], NDArray[Any]]] = {}

    def of_all(self, partial: NDArray[Any]) -> NDArray[Any]:
        """Float64 sums (count, ...) of the chunks of all ranks, which the next call overwrites."""
        if not self._comm.shared:
            return partial
        width = partial[:1].size
        if width not in self._rooms:
            counts = [width * count for count in self._counts]
            self._rooms[width] = counts, np.empty((self.total, width))
        self._comm.gather(partial, *self._rooms[width])
        return self._rooms[width][1].reshape(-1, *partial.shape[1:])
