"""Communication between the ranks of a run: a single process, or the processes that MPI started.

Each rank holds the whole mesh on the host and steps its part of it. Every rank decides for itself
from the same numbers: decisions agree because the numbers have the same bits on all ranks.
"""

import atexit
import ctypes
import functools
import math
import os
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.ranks.limits import keep_to_one_thread

T = TypeVar("T")

SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE", "PMI_SIZE")
"""Environment variables in which a launcher states the number of ranks."""
RANK_VARIABLES = "PMI_RANK", "OMPI_COMM_WORLD_RANK", "MV2_COMM_WORLD_RANK", "PMIX_RANK"
"""Environment variables in which a launcher states the rank of a process."""
PRINT_RANK, RANK_PREFIX = "SWE_SPHERE_NAMED_RANKS", "swe-sphere rank: "
"""Variable that makes each rank print its number and process, and the prefix of that line."""
PATIENCE = 4.0
"""Seconds that a failing rank waits for the others to fail too."""

Arrays = Mapping[int, Any]
"""Arrays of this rank by the rank that they go to or come from: of numpy, or of Warp on a GPU."""


class Messages:
    """Repeated messages between the same arrays: persistent requests of MPI."""

    def __init__(self, ranks: "Communicator", outgoing: Arrays, incoming: Arrays) -> None:
        """Prepare one message for each array; only for ranks under MPI."""
        from mpi4py.MPI import Prequest

        requests = [ranks.comm.Recv_init(array, rank) for rank, array in incoming.items()]
        requests += [ranks.comm.Send_init(array, rank) for rank, array in outgoing.items()]
        weakref.finalize(self, lambda: [*map(Prequest.Free, requests)])
        self.start = functools.partial(Prequest.Startall, requests)
        """Function that sends all arrays, which must not change before `wait`, and receives."""
        self._are_complete = functools.partial(Prequest.Testall, requests)

    def wait(self) -> None:
        """Return when all arrays have been sent and received."""
        _complete(self._are_complete)


def _complete(test: Callable[[], bool], patience: float = math.inf) -> bool:
    """Poll until the test holds, at most `patience` seconds; return whether it holds.

    MPI itself polls without pause and would take the core from ranks that have work to do.
    """
    began = time.monotonic()
    while not test():
        waited = time.monotonic() - began
        if waited > patience:
            return False
        if waited > 0.001:
            time.sleep(0.0001)
        else:
            os.sched_yield()
    return True


