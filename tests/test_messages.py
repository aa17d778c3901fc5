"""Memory that ranks share, by threads in the place of ranks: no MPI is needed for it."""

import ctypes
import gc
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from swe_sphere.kernels.messages import message_kernel
from swe_sphere.operators.launch import Launcher
from swe_sphere.ranks import messages
from swe_sphere.ranks.messages import Letters

PROBE = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_int32, ctypes.c_int32, ctypes.c_uint64, ctypes.c_void_p,
    ctypes.c_void_p,
)  # fmt: skip
SLEEP = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_uint32)
SIZE, ROUNDS = 1000, 40


class Machine:
    """A communicator of threads."""

    def __init__(self, size):
        self._told, self._all_here = [None] * size, threading.Barrier(size)

    def of(self, rank):
        return OneOfThem(self, rank)

    def allgather(self, rank, mine):
        self._told[rank] = mine
        self._all_here.wait()
        told = list(self._told)
        self._all_here.wait()
        return told


class OneOfThem:
    def __init__(self, machine, rank):
        self._machine, self.rank = machine, rank

    def allgather(self, mine):
        return self._machine.allgather(self.rank, mine)


class Side:
    """What one rank sends to the other and gets from it."""

    def __init__(self, machine, rank, near=(3, 7)):
        self.sent, self.got = np.zeros(SIZE), np.zeros(SIZE)
        self.letters = Letters(
            machine.of(rank), near, {near[1 - rank]: self.sent}, {near[1 - rank]: self.got}
        )
        self.looks = self.naps = 0
        self._calls = SLEEP(self._nap), PROBE(self._look)
        give_way, sleep, look = (
            ctypes.cast(function, ctypes.c_void_p).value
            for function in (ctypes.CDLL(None).sched_yield, *self._calls)
        )
        self._found = np.zeros(2, np.int32)
        middle = [0, 0, 0, 0, give_way, sleep, look, 0, 0, 0, self._found.ctypes.data]
        self.start, self.wait = (
            self._command([0, ahead, *middle, *sum(rows.values(), ())])
            for ahead, rows in ((0, self.letters.leaving), (1, self.letters.coming))
        )

    def _nap(self, microseconds):
        self.naps += 1
        time.sleep(1e-6 * microseconds)
        return 0

    def _look(self, *_):
        self.looks += 1
        return 0

    def _command(self, call):
        call = wp.array(call, dtype=wp.uint64, device="cpu")
        return wp.launch(message_kernel(), 1, [call], device="cpu", record_cmd=True)


