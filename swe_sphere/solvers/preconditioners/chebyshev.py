"""Fourth-kind Chebyshev smoothing, which requires only a bound on the largest eigenvalue."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.spectrum import Product, largest_modulus
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.settings.values import read_toml

OPTIMAL = read_toml(Path(__file__).with_name("chebyshev.toml"))
"""Weights beta_k by degree; up to 6: Lottes 2023, doi:10.1002/nla.2518, table 1; see the file."""


def chebyshev_coefficients(degree: int, largest: float) -> list[tuple[float, float, float]]:
    """Return (keep, take, beta) of the steps d = keep d + take D^-1 r, x += beta d, then r -= S d.

    `largest` bounds the spectrum of D^-1 S (Lottes 2023, algorithm 4.1); degree 1 to 16.
    """
    return [
        (max(2 * k - 3, 0) / (2 * k + 1), (8 * k - 4) / ((2 * k + 1) * largest), beta)
        for k, beta in enumerate(OPTIMAL[str(degree)], 1)
    ]


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
