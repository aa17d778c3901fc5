"""Arrays exchanged between ranks, in their place among launches that are recorded."""

from collections.abc import Mapping
from typing import Any

import warp as wp

from swe_sphere.kernels.messages import message_kernel
from swe_sphere.operators.launch import Launcher
from swe_sphere.ranks.parallel import Alone


class Exchange:
    """Of the same arrays again and again, which all ranks make together; MPI is called by a kernel.

    `start` and `wait` are launches on the CPU.
    """

    def __init__(
        self, comm: Alone, outgoing: Mapping[int, wp.array], incoming: Mapping[int, wp.array]
    ) -> None:
        """outgoing, incoming: by the other rank; a rank may send to itself."""
        kernel = message_kernel()
        Launcher("cpu", comm).load(kernel)
        self._messages = comm.messages(_memory(outgoing), _memory(incoming))
        self._begun, ended = (
            wp.array(call, dtype=wp.uint64, device="cpu")
            for call in (self._messages.start, self._messages.wait)
        )
        self.start, self.wait = (
            wp.launch(kernel, 1, [call], device="cpu", record_cmd=True)
            for call in (self._begun, ended)
        )

    @property
    def count(self) -> int:
        """How many there were so far."""
        return int(self._begun.numpy()[0])


def _memory(arrays: Mapping[int, wp.array]) -> dict[int, Any]:
    """As mpi4py takes it: it knows arrays of numpy, and those of GPUs as they are."""
    return {r: array.numpy() if array.device.is_cpu else array for r, array in arrays.items()}