def together(*functions):
    """What each of them returns, each in a thread."""
    found = [None] * len(functions)

    def run(i):
        found[i] = functions[i]()

    threads = [threading.Thread(target=run, args=(i,), daemon=True) for i in range(len(functions))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert not any(thread.is_alive() for thread in threads)
    return found


def wait_until(condition):
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


@pytest.fixture
def sides():
    machine = Machine(2)
    Launcher("cpu").load(message_kernel())
    return together(lambda: Side(machine, 0), lambda: Side(machine, 1))


def test_each_gets_what_the_other_has_sent_in_that_round(sides):
    """Whoever is late: neither reads too early, nor is overwritten what was not read."""

    def run(rank):
        mine, random = sides[rank], np.random.default_rng(rank)
        found = []
        for k in range(ROUNDS):
            mine.sent[:] = 100.0 * k + rank
            mine.start.launch()
            mine.sent[:] = -1.0  # what was sent is of no more use
            time.sleep(random.choice([0.0, 0.003]))
            mine.wait.launch()
            found.append(np.unique(mine.got).tolist())
        return found

    first, second = together(lambda: run(0), lambda: run(1))
    assert first == [[100.0 * k + 1.0] for k in range(ROUNDS)]
    assert second == [[100.0 * k] for k in range(ROUNDS)]


def test_who_waits_lets_mpi_go_on(sides):
    one, other = sides
    waiting = threading.Thread(target=one.wait.launch, daemon=True)
    waiting.start()
    wait_until(lambda: one.looks >= 3)
    assert waiting.is_alive()
    other.sent[:] = 4.0
    other.start.launch()
    waiting.join(30.0)
    assert not waiting.is_alive()
    assert (one.got == 4.0).all()


def test_who_waits_long_leaves_the_core_to_others(sides):
    one, other = sides
    other.sent[:] = 4.0
    other.start.launch()
    one.wait.launch()
    assert one.naps == 0
    waiting = threading.Thread(target=one.wait.launch, daemon=True)
    waiting.start()
    wait_until(lambda: one.naps >= 3)
    seen = one.looks
    wait_until(lambda: one.looks > seen)
    other.start.launch()
    waiting.join(30.0)
    assert not waiting.is_alive()


def test_who_is_ahead_waits_until_the_last_was_read(sides):
    one, other = sides
    one.sent[:] = 1.0
    one.start.launch()
    one.sent[:] = 2.0
    ahead = threading.Thread(target=one.start.launch, daemon=True)
    ahead.start()
    wait_until(lambda: one.looks >= 3)
    assert ahead.is_alive()
    other.wait.launch()
    assert (other.got == 1.0).all()
    ahead.join(30.0)
    other.wait.launch()
    assert (other.got == 2.0).all()


def test_memory_is_shared_by_all_or_by_none(monkeypatch):
    """One of them finds no room for it."""
    machine, reserve = Machine(2), os.posix_fallocate

    def refuse(*given):
        if threading.current_thread().name == "full":
            raise OSError(28, "No space left on device")
        reserve(*given)

    def full():
        threading.current_thread().name = "full"
        return Side(machine, 1)

    monkeypatch.setattr(messages.os, "posix_fallocate", refuse)
    for side in together(lambda: Side(machine, 0), full):
        assert side.letters.leaving == side.letters.coming == {}


def test_nothing_is_left_in_the_directory(sides, monkeypatch, tmp_path):
    monkeypatch.setattr(messages, "SHARED", str(tmp_path))
    machine = Machine(2)
    for side in together(lambda: Side(machine, 0), lambda: Side(machine, 1)):
        assert len(side.letters.leaving) == len(side.letters.coming) == 1
    assert not list(tmp_path.iterdir())


def test_other_memory_than_that_of_the_other_is_not_taken_for_it(monkeypatch, tmp_path):
    """In a container of its own, a process is another one by the same number."""
    find, other = messages._memory_of, tmp_path / "other"
    other.write_bytes(bytes(4 * SIZE * 8))
    alien = {
        "other": lambda path, mark: find(str(other), mark),
        "empty": lambda path, mark: find(str(tmp_path / "empty"), mark),
    }
    (tmp_path / "empty").touch()
    for name, found in alien.items():
        machine, calls = Machine(2), []

        def of_others(path, mark, found=found, calls=calls):
            calls.append(path)
            return find(path, mark) if len(calls) < 3 else found(path, mark)

        monkeypatch.setattr(messages, "_memory_of", of_others)
        for side in together(lambda m=machine: Side(m, 0), lambda m=machine: Side(m, 1)):
            assert side.letters.leaving == side.letters.coming == {}, name


def test_shared_memory_keeps_no_file_open_and_is_given_back():
    """A run has dozens of exchanges, each with all its neighbours."""

    def open_files():
        return len(list(Path("/proc/self/fd").iterdir()))

    def shared():
        return Path("/proc/self/maps").read_text().count(messages.SHARED)

    gc.collect()
    files, mapped = open_files(), shared()
    machine = Machine(2)
    both = together(lambda: Side(machine, 0), lambda: Side(machine, 1))
    assert all(side.letters.leaving and side.letters.coming for side in both)
    assert open_files() == files and shared() == mapped + 4  # each its own and the other's
    del both
    gc.collect()
    assert shared() == mapped
