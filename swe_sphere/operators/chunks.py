"""Sums over the nodes of all ranks that have the same bits for any number of ranks.

Each chunk of nodes has a separate sum, and the sums of all chunks are added along a binary tree: in
pairs, pairs of pairs and so on. A rank sends the sums of the largest branches that lie entirely on
it, which are few, and every rank adds them to the same total.
"""

import functools
import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels.simd.sums import tree
from swe_sphere.mesh.partition import MeshPart
from swe_sphere.operators.launch import Launcher


class Chunks:
    """Chunks of the nodes of this rank, and sums over the chunks of all ranks.

    A single process cuts its nodes, in the order of memory, into chunks of equal length.
    """

    def __init__(self, part: MeshPart, launch: Launcher) -> None:
        size, comm, device = part.node_numbers.size, launch.comm, launch.device
        spans = part.spans if comm.shared else equal_spans(size, math.isqrt(size) + 1)
        self._comm, self.count = comm, spans.shape[1]
        self._launch = launch if device == "cpu" else Launcher("cpu", comm)
        self.spans = wp.array(spans, dtype=wp.int32, device=device)
        """(kinds, count, 2): chunk c holds nodes spans[k, c, 0] to spans[k, c, 1] for all k."""
        ends = np.cumsum([0, *comm.allgather(self.count)])
        chunks = np.arange(*ends[comm.rank : comm.rank + 2])
        self._leaves = np.stack([chunks, np.ones_like(chunks)], axis=-1)
        self._branches = [branches(*ends[rank : rank + 2]) for rank in range(comm.size)]
        self._trees = functools.cache(self._build_trees)

    def partial_sums(self, width: int) -> Array:
        """Return the array (count, width) to fill with sums over each chunk of this rank."""
        return self._trees(width)[0][0]

    def total(self, width: int) -> Array:
        """Return the total (width,) of `partial_sums` over all ranks, valid until the next call."""
        (mine, add_up_mine), (everything, add_up) = self._trees(width)
        add_up_mine.launch()
        counts = [width * len(each) for each in self._branches]
        sent = mine.reshape(-1)[: counts[self._comm.rank]]
        self._comm.allgather_arrays(sent, counts, everything.reshape(-1))
        add_up.launch()
        return np.asarray(everything[0])

    def _build_trees(self, width: int) -> "list[tuple[Array, wp.Launch]]":
        """Return the tree above the chunks of this rank, and the tree above all branches.

        Each is a pair of the sums (n, width) and a command that adds them in place: to the sums of
        the largest branches, or to the total.
        """
        (kernel,), trees = self._launch.compile(wp.float64, tree), []
        for is_whole, nodes in enumerate((self._leaves, np.concatenate(self._branches))):
            sums = wp.zeros((len(nodes), width), dtype=wp.float64, device="cpu")
            inputs = [wp.array(nodes, dtype=wp.int32, device="cpu"), is_whole, sums]
            add_up = wp.launch(kernel, 1, inputs, device="cpu", record_cmd=True)
            trees.append((sums.numpy(), add_up))
        return trees


def branches(first: int, behind: int) -> NDArray[np.int64]:
    """Return (n, 2) first leaves and sizes of the largest whole branches of a binary tree.

    They cover leaves from `first` to before `behind`; one of 2^k begins at a multiple of 2^k.
    """
    found: list[tuple[int, int]] = []
    while first < behind:
        largest = 1 << (int(behind - first).bit_length() - 1)
        size = min(largest, int(first) & -int(first) or largest)
        found.append((first, size))
        first += size
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def equal_spans(size: int, length: int) -> NDArray[np.int64]:
    """Return begins and ends (1, k, 2) of spans of `length` that cut `size` numbers."""
    begins = np.arange(0, size, length)
    return np.stack([begins, np.minimum(begins + length, size)], axis=-1)[None]
