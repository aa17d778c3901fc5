"""The ranks of a run: one process alone, or those that MPI has started.

Each rank has all of the mesh on the host, and steps its part of it.  What every rank can work out
for itself from the same numbers, every rank does: their decisions agree because their bits do.
"""

import atexit
import ctypes
import functools
import math
import os
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.ranks.blas import keep_to_one_thread
from swe_sphere.ranks.messages import Messages

T = TypeVar("T")

SIZES = ("OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE", "PMI_SIZE")
"""Where those who start the ranks say how many there are."""
OF_RANKS = "PMI_RANK", "OMPI_COMM_WORLD_RANK", "MV2_COMM_WORLD_RANK", "PMIX_RANK"
"""And which of them a process is."""
PATIENCE = 4.0
"""Seconds that a rank which fails waits for the others to fail too."""
HEARD = 0.2
"""Seconds that mpiexec has to pass on what a rank says, before it is told to end all of them."""
BRIEFLY = 0.001
"""Seconds in which a rank that waits for others looks again as soon as it may."""
NAP = 0.001
"""Seconds that it sleeps between looks after that; MPI itself would never let go of the core."""
WATCH = 1.0
"""Seconds between looks whether what started a rank is still there."""


class Alone:
    """A single process."""

    rank, size, local = 0, 1, 0
    """local: which of those on this machine it is."""
    shared = False
    """Whether the mesh is dealt out."""
    on_one_machine = False
    """Whether ranks share one machine, and there are no others."""

    def messages(self, outgoing: Mapping[int, Any], incoming: Mapping[int, Any]) -> Messages:
        """What exchanges arrays with others, by their ranks; there are none here."""
        raise NotImplementedError

    def reaches(self, device: str) -> bool:
        """Whether messages come from the memory of that device and go there, with no copies."""
        return True

    def waits(self, device: str) -> bool:
        """Whether messages have to wait until the device has done what comes before them."""
        return False

    def gather(
        self, mine: NDArray[Any], counts: Sequence[int], out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """The arrays of all ranks, of one number type, flat and one after the other.

        counts: how many numbers each of them has; out: room for all, of several ranks.
        """
        return mine.ravel()

    def of_each(self, mine: float) -> NDArray[Any]:
        """A number of each rank."""
        return self.gather(np.array([mine]), [1] * self.size)

    def tell_all(self, mine: T) -> list[T]:
        """What each rank has to say."""
        return [mine]

    def on_root(self, function: Callable[[], T]) -> T:
        """What the function returns, or raises, on rank 0; it is called nowhere else."""
        return function()

    @contextmanager
    def root_first(self) -> Iterator[None]:
        """The other ranks enter the block when rank 0 has left it."""
        yield

    def any_lately(self, mine: bool) -> bool:
        """Whether it held on any rank when they were asked last, or now."""
        return mine

    def agree_to_fail(self, line: str) -> None:
        """Return where all ranks fail; else write the line and end all of them."""


class Ranks(Alone):
    """The ranks of MPI's world."""

    shared = True

    def __init__(self) -> None:
        from mpi4py import MPI

        keep_to_one_thread()
        self._mpi, self._comm, self._failures = MPI, cast(Any, MPI.COMM_WORLD), MPI.COMM_WORLD.Dup()
        self._neighbours = MPI.COMM_WORLD.Dup()
        self._neighbours.Set_errhandler(MPI.ERRORS_ARE_FATAL)  # nobody looks at their results
        self.rank, self.size = self._comm.rank, self._comm.size
        self._machine = self.machine()
        self.local, self._near = self._machine.rank, tuple(self._machine.allgather(self.rank))
        self.on_one_machine = len(self._near) == self.size
        self._asked = (np.zeros(1, np.int8), np.zeros(1, np.int8))
        self._answer: Any = None
        atexit.register(self._settle)
        self._tell, sys.excepthook = sys.excepthook, self._fail
        threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()

    def machine(self) -> Any:
        """A communicator of the ranks on this machine."""
        return self._comm.Split_type(self._mpi.COMM_TYPE_SHARED)

    def messages(self, outgoing: Mapping[int, Any], incoming: Mapping[int, Any]) -> Messages:
        """They do not block, and go through memory on one machine."""
        return Messages(self._neighbours, self._machine, self._near, outgoing, incoming)

    def reaches(self, device: str) -> bool:
        """All MPIs reach the memory of CPUs, some that of GPUs."""
        ask = getattr(ctypes.CDLL(self._mpi.__file__), "MPIX_Query_cuda_support", None)
        return device == "cpu" or (ask is not None and bool(ask()))

    def waits(self, device: str) -> bool:
        """A CPU does one thing after the other."""
        return device != "cpu"

    def gather(
        self, mine: NDArray[Any], counts: Sequence[int], out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """By one message of all to all."""
        room = np.empty(sum(counts), mine.dtype) if out is None else out
        self._comm.Allgatherv(np.ascontiguousarray(mine), (room, counts))
        return room

    def tell_all(self, mine: T) -> list[T]:
        """By one message of all to all."""
        return list(self._comm.allgather(mine))

    def on_root(self, function: Callable[[], T]) -> T:
        """And tell the others."""
        value: Any = None
        error: Exception | None = None
        if self.rank == 0:
            try:
                value = function()
            except Exception as raised:
                error = raised
        self._meet(self._comm)
        value, error = self._comm.bcast((value, error))
        if error is not None:
            raise error
        return cast(T, value)

    @contextmanager
    def root_first(self) -> Iterator[None]:
        """By a barrier."""
        if self.rank:
            self._meet(self._comm)
        try:
            yield
        finally:  # where it fails here, the others shall see for themselves
            if not self.rank:
                self._meet(self._comm)

    def _meet(self, comm: Any, patience: float = math.inf) -> bool:
        """Wait for all ranks, for so many seconds; whether they came."""
        all_here, began = comm.Ibarrier(), time.monotonic()
        while not all_here.Test():
            waited = time.monotonic() - began
            if waited > patience:
                return False
            time.sleep(NAP if waited > BRIEFLY else 0.0)
        return True

    def any_lately(self, mine: bool) -> bool:
        """Whether it held when they were asked the last time: the message takes its time."""
        known = self._answer is not None
        if known:
            self._answer.Wait()
        said, heard = self._asked
        found = known and bool(heard[0])
        said[0] = mine and not found
        self._answer = self._comm.Iallreduce(said, heard, self._mpi.MAX)
        return found

    def _settle(self) -> None:
        """Leave nothing open for MPI to complain of."""
        if self._answer is not None:
            self._answer.Wait()
        for each in (self._failures, self._neighbours, self._machine):
            each.Free()

    def _fail(self, kind: type[BaseException], error: BaseException, trace: Any) -> None:
        """What nobody has caught is the end of all, too: others may wait for this rank."""
        self._tell(kind, error, trace)
        self.agree_to_fail(f"{kind.__name__}: {error}")

    def agree_to_fail(self, line: str) -> None:
        """By a barrier that is not waited for any longer than a while."""
        if not self._meet(self._failures, PATIENCE):
            sys.stderr.write(f"swe-sphere: rank {self.rank} of {self.size}: {line}\n")
            sys.stderr.flush()
            time.sleep(HEARD)
            self._comm.Abort(1)
            time.sleep(10.0 * PATIENCE)  # the end comes from outside


def _end_with(parent: int) -> None:
    """End this process when that one is its parent no more: nobody else ends ranks left alone."""
    while os.getppid() == parent:
        time.sleep(WATCH)
    os.kill(os.getpid(), signal.SIGKILL)


@functools.cache
def world() -> Alone:
    """The ranks that this process is one of.

    Raises ConfigError where it was started as one of several, and mpi4py is not there, or is that
    of another MPI.
    """
    started = started_ranks()
    if started is None:
        return Alone()
    try:
        ranks = Ranks()
    except ImportError:
        if started == 1:
            return Alone()
        raise ConfigError(
            "several ranks were started, but there is no mpi4py for them: pip install"
            " 'swe-sphere[mpi]'"
        ) from None
    if started not in (0, ranks.size):
        raise ConfigError(
            f"{started} ranks were started, but mpi4py knows of {ranks.size}: it is of another MPI"
            " than what has started them"
        )
    return ranks


def started_ranks() -> int | None:
    """Of how many ranks this process is one; 0 if nobody says.  What a rank starts is none."""
    said = [os.environ[name] for name in SIZES if name in os.environ]
    socket = "" if len(said) > 1 else os.environ.get("PMI_FD", "")  # that of another MPI around
    if socket.isdigit() and not _is_socket(int(socket)):
        return None
    if not said and "PMIX_RANK" in os.environ:
        said = [os.environ.get("SLURM_STEP_NUM_TASKS", "0")]
    return int(said[0]) if said and said[0].isdigit() else None


def _is_socket(number: int) -> bool:
    try:
        return stat.S_ISSOCK(os.fstat(number).st_mode)
    except OSError:
        return False


def leave_ranks() -> None:
    """Be no rank, in a process that one has started."""
    for name in (*SIZES, *OF_RANKS, "PMI_FD"):
        os.environ.pop(name, None)


def refuse_ranks() -> None:
    """ConfigError where several ranks were started for what they cannot share."""
    if world().size > 1:
        raise ConfigError("only a run of a scene is for several ranks: start this alone")
