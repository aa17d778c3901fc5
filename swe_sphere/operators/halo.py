"""Between ranks: what elements leave for nodes on the rim, and chunks by which sums are taken."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.vectors import packing_kernels
from swe_sphere.mesh.partition import Part
from swe_sphere.operators.launch import Launcher
from swe_sphere.parallel import Alone


class Chunks:
    """Pieces of the nodes of this rank; partial sums of all ranks are added up on the host.

    A single process cuts the nodes, as they stand in memory, into pieces of equal length.
    """

    def __init__(self, part: Part, comm: Alone, device: str) -> None:
        size = part.nodes.size
        spans = part.spans if comm.shared else equal_spans(size, math.isqrt(size) + 1)
        self._comm, self.count = comm, spans.shape[1]
        self.spans = wp.array(spans, dtype=wp.int32, device=device)
        """(kinds, count, 2): a chunk is the nodes from spans[k, c, 0] to spans[k, c, 1], all k."""
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


def equal_spans(size: int, length: int) -> NDArray[np.int64]:
    """(1, k, 2) where pieces of so many of `size` numbers begin and end, the last shorter."""
    begins = np.arange(0, size, length)
    return np.stack([begins, np.minimum(begins + length, size)], axis=-1)[None]


class Packed:
    """Numbers at fixed places (n,) of an array on the CPU, brought to an array of their own.

    All ranks make theirs together.
    """

    def __init__(self, comm: Alone, x: wp.array, places: NDArray[Any]) -> None:
        kernels = packing_kernels(x.dtype)
        Launcher("cpu", comm).load(kernels.pack, kernels.unpack)
        room = wp.empty(places.size, dtype=x.dtype, device="cpu")
        arguments = [x, wp.array(places, dtype=wp.int32, device="cpu"), room]
        self.numbers: NDArray[Any] = room.numpy()
        self._commands = [
            wp.launch(kernel, 1, arguments, device="cpu", record_cmd=True)
            for kernel in (kernels.pack, kernels.unpack)
        ]

    def pack(self) -> None:
        """Bring them from their places."""
        self._commands[0].launch()

    def unpack(self) -> None:
        """Bring them to their places."""
        self._commands[1].launch()


class Halo:
    """Exchanges numbers at fixed positions of one array (n,) with the neighbours of a rank.

    Only of an array in the memory of a CPU.  What stands in one run there is received in place.
    """

    def __init__(
        self,
        comm: Alone,
        flat: wp.array,
        sends: Mapping[int, NDArray[Any]],
        receives: Mapping[int, NDArray[Any]],
    ) -> None:
        """sends, receives: positions (...) in the array, by neighbour."""
        runs = {rank: _run(places.ravel()) for rank, places in receives.items()}
        in_place = {rank: flat.numpy()[run] for rank, run in runs.items() if run is not None}
        scattered = {rank: places for rank, places in receives.items() if runs[rank] is None}
        self._comm, self.bytes_sent = comm, 0
        self._going, outgoing = _packed(comm, flat, sends)
        self._coming, incoming = _packed(comm, flat, scattered)
        self._scattered = bool(scattered)
        self._channel = comm.channel(outgoing, in_place | incoming)

    def start(self) -> None:
        """Let those for the neighbours go, or record that."""
        self._going.pack()
        self._comm.do(self._channel.start)

    def wait(self) -> None:
        """Until those of the neighbours are in their places, or record that."""
        self._comm.do(self._wait)
        if self._scattered:
            self._coming.unpack()

    def _wait(self) -> None:
        self._channel.wait()
        self.bytes_sent += self._going.numbers.nbytes


def _run(places: NDArray[Any]) -> slice | None:
    """The places, where they stand one behind the other."""
    begin = int(places[0])
    together = np.array_equal(places, begin + np.arange(places.size))
    return slice(begin, begin + places.size) if together else None


def _packed(
    comm: Alone, flat: wp.array, places: Mapping[int, NDArray[Any]]
) -> tuple[Packed, dict[int, NDArray[Any]]]:
    """The numbers at all places, and those of each neighbour."""
    packed = Packed(
        comm, flat, np.concatenate([*(p.ravel() for p in places.values()), np.zeros(0, int)])
    )
    ends = np.cumsum([p.size for p in places.values()], dtype=int)
    return packed, dict(zip(places, np.split(packed.numbers, ends[:-1]), strict=False))