class Communicator:
    """The communicator of a single process, or of all ranks that MPI started.

    mpi: the module `mpi4py.MPI`; None for a single process, where all communication is trivial.
    """

    def __init__(self, mpi: Any = None) -> None:
        self.rank, self.size, self.local = 0, 1, 0
        """Number of this rank, number of ranks, and number of this rank on its machine."""
        self.shared = mpi is not None
        """True if MPI shares the mesh between ranks, of which there may be one."""
        if mpi is None:
            return
        keep_to_one_thread()
        # messages of callers on COMM_WORLD must not meet those of the halo
        self._mpi, self.comm = mpi, mpi.COMM_WORLD.Dup()
        self._failures = self.comm.Dup()
        self.rank, self.size = self.comm.rank, self.comm.size
        if os.environ.pop(PRINT_RANK, None):
            sys.stderr.write(f"{RANK_PREFIX}{self.rank} {os.getpid()}\n")
        self.local = self.comm.Split_type(mpi.COMM_TYPE_SHARED).rank
        self._asked: Any = None
        self._sent, self._received = np.zeros(1, np.int8), np.zeros(1, np.int8)
        atexit.register(self._settle)
        self._previous_hook, sys.excepthook = sys.excepthook, self._fail
        threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()

    def reaches(self, device: str) -> bool:
        """Return whether messages need no copies between a device and the host.

        MPI always reaches the memory of CPUs, and that of GPUs if it was built for them.
        """
        if not self.shared or device == "cpu":
            return True
        ask = getattr(ctypes.CDLL(self._mpi.__file__), "MPIX_Query_cuda_support", None)
        return ask is not None and bool(ask())

    def allgather_arrays(
        self, mine: NDArray[Any], counts: Sequence[int], out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Return on every rank the arrays of all, of one number type, flat and one after the other.

        counts: size of the array of each rank; out: array for the result of several ranks.
        """
        if not self.shared:
            return mine.ravel()
        room = np.empty(sum(counts), mine.dtype) if out is None else out
        _complete(self.comm.Iallgatherv(np.ascontiguousarray(mine), (room, counts)).Test)
        return room

    def allgather_number(self, mine: float) -> NDArray[Any]:
        """Return a number of each rank, as an array (size,)."""
        return self.allgather_arrays(np.array([mine]), [1] * self.size)

    def allgather(self, mine: T) -> list[T]:
        """Return an object of each rank."""
        self._wait_for_all()
        return list(self.comm.allgather(mine)) if self.shared else [mine]

    def requests(self, wanted: dict[int, T]) -> dict[int, T]:
        """Return the requests of all ranks to this one, by rank; wanted: those of this rank."""
        return {r: of[self.rank] for r, of in enumerate(self.allgather(wanted)) if self.rank in of}

    def on_root(self, function: Callable[[], T]) -> T:
        """Return the function's result, or raise its error, from a call on rank 0 alone."""
        if not self.shared:
            return function()
        outcome: tuple[T | None, Exception | None] = None, None
        if self.rank == 0:
            try:
                outcome = function(), None
            except Exception as raised:
                outcome = None, raised
        self._wait_for_all()
        value, error = self.comm.bcast(outcome)
        if error is not None:
            raise error
        return cast(T, value)

    def any_lately(self, mine: bool) -> bool:
        """Return whether `mine` held on any of several ranks in the call before this one.

        Its message travels while ranks compute. A single process returns `mine`.
        """
        if not self.shared:
            return mine
        self._settle()
        found = bool(self._received[0])  # zero at the first call
        self._sent[0] = mine
        self._asked = self.comm.Iallreduce(self._sent, self._received, self._mpi.MAX)
        return found

    def _settle(self) -> None:
        """Complete the message of `any_lately`, as MPI requires at the end of a process too."""
        if self._asked is not None:
            _complete(self._asked.Test)

    @contextmanager
    def root_first(self) -> Iterator[None]:
        """Make the other ranks enter the block when rank 0 has left it."""
        if self.rank:
            self._wait_for_all()
        try:
            yield
        finally:  # if rank 0 fails, the others enter and fail too
            if not self.rank:
                self._wait_for_all()

    def _wait_for_all(self) -> None:
        if self.shared:
            _complete(self.comm.Ibarrier().Test)

    def _fail(self, kind: type[BaseException], error: BaseException, trace: Any) -> None:
        """End all ranks after an uncaught exception: others may wait for this one."""
        self._previous_hook(kind, error, trace)
        self.agree_to_fail(f"{kind.__name__}: {error}")

    def agree_to_fail(self, line: str) -> None:
        """Return if all ranks fail within `PATIENCE`; otherwise print the line, end all ranks."""
        if self.shared and not _complete(self._failures.Ibarrier().Test, PATIENCE):
            sys.stderr.write(f"swe-sphere: rank {self.rank} of {self.size}: {line}\n")
            time.sleep(0.2)  # so that mpiexec prints the line before it ends all ranks
            self.comm.Abort(1)
            time.sleep(10.0 * PATIENCE)  # until mpiexec ends this process


def _end_with(parent: int) -> None:
    """End this process when its parent has ended: nothing else ends ranks without a launcher."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os.kill(os.getpid(), signal.SIGKILL)


@functools.cache
def world() -> Communicator:
    """Return the communicator of this process and the other ranks.

    Raises ConfigError if it is one of several processes and mpi4py is missing or of another MPI.
    """
    started = started_ranks()
    if started is None:
        return Communicator()
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        if started == 1:
            return Communicator()
        missing = "mpi4py" if isinstance(error, ImportError) else "MPI library"
        raise ConfigError(
            f"several ranks were started, but there is no {missing} for them: pip install"
            " 'spectral-swe-sphere[mpi]'"
        ) from None
    ranks = Communicator(MPI)
    if started not in (0, ranks.size):
        raise ConfigError(
            f"{started} ranks were started, but mpi4py finds {ranks.size}: it belongs"
            " to another MPI than the launcher"
        )
    return ranks


def started_ranks() -> int | None:
    """Return the number of ranks started with this process; 0 if it is unknown.

    None stands for a process that is not a rank, for example one started by a rank.
    """
    sizes = [os.environ[name] for name in SIZE_VARIABLES if name in os.environ]
    # with two launchers, PMI_FD is the socket of the outer one, which this process may lack
    socket = "" if len(sizes) > 1 else os.environ.get("PMI_FD", "")
    if socket.isdigit() and not Path(f"/dev/fd/{socket}").is_socket():
        return None
    if not sizes and "PMIX_RANK" in os.environ:
        sizes = [os.environ.get("SLURM_STEP_NUM_TASKS", "0")]
    return int(sizes[0]) if sizes and sizes[0].isdigit() else None


def leave_ranks() -> None:
    """Remove the variables of the launcher, so that this process is independent of ranks."""
    for name in (*SIZE_VARIABLES, *RANK_VARIABLES, "PMI_FD"):
        os.environ.pop(name, None)


def refuse_ranks() -> None:
    """Raise ConfigError if several ranks were started for work that they cannot share."""
    if world().size > 1:
        raise ConfigError("only runs of a scene support several ranks: start this on its own")
