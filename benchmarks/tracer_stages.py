"""Derivation of the coefficients of `swe_sphere/steppers/tracer_steps.py`.

A step of dm/dt = A m in s stages m_i = m_0 + f_i tau A m_(i-1) multiplies an eigenvector with the
eigenvalue i w by P(i w tau), P(z) = 1 + f_s z (1 + f_(s-1) z (1 + ...)), f_s = 1.  P agrees with
exp to order 4 and satisfies |P(i y)| <= 1 up to y = L.  Of all such polynomials P is the nearest to
exp on this interval: it solves a linear programme in its Chebyshev coefficients.  The bound on |P|
is imposed at points that violate the bound, until no such points remain.

    python benchmarks/tracer_stages.py
"""

import itertools
import math

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from rich.console import Console
from scipy.optimize import linprog

Array = NDArray[np.float64]
WANTED = ((6, 4.6), (8, 6.2), (10, 7.9))
"""Stages s, and reach L."""
ORDER = 4
POINTS = np.sin(np.linspace(0.0, np.pi / 2.0, 161))
ANGLES = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False))
TOLERANCE = 1e-10
SCREEN = Console(width=200, highlight=False)


def taylor(stages: int, reach: float) -> tuple[Array, Array]:
    """Return the equations of Chebyshev coefficients in y/L that make P match exp to `ORDER`."""
    powers = [
        np.pad(chebyshev.cheb2poly(row), (0, stages))[: stages + 1] for row in np.eye(stages + 1)
    ]
    parity = np.arange(stages + 1) % 2
    rows = [np.where(parity == k % 2, np.array(powers)[:, k], 0.0) for k in range(ORDER + 1)]
    signs = [(-1.0) ** (k // 2) * reach**k / math.factorial(k) for k in range(ORDER + 1)]
    return np.array(rows), np.array(signs)


def values(stages: int, y: Array) -> NDArray[np.complex128]:
    """Return the factors of the coefficients in P(i y L): real if even, imaginary if odd."""
    basis: NDArray[np.complex128] = (
        chebyshev.chebvander(y, stages) * np.array([1.0, 1j])[np.arange(stages + 1) % 2]
    )
    return basis


def best(stages: int, reach: float) -> tuple[Array, float]:
    """Return the Chebyshev coefficients of P, and the largest distance of P from exp."""
    at = values(stages, POINTS)
    near = (ANGLES[:, None, None].conj() * at).real.reshape(-1, stages + 1)
    target = (ANGLES[:, None].conj() * np.exp(1j * reach * POINTS)).real.ravel()
    equations, right = taylor(stages, reach)
    rows, bounds = [np.c_[near, -np.ones(len(near))]], [target]
    fine = np.sin(np.linspace(0.0, np.pi / 2.0, 4001))
    for _ in range(200):
        found = linprog(
            np.r_[np.zeros(stages + 1), 1.0], np.concatenate(rows), np.concatenate(bounds),
            np.c_[equations, np.zeros(len(equations))], right, [(None, None)] * (stages + 2),
        )  # fmt: skip
        if not found.success:
            raise SystemExit(f"{stages} stages do not reach {reach}: {found.message}")
        p = values(stages, fine) @ found.x[:-1]
        size = np.abs(p)
        peaks = np.flatnonzero((size > np.r_[0, size[:-1]]) & (size >= np.r_[size[1:], 0]))
        peaks = peaks[size[peaks] > 1.0 + TOLERANCE]
        if not len(peaks):
            break
        turned = (p[peaks] / size[peaks]).conj()[:, None] * values(stages, fine[peaks])
        rows.append(np.c_[turned.real, np.zeros(len(peaks))])
        bounds.append(np.ones(len(peaks)))
    return found.x[:-1], found.x[-1]


def fractions(coefficients: Array, reach: float) -> list[float]:
    """Return f_1 ... f_s of P."""
    powers = chebyshev.cheb2poly(coefficients)
    terms = [(-1.0) ** (k // 2) * c / reach**k for k, c in enumerate(powers)]
    ratios = [float(after / before) for before, after in itertools.pairwise(terms)]
    return ratios[::-1]


def main() -> None:
    """Print the table."""
    for stages, reach in WANTED:
        coefficients, error = best(stages, reach)
        f = fractions(coefficients, reach)
        y = np.linspace(0.0, reach, 20001)
        p = np.ones_like(y, dtype=complex)
        for fraction in f:
            p = 1.0 + 1j * y * fraction * p
        excess = np.abs(p).max() - 1.0
        SCREEN.print(f"reach {reach}: {f}  # |P| <= 1 + {excess:.0e}, error {error:.2g}")


if __name__ == "__main__":
    main()
