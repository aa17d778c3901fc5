"""Extent of the spectrum of the discrete operator, which limits stable steps."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.right_hand_side import Operator, acting
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.limits import one_thread

Product = Callable[[NDArray[np.floating]], Array]

TOLERANCE = 1e-2
BASIS = 16
"""Number of vectors of a Krylov basis."""
CYCLES = 20
"""Largest number of bases; the last one's result is accepted without a test."""
INVARIANT = 1e-6
"""Relative size of a product outside the basis below which it counts as rounding."""


@dataclass(frozen=True)
class Spectrum:
    """Largest modulus of eigenvalues [s-1]: of waves (imaginary) and of dissipation (negative)."""

    wave: float
    dissipation: float = 0.0
    wind: float = 0.0
    turning: float = 0.0
    """Share of the wind in `wave`, and the Coriolis parameter; set if a limit depends on them."""


def spectral_radius(
    model: DiscreteScene, state: wp.array, operator: Operator, component: str = "conservative"
) -> float:
    """Return the largest modulus of eigenvalues [s-1] of an operator's derivative, to about 1 %.

    operator: acts on wind and depth, as part of that component of the right-hand side. The
    derivative is taken at `state`. Arnoldi iteration finds the eigenvalue from the product [F(u+d)
    - F(u-d)]/2, which is exact for a d of any size if F is a quadratic polynomial of the state;
    otherwise d is small. Raises ConfigError if the right-hand side is not finite.
    """
    degrees = [effect.degree for effect in acting(model.scene, component)]
    quadratic = all(degree is not None and degree <= 2 for degree in degrees)
    reach = 1.0 if quadratic else float(np.cbrt(np.finfo(model.device_mesh.numpy_real).eps))
    product = _scaled_product(model, state, operator, reach)
    start = np.random.default_rng(0).standard_normal(len(model.fluid) * model.mesh.size)
    with np.errstate(over="ignore", invalid="ignore"):
        found = largest_modulus(product, start, TOLERANCE)
    model.launch.forget()
    if not np.isfinite(found):
        raise ConfigError(
            f"{model.scene.name}: the equations overflow in the initial state: its fields or the"
            " coefficients of its effects are too large, or too small to divide by"
        )
    return found


def largest_modulus(product: Product, start: Array, tolerance: float) -> float:
    """Return the modulus of the largest eigenvalue to a relative tolerance, unless out of reach.

    Arnoldi iteration from `start` (n,), restarted from the largest Ritz vector, in float32, whose
    rounding is a thousandth of any useful tolerance. A product that is not finite gives NaN. All
    ranks call this function together, each with the whole of `start` and of the products.
    """
    basis = np.zeros((BASIS + 1, start.size), np.float32)
    with one_thread():  # the split of sums depends on the number of threads
        # nearer to the eigenvector than the start itself
        begin: NDArray[np.floating] = product(start)
        for _ in range(CYCLES):
            size = float(np.linalg.norm(begin))
            if size == 0.0 or not np.isfinite(size):
                return size
            np.divide(begin, size, out=basis[0], casting="same_kind")
            small = _hessenberg(product, basis)
            if not np.isfinite(small).all():
                return float("nan")
            values, vectors = np.linalg.eig(small[:-1])
            first = np.abs(values).argmax()
            largest = float(np.abs(values[first]))
            if small[-1, -1] * np.abs(vectors[-1, first]) <= tolerance * largest:
                break
            begin = vectors[:, first].real.astype(np.float32) @ basis[:-1]
    return largest


def _hessenberg(product: Product, basis: NDArray[np.float32]) -> Array:
    """Fill an orthonormal basis from its first vector; return the operator in it (k + 1, k).

    k is less than the length of the basis if the operator maps k vectors to their span.
    """
    small = np.zeros((len(basis), len(basis) - 1))
    for j in range(len(basis) - 1):
        image, done = product(basis[j]), slice(j + 1)
        size = float(np.linalg.norm(image))
        if not 0.0 < size < np.inf:
            small[: j + 2, j] = size
            return small[: j + 2, : j + 1]
        np.divide(image, size, out=basis[j + 1], casting="same_kind")
        for _ in range(2):
            components = basis[done] @ basis[j + 1]
            basis[j + 1] -= components @ basis[done]
            small[done, j] += size * components.astype(np.float64)
        rest = float(np.linalg.norm(basis[j + 1]))
        if rest <= INVARIANT:
            return small[: j + 2, : j + 1]
        small[j + 1, j] = size * rest
        basis[j + 1] /= np.float32(rest)
    return small


def _scaled_product(
    model: DiscreteScene, state: wp.array, operator: Operator, reach: float
) -> Product:
    """Return J d with depth as h sqrt(g/H), H its mean: waves have equal parts of wind and depth.

    Each of several ranks computes its own nodes, and receives the whole product.
    """
    mesh = model.device_mesh
    fluid = state[: model.fluid_size]
    base = fluid.numpy().astype(np.float64)
    scale = np.ones(base.size)
    if model.scene.wind is None:  # otherwise the depth is the only field
        depth = mesh.collect(fluid[-mesh.size :]).astype(np.float64)
        mean = np.average(depth, weights=model.mesh.area)
        scale[-mesh.size :] = np.sqrt(mean / model.scene.planet.gravity)
    size = reach * (mesh.comm.of_each(np.abs(base / scale).max()).max() or 1.0)
    moved, plus, minus = (model.zeros(model.fluid_size) for _ in range(3))
    room = np.empty(base.size)

    def product(d: NDArray[np.floating]) -> Array:
        step = size / max(float(d.max()), -float(d.min()), np.finfo(float).tiny)
        mine = mesh.restrict(d)
        for sign, out in ((1.0, plus), (-1.0, minus)):
            np.multiply(mine, sign * step, out=room, dtype=np.float64)
            np.multiply(room, scale, out=room)
            moved.assign(np.add(base, room, out=room))
            operator(moved, out)  # always the same array, which recorded launches keep
        difference: Array = plus.numpy().astype(np.float64)
        difference -= minus.numpy()
        difference /= np.multiply(scale, 2.0 * step, out=room)
        return mesh.collect(difference)

    return product
