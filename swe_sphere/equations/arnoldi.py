"""The largest eigenvalue of an operator, from a Krylov basis of little memory."""

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from swe_sphere.arrays import Array

Float32 = NDArray[np.float32]
Product = Callable[[NDArray[np.floating]], Array]

BASIS = 24
KEPT = 2
"""Vectors of the basis, and those that the next one begins with where it was not enough."""
CYCLES = 10
INVARIANT = 1e-6
"""Part of a product outside the basis that is no more than rounding."""
STRIP = 65536


def largest_modulus(product: Product, start: Array, tolerance: float) -> float | None:
    """Modulus of the largest eigenvalue, to a relative tolerance; None where it is not found.

    Arnoldi iteration from `start` (n,), begun anew from the Schur vectors of the largest Ritz
    values (Stewart 2002, doi:10.1137/S0895479800371529), in float32, which rounds a thousand times
    less than any tolerance worth asking for.  A product that is not finite gives NaN.
    """
    basis = np.empty((BASIS + 1, start.size), np.float32)
    size = _unit(product(start), basis[0])  # nearer to the vector sought than the start itself
    if size == 0.0 or not np.isfinite(size):
        return size
    small, kept = np.zeros((BASIS + 1, BASIS)), 0
    for _ in range(CYCLES):
        for j in range(kept, BASIS):
            size, rest = _expand(product, basis, small, j)
            if not np.isfinite(size):
                return float("nan")
            if rest <= INVARIANT:
                return float(np.abs(np.linalg.eigvals(small[: j + 1, : j + 1])).max())
        values, vectors = np.linalg.eig(small[:BASIS])
        first = np.abs(values).argmax()
        largest = float(np.abs(values[first]))
        if np.abs(small[BASIS] @ vectors[:, first]) <= tolerance * largest:
            return largest
        kept = _restart(basis, small, np.sort(np.abs(values))[-KEPT])
    return None


def _expand(product: Product, basis: Float32, small: Array, j: int) -> tuple[float, float]:
    """Next row of the basis, next column of the small matrix: |A v_j|, its part that is new."""
    row, rows = basis[j + 1], basis[: j + 1]
    size = _unit(product(basis[j]), row)
    if size == 0.0 or not np.isfinite(size):
        return size, 0.0
    for _ in range(2):
        components = rows @ row
        row -= components @ rows
        small[: j + 1, j] += size * components.astype(np.float64)
    rest = float(np.linalg.norm(row))
    small[j + 1, j] = size * rest
    if rest > INVARIANT:
        row /= np.float32(rest)
    return size, rest


def _unit(vector: Array, out: Float32) -> float:
    """out = vector / |vector| where that is a number; returns the length."""
    size = float(np.linalg.norm(vector))
    if size > 0.0 and np.isfinite(size):
        np.divide(vector, size, out=out, casting="same_kind")
    return size


def _restart(basis: Float32, small: Array, least: float) -> int:
    """Keep the Schur vectors of Ritz values of that modulus or more; returns how many these are."""
    least *= 1.0 - INVARIANT  # both solvers round
    upper, turn, kept = scipy.linalg.schur(
        small[:BASIS], "real", sort=lambda re, im=0.0: abs(re + 1j * im) >= least
    )
    turn = turn[:, :kept].astype(np.float32)
    for begin in range(0, basis.shape[1], STRIP):
        strip = basis[:, begin : begin + STRIP]
        strip[:kept] = turn.T @ strip[:BASIS]
    basis[kept] = basis[BASIS]
    last = small[BASIS] @ turn
    small.fill(0.0)
    small[:kept, :kept], small[kept, :kept] = upper[:kept, :kept], last
    return int(kept)
