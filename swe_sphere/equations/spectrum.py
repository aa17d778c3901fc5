"""Extent of the spectrum of the discrete operator, from which stable steps follow.

The largest eigenvalue is found from a Krylov basis of little memory.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.errors import ConfigError

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


Operator = Callable[[wp.array, wp.array], None]

TOLERANCE = 1e-2


@dataclass(frozen=True)
class Spectrum:
    """Largest modulus of eigenvalues [s-1]: of waves (imaginary) and of dissipation (negative)."""

    wave: float
    dissipation: float = 0.0
    wind: float = 0.0
    turning: float = 0.0
    """What the wind has in `wave`, and the Coriolis parameter; told where a limit depends on it."""


def estimate_spectrum(
    discrete: DiscreteScene,
    state: wp.array,
    waves: Operator,
    dissipation: Operator | None = None,
) -> Spectrum:
    """Spectral radii of the two parts of the right-hand side at a state, to about 1 %.

    The largest eigenvalue is found by Arnoldi iteration on the Jacobian-vector product
    [F(u+d) - F(u-d)]/2, exact for a d of any size where F is a quadratic polynomial of the state;
    else d is small.  Raises ConfigError where the right-hand side is not finite.
    """
    wave = spectral_radius(discrete, state, waves, _reach(discrete, dissipative=False))
    damping = 0.0
    if dissipation is not None:
        reach = _reach(discrete, dissipative=True)
        damping = spectral_radius(discrete, state, dissipation, reach)
    discrete.launch.forget()
    return Spectrum(wave, damping)


def _reach(discrete: DiscreteScene, dissipative: bool) -> float:
    """Size of the differences, relative to the state."""
    effects = [e for e in discrete.scene.effects if e.dissipation == dissipative]
    if all(effect.degree is not None and effect.degree <= 2 for effect in effects):
        return 1.0
    return float(np.cbrt(np.finfo(discrete.device_mesh.numpy_real).eps))


def spectral_radius(
    discrete: DiscreteScene, state: wp.array, operator: Operator, reach: float
) -> float:
    """Largest modulus of the eigenvalues [s-1] of an operator's derivative, to about 1 %.

    reach: size of the differences, relative to the state; any where the operator is quadratic.
    Raises ConfigError where it is not finite.
    """
    product = _scaled_product(discrete, state, operator, reach)
    start = np.random.default_rng(0).standard_normal(len(discrete.fluid) * discrete.mesh.size)
    with np.errstate(over="ignore", invalid="ignore"):
        found = largest_modulus(product, start, TOLERANCE)
    if found is None:
        return _power_iteration(product, start)
    if not np.isfinite(found):
        raise ConfigError(
            f"{discrete.scene.name}: the equations overflow at the start: its fields or the"
            " coefficients of its effects are too large, or too small to divide by"
        )
    return found


def _scaled_product(
    discrete: DiscreteScene, state: wp.array, operator: Operator, reach: float
) -> Product:
    """J d with depth in units of the wind, h sqrt(g/H), so that waves have equal parts of both."""
    mesh = discrete.device_mesh
    base = mesh.collect(state[: discrete.fluid_size]).astype(np.float64)
    scale = _units(discrete, base)
    size = reach * (np.abs(base / scale).max() or 1.0)
    moved, plus, minus = (
        wp.zeros(discrete.fluid_size, dtype=mesh.real, device=mesh.device) for _ in range(3)
    )
    room = np.empty(base.size)

    def product(d: NDArray[np.floating]) -> Array:
        step = size / max(float(d.max()), -float(d.min()), np.finfo(float).tiny)
        for sign, out in ((1.0, plus), (-1.0, minus)):
            np.multiply(d, sign * step, out=room, dtype=np.float64)
            np.multiply(room, scale, out=room)
            moved.assign(mesh.restrict(np.add(base, room, out=room)))
            operator(moved, out)  # on one array: launches keep all those they are recorded with
        difference: Array = mesh.collect(plus).astype(np.float64)
        difference -= mesh.collect(minus)
        difference /= np.multiply(scale, 2.0 * step, out=room)
        return difference

    return product


def _units(discrete: DiscreteScene, base: Array) -> Array:
    """1 for winds and sqrt(H/g) for depth, with H the mean depth."""
    n = discrete.mesh.size
    scale = np.ones(base.size)
    if discrete.scene.wind is None:
        depth = np.average(base[-n:], weights=discrete.mesh.area)
        scale[-n:] = np.sqrt(depth / discrete.scene.planet.gravity)
    return scale


def _power_iteration(product: Product, d: Array, steps: int = 40) -> float:
    """Growth of the operator's square, for a spectrum that Arnoldi iteration cannot separate."""
    growth = 0.0
    for _ in range(steps):
        d = d / np.linalg.norm(d)
        d = product(product(d))
        growth = float(np.sqrt(np.linalg.norm(d)))
        if growth == 0.0:
            break
    return growth
