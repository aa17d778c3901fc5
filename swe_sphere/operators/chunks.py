"""Sums over the nodes of all ranks, with the same bits however many ranks there are.

Each chunk of nodes has a sum of its own, and those of all chunks are added up in pairs, pairs of
pairs and so on: a binary tree.  A rank sends the sums of the largest branches that it has all of,
of which there are few, and every rank adds them up to the same sum.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.sums import tree_kernel
from swe_sphere.mesh.partition import Part
from swe_sphere.operators.launch import Launcher
from swe_sphere.ranks.parallel import Alone


class Chunks:
    """Pieces of the nodes of this rank, and the sum of what all ranks have of theirs.

    A single process cuts the nodes, as they stand in memory, into pieces of equal length.
    """

    def __init__(self, part: Part, comm: Alone, device: str) -> None:
        size = part.nodes.size
        spans = part.spans if comm.shared else equal_spans(size, math.isqrt(size) + 1)
        self._comm, self.count = comm, spans.shape[1]
        self.spans = wp.array(spans, dtype=wp.int32, device=device)
        """(kinds, count, 2): a chunk is the nodes from spans[k, c, 0] to spans[k, c, 1], all k."""
        ends = np.cumsum([0, *comm.tell_all(self.count)])
        self.branches = [branches(*ends[rank : rank + 2]) for rank in range(comm.size)]
        """(n, 2) the first chunk and the size of those that each rank has all of."""
        self._first = int(ends[comm.rank])
        self._rooms: dict[int, _Room] = {}

    def room(self, width: int) -> NDArray[np.float64]:
        """(count, width) for the sums of the chunks of this rank."""
        return self._room(width).mine

    def total(self, width: int) -> NDArray[np.float64]:
        """Sums (width,) of what all ranks have put into their rooms, valid until the next call."""
        room = self._room(width)
        room.up.launch()
        self._comm.gather(room.sent, room.counts, room.told)
        room.down.launch()
        return room.told[:width]

    def _room(self, width: int) -> "_Room":
        if width not in self._rooms:
            comm = self._comm
            leaves = np.stack([self._first + np.arange(self.count), np.ones(self.count)], axis=-1)
            mine, up = _adding(leaves, width, comm, False)
            told, down = _adding(np.concatenate(self.branches), width, comm, True)
            counts = [width * len(each) for each in self.branches]
            sent, everything = mine.flatten()[: counts[comm.rank]], told.flatten()
            self._rooms[width] = _Room(
                mine.numpy(), up, sent.numpy(), counts, everything.numpy(), down
            )
        return self._rooms[width]


@dataclass(frozen=True)
class _Room:
    """Room for so many sums, and the commands that add up what is in it."""

    mine: NDArray[np.float64]
    up: Any
    sent: NDArray[np.float64]
    counts: list[int]
    told: NDArray[np.float64]
    down: Any


def _adding(nodes: NDArray[Any], width: int, comm: Alone, whole: bool) -> tuple[wp.array, Any]:
    """Room (n, width) for the sums of nodes (n, 2) of the tree, and what adds them up in it."""
    kernel = tree_kernel()
    Launcher("cpu", comm).load(kernel)
    room = wp.zeros((len(nodes), width), dtype=wp.float64, device="cpu")
    inputs = [wp.array(nodes, dtype=wp.int32, device="cpu"), int(whole), room]
    return room, wp.launch(kernel, 1, inputs, device="cpu", record_cmd=True)


def branches(first: int, behind: int) -> NDArray[np.int64]:
    """(n, 2) beginnings and sizes of the largest whole branches of a binary tree over some leaves.

    Those from `first` to before `behind`; a branch of 2^k leaves begins at a multiple of 2^k.
    """
    found: list[tuple[int, int]] = []
    while first < behind:
        largest = 1 << (int(behind - first).bit_length() - 1)
        size = min(largest, int(first) & -int(first) or largest)
        found.append((first, size))
        first += size
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def equal_spans(size: int, length: int) -> NDArray[np.int64]:
    """(1, k, 2) where pieces of so many of `size` numbers begin and end, the last shorter."""
    begins = np.arange(0, size, length)
    return np.stack([begins, np.minimum(begins + length, size)], axis=-1)[None]
