"""Exchange of local results for nodes on the rim, while elements away from it are computed."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.simd.memory import pack, unpack
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.replay import between
from swe_sphere.ranks.communicator import Messages

Positions = Mapping[int, NDArray[Any]]
"""Positions (...) in an array by the rank that their numbers go to or come from."""


class Buffer:
    """Contiguous copy of the numbers at fixed positions of an array (n,), in memory MPI can read.

    Numbers of a GPU are copied through pinned host memory unless MPI can read GPU memory.
    """

    def __init__(self, launch: Launcher, array: wp.array, positions: Positions) -> None:
        device, on_cpu = str(array.device), array.device.is_cpu
        places = np.concatenate([*(p.ravel() for p in positions.values()), np.zeros(0, int)])
        kernels = launch.compile(array.dtype, pack, unpack)
        self._there = wp.empty(places.size, dtype=array.dtype, device=device)
        self._here = self._there
        if not launch.comm.reaches(device):
            self._here = wp.empty(places.size, dtype=array.dtype, device="cpu", pinned=not on_cpu)
        threads = 1 if on_cpu else places.size
        arguments = [array, wp.array(places, dtype=wp.int32, device=device), self._there, threads]
        launches = (partial(launch, each, threads, *arguments, on_rim=True) for each in kernels)
        self._pack, self._unpack = launches
        ends = np.cumsum([0, *(p.size for p in positions.values())], dtype=int).tolist()
        spans = zip(positions, ends, ends[1:], strict=False)
        self.of_rank = {rank: message(self._here[begin:end]) for rank, begin, end in spans}
        """The memory of each rank's numbers, as mpi4py accepts it."""
        self.bytes = int(places.size * array.strides[0])

    def pack(self) -> None:
        """Copy the numbers from their positions."""
        if self.of_rank:
            self._pack()
            if self._here is not self._there:
                wp.copy(self._here, self._there)

    def unpack(self) -> None:
        """Copy the numbers to their positions."""
        if self.of_rank:
            if self._here is not self._there:
                wp.copy(self._there, self._here)
            self._unpack()


def message(array: wp.array) -> Any:
    """Return an array as mpi4py accepts it: arrays of a CPU become numpy arrays."""
    return array.numpy() if array.device.is_cpu else array


class Halo:
    """Exchanges numbers at fixed positions of an array (n,) with other ranks.

    All ranks build their halos together. Consecutive positions are received in place if MPI can
    write there. MPI is called between the launches that a `Replay` records.
    """

    def __init__(
        self, launch: Launcher, flat: wp.array, sends: Positions, receives: Positions,
        into: wp.array | None = None,
    ) -> None:  # fmt: skip
        """Prepare the messages; a rank may send to itself.

        into: the array that receives, if it is not `flat`.
        """
        into, comm = flat if into is None else into, launch.comm
        self._device, self._on_gpu = str(flat.device), flat.device.is_cuda
        in_place, scattered = {}, {}
        for rank, places in receives.items():
            run = slice(int(places.min()), int(places.min()) + places.size)
            follow = np.array_equal(places.ravel(), np.arange(run.start, run.stop))
            if follow and comm.reaches(self._device):
                in_place[rank] = message(into[run])
            else:
                scattered[rank] = places
        self.going, self._coming = Buffer(launch, flat, sends), Buffer(launch, into, scattered)
        self._messages = Messages(comm, self.going.of_rank, in_place | self._coming.of_rank)

    def __call__(self) -> None:
        self.start()
        self.wait()

    def start(self) -> None:
        self.going.pack()
        between(self._device, self._start, on_rim=True)

    def wait(self) -> None:
        """Wait for the numbers of other ranks and copy them to their positions."""
        between(self._device, self._messages.wait, on_rim=True)
        self._coming.unpack()

    def _start(self) -> None:
        if self._on_gpu:
            wp.synchronize_device(self._device)  # the device may still be packing
        self._messages.start()
