"""Largest stable steps from amplification factors, and the tableaus that these follow from."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Rows = tuple[tuple[float, ...], ...]
TOLERANCE = 1e-7


def largest_step(
    growth: Callable[[Complex, Complex], NDArray[np.float64]],
    wave: float,
    dissipation: float,
    reach: float,
    tolerance: float = TOLERANCE,
    looks: int = 1,
) -> float:
    """Largest dt [s] up to which no mode grows by more than the tolerance in a step.

    `growth(z_wave, z_dissipation)` gives the largest amplification factor for eigenvalues times dt
    of the waves (imaginary) and the dissipation (negative); all combinations up to the spectral
    radii `wave` and `dissipation` [s-1] are looked at.  `reach` bounds dt times the sum of both;
    where steps longer than an unstable one may be stable again, `looks` steps up to it are tried.
    """
    if wave + dissipation == 0.0:
        return np.inf
    share = np.linspace(0.0, 1.0, 65)
    damping = share[::8] if dissipation else share[:1]
    z_wave, z_dissipation = np.meshgrid(1j * wave * share, -dissipation * damping + 0j)

    def stable(dt: float) -> bool:
        return bool(growth(dt * z_wave, dt * z_dissipation).max() <= 1.0 + tolerance)

    tried = reach / (wave + dissipation) * np.linspace(0.0, 1.0, looks + 1)
    first = next((i for i in range(1, looks) if not stable(tried[i])), looks)
    low, high = tried[first - 1], tried[first]
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def tableau(rows: Sequence[Sequence[float]], stages: int) -> NDArray[np.float64]:
    """The matrix A (stages, stages) of a method from its last rows, without their zeros behind."""
    a = np.zeros((stages, stages))
    for i, row in enumerate(rows, start=stages - len(rows)):
        a[i, : len(row)] = row
    return a


def error_constant(a: NDArray[np.float64], b: NDArray[np.float64], order: int) -> float:
    """|b^T A^p 1 - 1/(p+1)!|, by which R(z) of a method of order p differs from e^z at z^(p+1)."""
    power = np.linalg.matrix_power(a, order).sum(axis=1)
    return float(abs(b @ power - 1.0 / math.factorial(order + 1)))


def runge_kutta_growth(
    b: NDArray[np.float64], *parts: tuple[NDArray[np.float64], Complex]
) -> NDArray[np.float64]:
    """|R|, R = 1 + z b^T (I - sum_k z_k A_k)^-1 1 (Hairer & Wanner 1996, eq. IV.3.2), z = sum z_k.

    b: the weights; parts: matrices A_k with the eigenvalues times dt z_k of what they are for.
    """
    stacked = np.broadcast_arrays(*(z for _, z in parts))
    matrix = np.eye(len(b)) - sum(
        z[..., None, None] * a for (a, _), z in zip(parts, stacked, strict=True)
    )
    stages = np.linalg.solve(matrix, np.ones((*matrix.shape[:-1], 1)))[..., 0]
    growth: NDArray[np.float64] = np.abs(1.0 + sum(stacked) * (stages @ b))
    return growth


def largest_eigenvalue(step: Complex) -> NDArray[np.float64]:
    """Largest modulus of the eigenvalues of matrices (..., n, n)."""
    growth: NDArray[np.float64] = np.abs(np.linalg.eigvals(step)).max(axis=-1)
    return growth
