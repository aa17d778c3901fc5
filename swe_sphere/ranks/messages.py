"""What ranks exchange again and again, always from the same arrays into the same arrays.

On one machine numbers go through memory that ranks share, so that they are under way while the one
who gets them computes: who sends copies them there and raises a count, who receives sees the count
and copies them from there.  MPI brings the others, and all where no memory can be shared.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[int, Any]
"""Of this rank, by the other one."""

SHARED = "/dev/shm"
"""Where files are memory."""
LINE = 64
"""Bytes that cores pass on at once."""


class Messages:
    """Exchanges that are made once, and started again and again.

    `start` and `wait` are calls of `kernels.messages`, each with what it takes.
    """

    def __init__(
        self, comm: Any, machine: Any, near: tuple[int, ...], outgoing: Arrays, incoming: Arrays
    ) -> None:
        """comm: of all ranks; machine: of those on this one, and `near` their numbers in comm."""
        letters = Letters(machine, near, outgoing, incoming)
        far = (
            {rank: array for rank, array in arrays.items() if rank not in rows}
            for arrays, rows in ((outgoing, letters.leaving), (incoming, letters.coming))
        )
        requests = Requests(comm, *far)
        self.start, self.wait = (
            np.array([0, ahead, *call, *requests.progress, *sum(rows.values(), ())], np.uint64)
            for ahead, call, rows in (
                (0, requests.start, letters.leaving),
                (1, requests.wait, letters.coming),
            )
        )
        self._kept = letters, requests


class Requests:
    """Requests of MPI.

    `start` and `wait` (4,) have the address of a function in C, how many requests, where they are,
    and where their statuses go, if there are any.  `progress` (7,), what to do while shared memory
    is waited for: the addresses of sched_yield, of usleep and of MPI_Iprobe, and what that takes;
    without it MPI might bring nothing to ranks that this one waits for.
    """

    def __init__(self, comm: Any, outgoing: Arrays, incoming: Arrays) -> None:
        from mpi4py import MPI
        from mpi4py.MPI import _addressof as address_of
        from mpi4py.MPI import _sizeof as size_of

        requests = [comm.Recv_init(array, rank) for rank, array in incoming.items()]
        requests += [comm.Send_init(array, rank) for rank, array in outgoing.items()]
        weakref.finalize(self, _free, requests)
        size, count = size_of(MPI.Request), len(requests)
        handles = b"".join(ctypes.string_at(address_of(each), size) for each in requests)
        self._handles = np.frombuffer(bytearray(handles), np.uint8)
        self._statuses = np.zeros(count * size_of(MPI.Status), np.uint8)
        library = ctypes.CDLL(MPI.__file__)  # with MPI's own
        self.start = _address(library.MPI_Startall), count, _where(self._handles), 0
        self.wait = (
            _address(library.MPI_Waitall), count, _where(self._handles), _where(self._statuses)
        )  # fmt: skip
        self._found, system = np.zeros(1 + size_of(MPI.Status), np.int32), ctypes.CDLL(None)
        calls = system.sched_yield, system.usleep, library.MPI_Iprobe
        anything = (number % 2**64 for number in (MPI.ANY_SOURCE, MPI.ANY_TAG, comm.handle))
        self.progress = *map(_address, calls), *anything, _where(self._found)


class Letters:
    """Numbers that go through memory which the ranks of a machine share.

    `leaving` and `coming` have addresses for each neighbour there, none if no memory can be shared:
    from where, to where and how many bytes; a count to wait for, and one to raise.
    """

    def __init__(
        self, machine: Any, near: tuple[int, ...], outgoing: Arrays, incoming: Arrays
    ) -> None:
        sent, got = (
            {rank: each for rank, each in arrays.items() if rank in near and _on_host(each)}
            for arrays in (outgoing, incoming)
        )
        boxes, end = _places(LINE, {rank: LINE + each.nbytes for rank, each in sent.items()})
        receipts, end = _places(end, dict.fromkeys(got, LINE))
        me, mark = near[machine.rank], os.urandom(LINE)
        with _memory(end, mark) as (mine, path):
            told = dict(zip(near, machine.allgather((path, mark, boxes, receipts)), strict=True))
            memories = {rank: _memory_of(*told[rank][:2]) for rank in {*sent, *got}}
            there = mine is not None and all(each is not None for each in memories.values())
            there = all(machine.allgather(there))
        self._kept = mine, memories, sent, got
        """As long as their addresses are in use."""
        self.leaving: dict[int, tuple[int, ...]] = {}
        self.coming: dict[int, tuple[int, ...]] = {}
        if there:
            at = {rank: _where(each) for rank, each in memories.items()}
            for rank, array in sent.items():
                box, receipt = _where(mine) + boxes[rank], at[rank] + told[rank][3][me]
                self.leaving[rank] = _where(array), box + LINE, array.nbytes, receipt, box
            for rank, array in got.items():
                box, receipt = at[rank] + told[rank][2][me], _where(mine) + receipts[rank]
                self.coming[rank] = box + LINE, _where(array), array.nbytes, box, receipt


def _places(begin: int, sizes: Mapping[int, int]) -> tuple[dict[int, int], int]:
    """Where so many bytes begin, each on a line of its own, and where all of them end."""
    found = {}
    for key, size in sizes.items():
        found[key] = begin
        begin += LINE * -(-size // LINE)
    return found, begin


@contextmanager
def _memory(size: int, mark: bytes) -> Iterator[tuple[NDArray[np.uint8] | None, str]]:
    """So many bytes of memory that begin with a mark, and where others find them within the block.

    None where the system has none.  The file has no name that could be left behind.
    """
    with ExitStack() as stack:
        try:
            file = stack.enter_context(tempfile.TemporaryFile(dir=SHARED))
            os.posix_fallocate(file.fileno(), 0, size)
            os.pwrite(file.fileno(), mark, 0)
            path = f"/proc/{os.getpid()}/fd/{file.fileno()}"
        except OSError:
            path = ""
        yield _memory_of(path, mark), path


def _memory_of(path: str, mark: bytes) -> NDArray[np.uint8] | None:
    """The memory at a path; None if it is not that with the mark, as of a process in a container
    to which the same path is another file.
    """
    try:
        with Path(path).open("r+b") as file:
            memory = _mapped(file.fileno())
    except OSError:
        return None
    return memory if memory[: len(mark)].tobytes() == mark else None


def _mapped(descriptor: int) -> NDArray[np.uint8]:
    """The memory that a file is, by the C library: Python's mmap keeps the file open.

    Each exchange has several of them, and a process may not have many open files.
    """
    library = ctypes.CDLL(None, use_errno=True)
    library.mmap.argtypes = ctypes.c_void_p, ctypes.c_size_t, *(ctypes.c_int,) * 3, ctypes.c_long
    library.mmap.restype = ctypes.c_void_p
    library.munmap.argtypes = ctypes.c_void_p, ctypes.c_size_t
    size, access = os.fstat(descriptor).st_size, mmap.PROT_READ | mmap.PROT_WRITE
    address = library.mmap(None, size, access, mmap.MAP_SHARED, descriptor, 0)
    if address == ctypes.c_void_p(-1).value:
        raise OSError(ctypes.get_errno(), "mmap")
    bytes_there = (ctypes.c_uint8 * size).from_address(address)
    memory: NDArray[np.uint8] = np.ctypeslib.as_array(bytes_there)
    weakref.finalize(memory, library.munmap, address, size).atexit = False
    return memory


def _where(array: Any) -> int:
    return int(array.ctypes.data)


def _on_host(array: Any) -> bool:
    return isinstance(array, np.ndarray)


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def _free(requests: list[Any]) -> None:
    for request in requests:
        request.Free()
