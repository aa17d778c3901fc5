"""Largest stable steps from amplification factors, and the tableaus that determine these."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY

Complex = NDArray[np.complex128]
Rows = tuple[tuple[float, ...], ...]
NO_GROWTH = 1e-7
"""Growth of a mode in a step that counts as none."""
SHORT = 0.25
"""Product of a step and the spectral radii; waves that grow there grow at any step."""
GROWTH_TIME = 15 * DAY
"""Time in which a method that has no stable step may amplify the fastest wave by a factor e [s]."""
ROUNDING = 1e-6
"""Largest residual of an order condition that may be rounding of coefficients."""


def largest_step(
    factor: Callable[[Complex, Complex], Array], wave: float, dissipation: float, reach: float,
    tolerance: float = NO_GROWTH, tries: int = 1, growth_time: float = math.inf,
) -> float:  # fmt: skip
    """Return the largest dt [s] up to which no mode grows by more than the tolerance in a step.

    `factor(z_wave, z_dissipation)` is the largest amplification factor for eigenvalues times dt of
    the waves (imaginary) and the dissipation (negative); the search covers all combinations up to
    the spectral radii `wave` and `dissipation` [s-1]. `reach` bounds dt times the sum of both; if
    steps longer than an unstable one may be stable again, `tries` steps up to it are tried. A
    method that amplifies waves at any step, however short (Heun's of second order), may amplify one
    by a factor e in `growth_time` [s] instead.
    """
    if wave + dissipation == 0.0:
        return np.inf
    share = np.linspace(0.0, 1.0, 65)
    damping = share[::8] if dissipation else share[:1]
    z_wave, z_dissipation = np.meshgrid(1j * wave * share, -dissipation * damping + 0j)

    def excess(dt: float) -> float:
        return float(factor(dt * z_wave, dt * z_dissipation).max()) - 1.0

    if excess(SHORT / (wave + dissipation)) <= tolerance:
        growth_time = math.inf

    def stable(dt: float) -> bool:
        return excess(dt) <= max(tolerance, dt / growth_time)

    tried = reach / (wave + dissipation) * np.linspace(0.0, 1.0, tries + 1)
    first = next((i for i in range(1, tries) if not stable(tried[i])), tries)
    low, high = tried[first - 1], tried[first]
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def tableau(rows: Sequence[Sequence[float]], stages: int) -> Array:
    """Return the matrix A (stages, stages) of a method from its last rows, filled up with zeros."""
    a = np.zeros((stages, stages))
    for i, row in enumerate(rows, start=stages - len(rows)):
        a[i, : len(row)] = row
    return a


def checked_tableau(cls: Any, attribute: str, first: int = 0, diagonal: bool = True) -> Array:
    """Return the matrix A of the rows in an attribute of a method with the weights `b`.

    Rows begin with stage `first` and end on the diagonal, or before it without `diagonal`. Raises
    ConfigError for rows of another number or length, and for numbers that are not finite.
    """
    rows, lengths = getattr(cls, attribute), range(first + diagonal, len(cls.b) + diagonal)
    fits = [n * diagonal <= len(row) <= n for row, n in zip(rows, lengths, strict=False)]
    if len(rows) != len(lengths) or not all(fits):
        raise ConfigError(
            f"stepper {cls.name}: the rows of `{attribute}` must have {[*lengths]} numbers, as `b`"
            f" has {len(cls.b)}, got {[len(row) for row in rows]}"
        )
    if not np.isfinite(found := tableau(rows, len(cls.b))).all():
        raise ConfigError(f"stepper {cls.name}: `{attribute}` must have finite numbers, got {rows}")
    return found


def check_order(
    cls: Any, *matrices: Array, weights: ArrayLike | None = None, order: int = 0
) -> None:
    """Raise ConfigError if a method misses an order condition of its `order`, up to the fifth.

    matrices: A of each part of the right-hand side. A condition b . phi = 1 / density belongs to
    each rooted tree whose branches have matrices (Hairer, Norsett & Wanner 1993, II.2 and II.15).
    weights, order: weights and order of an embedded method, to check it instead of the method.
    """
    b, branches = np.array(cls.b if weights is None else weights), list[_Branch]()
    declared = order or cls.order
    for nodes in range(1, max(1, min(declared, 5)) + 1):
        grown = list[_Branch]()
        for forest in _forests(branches, nodes - 1):
            density = nodes * math.prod(branch.density for branch in forest)
            phi = math.prod((branch.phi for branch in forest), start=np.ones(b.size))
            powers = Counter(branch.text for branch in forest).items()
            text = " ".join(name if n == 1 else f"{name}^{n}" for name, n in powers)
            residual = b @ phi - 1.0 / density
            if not abs(residual) <= ROUNDING:
                right = f"1/{density}" if text else "1"
                raise ConfigError(
                    f"stepper {cls.name}: order {declared} requires {f'sum b {text}'.strip()} ="
                    f" {right}, which its coefficients miss by {residual:.3g}"
                )
            name = {"": "c", "c": "A c"}.get(text, f"A({text})")
            grown += [_Branch(nodes, density, name, a @ phi) for a in matrices]
        branches += grown


class _Branch(NamedTuple):
    """A rooted tree that grows on a node, with one of the matrices."""

    order: int
    density: int
    text: str
    phi: Array


def _forests(branches: Sequence[_Branch], nodes: int) -> Iterator[tuple[_Branch, ...]]:
    """Yield all multisets of branches with `nodes` nodes together."""
    if nodes == 0:
        yield ()
    for i, branch in enumerate(branches):
        if branch.order <= nodes:
            for others in _forests(branches[i:], nodes - branch.order):
                yield branch, *others


def error_constant(a: Array, b: Array, order: int) -> float:
    """Return |b^T A^p 1 - 1/(p+1)!|, by which R(z) of order p differs from e^z at z^(p+1)."""
    power = np.linalg.matrix_power(a, order).sum(axis=1)
    return float(abs(b @ power - 1.0 / math.factorial(order + 1)))


def runge_kutta_factor(b: Array, *parts: tuple[Array, Complex]) -> Array:
    """Return |R|, R = 1 + z b^T (I - sum_k z_k A_k)^-1 1 (Hairer & Wanner 1996, eq. IV.3.2).

    b: the weights; parts: matrices A_k, each with its eigenvalues times dt z_k; z = sum z_k.
    """
    stacked = np.broadcast_arrays(*(z for _, z in parts))
    terms = (z[..., None, None] * a for (a, _), z in zip(parts, stacked, strict=True))
    matrix = np.eye(len(b)) - sum(terms)
    stages = np.linalg.solve(matrix, np.ones((*matrix.shape[:-1], 1)))[..., 0]
    return np.asarray(np.abs(1.0 + sum(stacked) * (stages @ b)))


def largest_moduli(step: Complex) -> Array:
    """Return the largest modulus of the eigenvalues of matrices (..., n, n)."""
    return np.asarray(np.abs(np.linalg.eigvals(step)).max(axis=-1))
