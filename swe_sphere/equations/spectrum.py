"""Extent of the spectrum of the discrete operator, which limits stable steps."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.right_hand_side import Operator
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.limits import one_thread

Product = Callable[[NDArray[np.floating]], Array]

RADIUS_TOLERANCE = 1e-2
"""Relative accuracy of spectral radii."""
BASIS = 16
"""Number of vectors of a Krylov basis."""
CYCLES = 20
"""Largest number of bases; the result of the last basis is accepted without a test."""
INVARIANT = 1e-6
"""Relative size of the part of a product outside the basis that counts as rounding."""


@dataclass(frozen=True)
class SpectralRadii:
    """Largest modulus of eigenvalues [s-1]: of waves (imaginary) and of dissipation (negative).

    wind: part of `wave` due to slow terms.  inertial: the largest Coriolis parameter.
    """

    wave: float
    dissipation: float = 0.0
    wind: float = 0.0
    inertial: float = 0.0


def spectral_radius(model: DiscreteScene, state: wp.array, operator: Operator) -> float:
    """Return the largest modulus of eigenvalues [s-1] of an operator's derivative, to about 1 %.

    operator: function F of wind and depth. Arnoldi iteration uses products with the derivative at
    `state`, F(u+d) - F(u) for small d. Raises ConfigError if the tendency is not finite.
    """
    product = _scaled_product(model, state, operator)
    start = np.random.default_rng(0).standard_normal(len(model.fluid) * model.mesh.size)
    with np.errstate(over="ignore", invalid="ignore"):
        found = largest_modulus(product, start, RADIUS_TOLERANCE)
    model.launch.forget()
    if not np.isfinite(found):
        raise ConfigError(
            f"{model.scene.name}: the equations overflow in the initial state: its fields or the"
            " coefficients of its effects are too large, or too small to divide by"
        )
    return found


def largest_modulus(product: Product, start: Array, tolerance: float) -> float:
    """Return the modulus of the largest eigenvalue, to a relative tolerance if `CYCLES` suffice.

    Arnoldi iteration in float32, whose rounding is far below useful tolerances, from `start` (n,);
    it restarts from the real part of the Ritz vector of the largest Ritz value. The result is not
    finite if a product is not. All ranks call this together, with the whole `start` and products.
    """
    basis = np.zeros((BASIS + 1, start.size), np.float32)
    with one_thread():  # the split of sums depends on the number of threads
        begin: NDArray[np.floating] = product(start)  # nearer to the eigenvector than `start`
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

    k is `BASIS`, or less if the operator maps the first k vectors to their span.
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
            if (rest := float(np.linalg.norm(basis[j + 1]))) > 0.5:
                break  # too little was subtracted for rounding errors to matter
        if rest <= INVARIANT:
            return small[: j + 2, : j + 1]
        small[j + 1, j] = size * rest
        basis[j + 1] /= np.float32(rest)
    return small


def _scaled_product(model: DiscreteScene, state: wp.array, operator: Operator) -> Product:
    """Return the function d -> J d, with depth scaled to the size of the wind in gravity waves.

    The scaled depth is h sqrt(g/H), H the mean depth. Each of several ranks computes its own nodes
    and receives the whole product, in an array that the next product overwrites.
    """
    mesh = model.device_mesh
    fluid, heights, factor = state[: model.fluid_size], slice(-mesh.size, None), 1.0
    base = fluid.numpy().astype(np.float64)
    if model.scene.wind is None:  # otherwise the depth is the only field
        mean = np.average(mesh.collect(fluid[heights]), weights=model.mesh.area)
        factor = float(np.sqrt(mean / model.scene.planet.gravity))
    largest = max(np.abs(base[: -mesh.size]).max(initial=0.0), np.abs(base[heights]).max() / factor)
    size = mesh.comm.allgather_number(largest).max() or 1.0
    size *= np.sqrt(np.finfo(mesh.numpy_real).eps)
    moved, rates, room = model.zeros(base.size), model.zeros(base.size), np.empty(base.size)
    moved.assign(base)
    operator(moved, rates)  # always the same arrays, which recorded launches keep
    of_base = rates.numpy().astype(np.float64)

    def product(d: NDArray[np.floating]) -> Array:
        step = size / max(float(d.max()), -float(d.min()), np.finfo(float).tiny)
        np.multiply(mesh.on_rank(d), step, out=room, dtype=np.float64)
        room[heights] *= factor
        moved.assign(np.add(room, base, out=room))
        operator(moved, rates)
        np.subtract(rates.numpy(), of_base, out=room)
        room[heights] /= factor
        return mesh.collect(np.divide(room, step, out=room))

    return product
