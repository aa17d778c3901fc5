"""Fourth-kind Chebyshev smoothing, which requires only a bound on the largest eigenvalue."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.spectrum import Product, largest_modulus
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.settings.values import read_toml

SIZES = read_toml(Path(__file__).with_name("chebyshev.toml"))
"""Sizes of the steps by degree, for a largest eigenvalue of 1: Lottes 2023, doi:10.1002/nla.2518,
with optimised weights; see the file."""


def chebyshev_steps(degree: int, largest: float) -> list[float]:
    """Return the sizes of the steps x += size D^-1 (b - S x) that smooth best; degree 1 to 16.

    `largest` bounds the spectrum of D^-1 S.
    """
    return [size / largest for size in SIZES[str(degree)]]


def schur_bound(operator: SchurOperator) -> float:
    """Return a bound on the spectrum of D^-1 S, with D the diagonal of S."""
    x, image = operator.field(), operator.field()

    def product(values: NDArray[Any]) -> Array:
        operator.put(values, x)
        operator.apply(x, image)
        return operator.fetch(image) / operator.diagonal

    return spectral_bound(product, operator.diagonal.size)


def spectral_bound(product: Product, size: int) -> float:
    """Return a bound, with 5 % reserve, on the spectrum of an operator (size, size)."""
    return 1.05 * largest_modulus(product, np.random.default_rng(0).standard_normal(size), 0.02)
