"""The largest eigenvalue of an operator, without the memory of a large basis."""

import tracemalloc

import numpy as np
import pytest

from swe_sphere.equations.spectrum import largest_modulus


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


def test_the_best_found_where_the_tolerance_is_out_of_reach() -> None:
    found = largest_modulus(rotations(np.linspace(0.0, 1.0, 5000)), start(10000), 1e-12)
    assert found == pytest.approx(1.0, rel=1e-3)


def test_basis_takes_little_memory() -> None:
    size = 200_000
    product, vector = rotations(np.linspace(0.0, 1.0, size // 2)), start(size)
    tracemalloc.start()
    largest_modulus(product, vector, 1e-2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 15.0 * 8 * size
