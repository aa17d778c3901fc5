"""The largest eigenvalue of an operator, without the memory of a large basis."""

import threading
import tracemalloc

import numpy as np
import pytest

from swe_sphere.equations import arnoldi
from swe_sphere.equations.arnoldi import largest_modulus
from swe_sphere.ranks.communicator import Communicator


def rotations(frequencies: np.ndarray):
    """The operator (2n,) with eigenvalues ±i times the frequencies (n,)."""

    def product(d: np.ndarray) -> np.ndarray:
        x, y = d.astype(np.float64).reshape(2, -1)
        return np.concatenate([-frequencies * y, frequencies * x])

    return product


def start(size: int) -> np.ndarray:
    return np.random.default_rng(1).standard_normal(size)


@pytest.mark.parametrize("scale", [1e-120, 1e-3, 1e120])
def test_largest_of_many_waves(scale: float) -> None:
    """Far beyond the range of the basis' numbers too."""
    found = largest_modulus(rotations(scale * np.linspace(0.0, 1.0, 2000)), start(4000), 1e-3)
    assert found == pytest.approx(scale, rel=2e-3)


def test_few_waves_are_found_exactly() -> None:
    frequencies = np.repeat([1.0, 2.0, 5.0], 100)
    assert largest_modulus(rotations(frequencies), start(600), 1e-2) == pytest.approx(5.0, 1e-6)


def test_what_is_zero_and_what_is_no_number() -> None:
    assert largest_modulus(lambda d: 0.0 * d, start(50), 1e-2) == 0.0
    for bad in (np.nan, np.inf):
        assert not np.isfinite(largest_modulus(lambda d, bad=bad: bad * d, start(50), 1e-2))


def test_none_where_the_tolerance_is_out_of_reach() -> None:
    assert largest_modulus(rotations(np.linspace(0.0, 1.0, 5000)), start(10000), 1e-12) is None


def test_basis_takes_half_the_memory_of_its_vectors() -> None:
    size = 200_000
    product, vector = rotations(np.linspace(0.0, 1.0, size // 2)), start(size)
    tracemalloc.start()
    largest_modulus(product, vector, 1e-2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < (0.5 * 25 + 6.0) * 8 * size


class Thread(Communicator):
    """One of several threads in the place of ranks, who leave their numbers for all to read."""

    def __init__(self, rank: int, size: int, barrier: threading.Barrier, room: dict) -> None:
        self.rank, self.size, self._barrier, self._room = rank, size, barrier, room

    def gather(self, mine, counts, out=None):
        self._room[self.rank] = mine.ravel().copy()
        self._barrier.wait()
        told = [self._room[rank] for rank in range(self.size)]
        self._barrier.wait()
        assert [each.size for each in told] == list(counts)
        return np.concatenate(told)


def on_threads(count: int, size: int, tolerance: float) -> list:
    barrier, room, found = threading.Barrier(count, timeout=300.0), {}, {}

    def work(rank: int) -> None:
        comm = Thread(rank, count, barrier, room)
        waves = rotations(np.linspace(0.0, 1.0, size // 2))
        found[rank] = largest_modulus(waves, start(size), tolerance, comm)

    threads = [threading.Thread(target=work, args=(rank,)) for rank in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [found[rank] for rank in range(count)]


def test_ranks_share_the_basis_and_find_the_same_bits(monkeypatch) -> None:
    """More of them than strips too, of which the last is shorter than the others."""
    size, whole = 5000, largest_modulus(rotations(np.linspace(0.0, 1.0, 2500)), start(5000), 1e-3)
    monkeypatch.setattr(arnoldi, "STRIP", 1200)
    (alone,) = on_threads(1, size, 1e-3)
    assert alone == pytest.approx(whole, rel=1e-5) and alone == pytest.approx(1.0, rel=2e-3)
    for count in (2, 3, 7):
        assert on_threads(count, size, 1e-3) == [alone] * count


def test_ranks_have_a_share_of_the_memory(monkeypatch) -> None:
    monkeypatch.setattr(arnoldi, "STRIP", 10_000)
    size, held = 105_000, []
    for rank in range(3):
        tracemalloc.start()
        basis = arnoldi.Basis(size, Thread(rank, 3, None, {}))
        held.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        del basis
    whole = 25 * 4 * size
    assert sum(held) == pytest.approx(whole, rel=1e-3) and max(held) <= 0.4 * whole
