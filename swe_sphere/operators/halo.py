"""Between ranks: what elements leave for nodes on the rim."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.vectors import packing_kernels
from swe_sphere.operators.exchange import Exchange
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.replay import between
from swe_sphere.ranks.parallel import Alone


class Packed:
    """Numbers at fixed places (n,) of an array, brought to where messages take them from.

    All ranks make theirs together.  Those of a GPU go by way of the host, through memory that the
    GPU reaches by itself, unless MPI does.
    """

    def __init__(self, comm: Alone, x: wp.array, places: NDArray[Any]) -> None:
        device = str(x.device)
        in_threads = comm.waits(device)
        kernels = packing_kernels(x.dtype, in_threads)
        Launcher(device, comm).load(*kernels)
        self._room = wp.empty(places.size, dtype=x.dtype, device=device)
        self.numbers = self._room
        """(n,) for messages."""
        if not comm.reaches(device):
            pinned = not x.device.is_cpu
            self.numbers = wp.empty(places.size, dtype=x.dtype, device="cpu", pinned=pinned)
        arguments = [x, wp.array(places, dtype=wp.int32, device=device), self._room]
        threads = places.size if in_threads else 1
        self._pack, self._unpack = (
            wp.launch(kernel, threads, arguments, device=device, record_cmd=True)
            for kernel in kernels
        )

    def pack(self) -> None:
        """Bring them from their places."""
        if not self.numbers.size:
            return
        self._pack.launch()
        if self.numbers is not self._room:
            wp.copy(self.numbers, self._room)

    def unpack(self) -> None:
        """Bring them to their places."""
        if not self.numbers.size:
            return
        if self.numbers is not self._room:
            wp.copy(self._room, self.numbers)
        self._unpack.launch()


class Halo:
    """Exchanges numbers at fixed positions of an array (n,) with other ranks.

    What stands in one run there is received in place, if messages come from there.  On a CPU MPI is
    called by a kernel, among those that are recorded; on a GPU when it has done what came before.
    """

    def __init__(
        self,
        comm: Alone,
        flat: wp.array,
        sends: Mapping[int, NDArray[Any]],
        receives: Mapping[int, NDArray[Any]],
        into: wp.array | None = None,
    ) -> None:
        """sends, receives: positions (...) in the array, by rank; into: another one to receive."""
        into = flat if into is None else into
        self._device = str(flat.device)
        reached, self._waits = comm.reaches(self._device), comm.waits(self._device)
        runs = {rank: _run(places.ravel()) for rank, places in receives.items() if reached}
        in_place = {rank: into[run] for rank, run in runs.items() if run is not None}
        scattered = {rank: places for rank, places in receives.items() if rank not in in_place}
        self._going, outgoing = _packed(comm, flat, sends)
        self._coming, incoming = _packed(comm, into, scattered)
        self._bytes = int(self._going.numbers.size * flat.strides[0])
        self._exchange = Exchange(comm, outgoing, in_place | incoming)

    def __call__(self) -> None:
        """Exchange them, or record that."""
        self._going.pack()
        self._launch(self._exchange.start, self._exchange.wait)
        self._coming.unpack()

    def start(self) -> None:
        """Let those for the neighbours go, or record that."""
        self._going.pack()
        self._launch(self._exchange.start)

    def wait(self) -> None:
        """Until those of the neighbours are in their places, or record that."""
        self._launch(self._exchange.wait)
        self._coming.unpack()

    def _launch(self, *calls: Any) -> None:
        def when_ready() -> None:
            if self._exchange.start in calls:
                wp.synchronize_device(self._device)
            for call in calls:
                call.launch()

        if self._waits:
            between(self._device, when_ready)
        else:
            for call in calls:
                call.launch()

    @property
    def exchanges(self) -> int:
        """So far."""
        return self._exchange.count

    @property
    def bytes_sent(self) -> int:
        """So far."""
        return self.exchanges * self._bytes


def _run(places: NDArray[Any]) -> slice | None:
    """The places, where they stand one behind the other."""
    begin = int(places[0])
    together = np.array_equal(places, begin + np.arange(places.size))
    return slice(begin, begin + places.size) if together else None


def _packed(
    comm: Alone, flat: wp.array, places: Mapping[int, NDArray[Any]]
) -> tuple[Packed, dict[int, wp.array]]:
    """The numbers at all places, and those of each neighbour."""
    packed = Packed(
        comm, flat, np.concatenate([*(p.ravel() for p in places.values()), np.zeros(0, int)])
    )
    ends = np.cumsum([0, *(p.size for p in places.values())], dtype=int).tolist()
    parts = zip(places, ends, ends[1:], strict=False)
    return packed, {rank: packed.numbers[begin:end] for rank, begin, end in parts}
