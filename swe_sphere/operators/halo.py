"""Between ranks: what elements leave for nodes on the rim."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.vectors import packing_kernels
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.replay import between
from swe_sphere.ranks.parallel import Alone


class Packed:
    """Numbers at fixed places (n,) of an array, brought to where messages take them from.

    Those of a GPU go by way of the host, through memory that the GPU reaches by itself, unless MPI
    reaches the memory of the GPU.
    """

    def __init__(self, comm: Alone, x: wp.array, places: NDArray[Any]) -> None:
        device = str(x.device)
        in_threads = not x.device.is_cpu
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

    All ranks build theirs together.  Positions that follow one another are received in place, if
    MPI reaches them.  MPI is called between the launches that a `Replay` records.
    """

    def __init__(
        self,
        comm: Alone,
        flat: wp.array,
        sends: Mapping[int, NDArray[Any]],
        receives: Mapping[int, NDArray[Any]],
        into: wp.array | None = None,
    ) -> None:
        """Prepare the messages; a rank may send to itself.

        sends, receives: positions (...) in the array by rank; into: the array to receive in, if it
        is not `flat`.
        """
        into = flat if into is None else into
        self._device = str(flat.device)
        reached = comm.reaches(self._device)
        runs = {rank: _run(places.ravel()) for rank, places in receives.items() if reached}
        in_place = {rank: into[run] for rank, run in runs.items() if run is not None}
        scattered = {rank: places for rank, places in receives.items() if rank not in in_place}
        self._going, outgoing = _packed(comm, flat, sends)
        self._coming, incoming = _packed(comm, into, scattered)
        self._messages = comm.messages(_memory(outgoing), _memory(in_place | incoming))
        self._bytes = int(self._going.numbers.size * flat.strides[0])
        self.exchanges = 0
        """Number of exchanges so far."""

    def __call__(self) -> None:
        """Exchange the numbers."""
        self._going.pack()
        between(self._device, self._exchange)
        self._coming.unpack()

    def start(self) -> None:
        """Send this rank's numbers; launches until `wait` must not change them."""
        self._going.pack()
        between(self._device, self._start)

    def wait(self) -> None:
        """Bring the numbers of other ranks to their positions when they have arrived."""
        between(self._device, self._messages.wait)
        self._coming.unpack()

    def _start(self) -> None:
        wp.synchronize_device(self._device)
        self._messages.start()
        self.exchanges += 1

    def _exchange(self) -> None:
        self._start()
        self._messages.wait()

    @property
    def bytes_sent(self) -> int:
        """Number of bytes that this rank has sent so far."""
        return self.exchanges * self._bytes


def _memory(arrays: Mapping[int, wp.array]) -> dict[int, Any]:
    """Return the arrays as mpi4py accepts them: those of a CPU as numpy arrays."""
    return {r: array.numpy() if array.device.is_cpu else array for r, array in arrays.items()}


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
