"""Between ranks: what elements leave for nodes on the rim."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.messages import message_kernel
from swe_sphere.kernels.vectors import packing_kernels
from swe_sphere.operators.launch import Launcher
from swe_sphere.parallel import Alone


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
    """Exchanges numbers at fixed positions of an array (n,) with other ranks.

    Only of arrays in the memory of a CPU.  What stands in one run there is received in place.
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
        runs = {rank: _run(places.ravel()) for rank, places in receives.items()}
        in_place = {rank: into.numpy()[run] for rank, run in runs.items() if run is not None}
        scattered = {rank: places for rank, places in receives.items() if runs[rank] is None}
        self._going, outgoing = _packed(comm, flat, sends)
        self._coming, incoming = _packed(comm, into, scattered)
        self._messages = comm.messages(outgoing, in_place | incoming)
        kernel = message_kernel()
        Launcher("cpu", comm).load(kernel)
        self._calls = [
            wp.array([*call, 0], dtype=wp.uint64, device="cpu")
            for call in (self._messages.start, self._messages.wait)
        ]
        self._start, self._wait = (
            wp.launch(kernel, 1, [call], device="cpu", record_cmd=True) for call in self._calls
        )

    def __call__(self) -> None:
        """Exchange them, or record that."""
        self.start()
        self.wait()

    def start(self) -> None:
        """Let those for the neighbours go, or record that."""
        self._going.pack()
        self._start.launch()

    def wait(self) -> None:
        """Until those of the neighbours are in their places, or record that."""
        self._wait.launch()
        if self._coming.numbers.size:
            self._coming.unpack()

    @property
    def exchanges(self) -> int:
        """So far."""
        return int(self._calls[0].numpy()[-1])

    @property
    def bytes_sent(self) -> int:
        """So far."""
        return self.exchanges * self._going.numbers.nbytes


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
