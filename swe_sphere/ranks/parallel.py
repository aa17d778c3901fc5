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
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.ranks.blas import keep_to_one_thread

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
"""Seconds during which a waiting rank polls MPI without sleeping."""
NAP = 0.0001
"""Seconds between later polls.  MPI itself polls without pause and would keep the core from ranks
that have work to do."""
WATCH = 1.0
"""Seconds between looks whether what started a rank is still there."""


Arrays = Mapping[int, Any]
"""Arrays of this rank by the rank that they go to or come from: of numpy, or of Warp on a GPU."""


class Messages:
    """Messages between the same arrays again and again: persistent requests of MPI."""

    def __init__(self, comm: Any, outgoing: Arrays, incoming: Arrays) -> None:
        """Prepare one message for each array; `comm` is a communicator of mpi4py."""
        from mpi4py.MPI import Prequest

        self._start, self._test = Prequest.Startall, Prequest.Testall
        self._requests = [comm.Recv_init(array, rank) for rank, array in incoming.items()]
        self._requests += [comm.Send_init(array, rank) for rank, array in outgoing.items()]
        weakref.finalize(self, _free, self._requests)

    def start(self) -> None:
        """Send all outgoing arrays, which must not change before `wait`, and begin to receive."""
        self._start(self._requests)

    def wait(self) -> None:
        """Return when all arrays have been sent and received."""
        _complete(lambda: self._test(self._requests))


def _free(requests: list[Any]) -> None:
    for request in requests:
        request.Free()


def _complete(test: Callable[[], bool], patience: float = math.inf) -> bool:
    """Poll until the test holds, at most `patience` seconds; returns whether it does."""
    if test():
        return True
    began = time.monotonic()
    while not test():
        waited = time.monotonic() - began
        if waited > patience:
            return False
        if waited > BRIEFLY:
            time.sleep(NAP)
        else:
            os.sched_yield()
    return True


class Alone:
    """A single process."""

    rank, size, local = 0, 1, 0
    """local: which of those on this machine it is."""
    shared = False
    """Whether the mesh is dealt out."""

    def messages(self, outgoing: Arrays, incoming: Arrays) -> Messages:
        """Messages between arrays of this rank and of others; a single process has none."""
        raise NotImplementedError

    def reaches(self, device: str) -> bool:
        """Whether messages come from the memory of that device and go there, with no copies."""
        return True

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
        self.rank, self.size = self._comm.rank, self._comm.size
        machine = self._comm.Split_type(MPI.COMM_TYPE_SHARED)
        self.local = machine.rank
        machine.Free()
        self._asked = (np.zeros(1, np.int8), np.zeros(1, np.int8))
        self._answer: Any = None
        atexit.register(self._settle)
        self._tell, sys.excepthook = sys.excepthook, self._fail
        threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()

    def messages(self, outgoing: Arrays, incoming: Arrays) -> Messages:
        """Messages by persistent requests of MPI."""
        return Messages(self._comm, outgoing, incoming)

    def reaches(self, device: str) -> bool:
        """All MPIs reach the memory of CPUs, some that of GPUs."""
        ask = getattr(ctypes.CDLL(self._mpi.__file__), "MPIX_Query_cuda_support", None)
        return device == "cpu" or (ask is not None and bool(ask()))

    def gather(
        self, mine: NDArray[Any], counts: Sequence[int], out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """By one collective message."""
        room = np.empty(sum(counts), mine.dtype) if out is None else out
        _complete(self._comm.Iallgatherv(np.ascontiguousarray(mine), (room, counts)).Test)
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
        _complete(self._comm.Ibarrier().Test)
        value, error = self._comm.bcast((value, error))
        if error is not None:
            raise error
        return cast(T, value)

    @contextmanager
    def root_first(self) -> Iterator[None]:
        """By a barrier."""
        if self.rank:
            _complete(self._comm.Ibarrier().Test)
        try:
            yield
        finally:  # where it fails here, the others shall see for themselves
            if not self.rank:
                _complete(self._comm.Ibarrier().Test)

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
        self._failures.Free()

    def _fail(self, kind: type[BaseException], error: BaseException, trace: Any) -> None:
        """What nobody has caught is the end of all, too: others may wait for this rank."""
        self._tell(kind, error, trace)
        self.agree_to_fail(f"{kind.__name__}: {error}")

    def agree_to_fail(self, line: str) -> None:
        """By a barrier that is not waited for any longer than a while."""
        if not _complete(self._failures.Ibarrier().Test, PATIENCE):
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
