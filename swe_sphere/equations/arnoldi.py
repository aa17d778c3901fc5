"""The largest eigenvalue of an operator, from a Krylov basis of little memory that ranks share."""

from collections.abc import Callable, Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from swe_sphere.arrays import Array
from swe_sphere.ranks.communicator import Communicator
from swe_sphere.ranks.limits import one_thread

Float32 = NDArray[np.float32]
Product = Callable[[NDArray[np.floating]], Array]

BASIS = 24
KEPT = 2
"""Vectors of the basis, and those that the next one begins with where it was not enough."""
CYCLES = 10
INVARIANT = 1e-6
"""Part of a product outside the basis that is no more than rounding."""
STRIP = 65536
"""Numbers of a vector that a rank has all of or none."""
ALONE = Communicator()


def largest_modulus(
    product: Product, start: Array, tolerance: float, comm: Communicator = ALONE
) -> float | None:
    """Modulus of the largest eigenvalue, to a relative tolerance; None where it is not found.

    Arnoldi iteration from `start` (n,), begun anew from the Schur vectors of the largest Ritz
    values (Stewart 2002, doi:10.1137/S0895479800371529), in float32, which rounds a thousand times
    less than any tolerance worth asking for.  A product that is not finite gives NaN.  comm: the
    ranks that call this together, each with the whole of `start` and of the products.
    """
    with one_thread():  # more of them would cut sums in other places
        return _iterate(product, start, tolerance, Basis(start.size, comm))


def _iterate(product: Product, start: Array, tolerance: float, basis: "Basis") -> float | None:
    """As `largest_modulus`, in a basis that is empty yet."""
    size = basis.put(0, product(start))  # nearer to the vector sought than the start itself
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


def _expand(product: Product, basis: "Basis", small: Array, j: int) -> tuple[float, float]:
    """Next vector of the basis, next column of the small matrix: |A v_j|, its part that is new."""
    size = basis.put(j + 1, product(basis.whole(j)))
    if size == 0.0 or not np.isfinite(size):
        return size, 0.0
    for _ in range(2):
        small[: j + 1, j] += size * basis.cleared(j + 1)
    rest = basis.length(j + 1)
    small[j + 1, j] = size * rest
    if rest > INVARIANT:
        basis.divide(j + 1, rest)
    return size, rest


def _restart(basis: "Basis", small: Array, least: float) -> int:
    """Keep the Schur vectors of Ritz values of that modulus or more; returns how many these are."""
    least *= 1.0 - INVARIANT  # both solvers round
    upper, turn, kept = scipy.linalg.schur(
        small[:BASIS], "real", sort=lambda re, im=0.0: abs(re + 1j * im) >= least
    )
    turn = turn[:, :kept]
    basis.begin_again(turn)
    last = small[BASIS] @ turn
    small.fill(0.0)
    small[:kept, :kept], small[kept, :kept] = upper[:kept, :kept], last
    return int(kept)


class Basis:
    """BASIS + 1 vectors (n,) in float32, cut into strips, of which each rank has its share.

    Sums are taken strip by strip, so that their bits do not depend on how many ranks there are.
    Those of `operators.chunks` do on whether there are any, which explicit runs must not show.
    """

    def __init__(self, size: int, comm: Communicator) -> None:
        self._comm = comm
        edges = np.minimum(STRIP * np.arange(-(-size // STRIP) + 1), size)
        shares = np.arange(comm.size + 1) * (edges.size - 1) // comm.size
        mine = edges[shares[comm.rank] : shares[comm.rank + 1] + 1].tolist()
        self._begins = mine[:-1]
        lengths = np.diff(mine).tolist()
        self._strips: list[Float32] = [np.empty((BASIS + 1, n), np.float32) for n in lengths]
        self._counts = np.diff(shares).tolist()
        self._lengths = np.diff(edges[shares]).tolist()

    def put(self, j: int, vector: Array) -> float:
        """v_j = vector / |vector| where that is a number; returns the length."""
        size = float(np.linalg.norm(vector))
        if size > 0.0 and np.isfinite(size):
            for begin, strip in zip(self._begins, self._strips, strict=True):
                part = vector[begin : begin + strip.shape[1]]
                np.divide(part, size, out=strip[j], casting="same_kind")
        return size

    def whole(self, j: int) -> Float32:
        """v_j (n,)."""
        parts = [strip[j] for strip in self._strips] or [np.empty(0, np.float32)]
        mine = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return self._comm.gather(mine, self._lengths)

    def cleared(self, j: int) -> Array:
        """Take the components (j,) along the vectors before it out of v_j, and return them."""
        found = self._sums([strip[:j] @ strip[j] for strip in self._strips], j)
        components = found.astype(np.float32)
        for strip in self._strips:
            strip[j] -= components @ strip[:j]
        return found

    def length(self, j: int) -> float:
        """|v_j|."""
        squares = [float(np.linalg.norm(strip[j])) ** 2 for strip in self._strips]
        return float(np.sqrt(self._sums(squares, 1)[0]))

    def divide(self, j: int, size: float) -> None:
        """v_j = v_j / size."""
        for strip in self._strips:
            strip[j] /= np.float32(size)

    def begin_again(self, turn: Array) -> None:
        """Combinations of the vectors, by the columns of turn (BASIS, k), in the place of the first
        k, and then the last vector."""
        kept, across = turn.shape[1], turn.T.astype(np.float32)
        for strip in self._strips:
            strip[:kept] = across @ strip[:BASIS]
            strip[kept] = strip[BASIS]

    def _sums(self, parts: Sequence[ArrayLike], width: int) -> Array:
        """The sum (width,) over the strips of all ranks."""
        mine = np.array(parts, dtype=np.float64).reshape(-1, width)
        counts = [width * count for count in self._counts]
        everything = self._comm.gather(mine, counts).reshape(-1, width)
        total: Array = everything.sum(axis=0)
        return total
