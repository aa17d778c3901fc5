"""Numerical mixing of tracers: loss of filaments, and of the relation between two tracers.

Lauritzen, Skamarock, Prather & Taylor (2012), Geosci. Model Dev. 5, 887-901, section 3,
doi:10.5194/gmd-5-887-2012.  The measures apply to the deformational flow at half time.
"""

from dataclasses import dataclass

import numpy as np

from swe_sphere.arrays import Array

SCAN = 256
"""Number of points of the curve among which the search for the nearest point begins."""
REFINEMENTS = 6
"""Number of Newton steps that refine the nearest point."""


def filaments(area: Array, start: Array, now: Array, thresholds: Array) -> Array:
    """Return the area above each threshold (k,) in percent of the initial area above it: (k,).

    area, start, now: (N,).  Exact transport by a wind without divergence gives 100.  Smeared
    filaments give less at high thresholds and more at low ones.  0 if the initial area is 0.
    """
    then, later = (
        np.array([area[q >= threshold].sum() for threshold in thresholds]) for q in (start, now)
    )
    share: Array = 100.0 * np.divide(later, then, out=np.zeros_like(later), where=then > 0.0)
    return share


@dataclass(frozen=True)
class Relation:
    """One tracer as a quadratic function a q² + c of another, which runs from `low` to `high`."""

    a: float
    c: float
    low: float
    high: float

    def __call__(self, q: Array) -> Array:
        """Return the other tracer for a tracer q."""
        return self.a * q**2 + self.c

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest value of the other tracer; q must not change sign."""
        ends = (self.a * self.low**2 + self.c, self.a * self.high**2 + self.c)
        return min(ends), max(ends)

    def chord(self, q: Array) -> Array:
        """Return the other tracer on the chord of the curve, which bounds real mixing."""
        return self.c + self.a * ((self.low + self.high) * q - self.low * self.high)


BELLS = Relation(a=-0.8, c=0.9, low=0.1, high=1.0)
"""The tracer "correlated" of the deformational flow as a function of "cosine_bells"."""


def mixing(area: Array, q: Array, other: Array, relation: Relation = BELLS) -> dict[str, float]:
    """Return area means of the distance of each pair of values from the curve, by kind of pair.

    area, q, other: (N,).  Distances are in units of the ranges of the two.  Returns

        real_mixing     pairs between the curve and its chord, as real mixing produces them
        unmixing        pairs outside of this region but within the ranges of both tracers
        overshooting    pairs outside of the ranges
    """
    least, largest = relation.range
    distance = _distance(q, other, relation)
    slack = 1e-12  # round-off of a pair on the curve
    inside = (q >= relation.low - slack) & (q <= relation.high + slack)
    inside &= (other >= least - slack) & (other <= largest + slack)
    ends = np.sort(np.stack([relation(q), relation.chord(q)]), axis=0)
    between = inside & (other >= ends[0] - slack) & (other <= ends[1] + slack)
    kinds = {"real_mixing": between, "unmixing": inside & ~between, "overshooting": ~inside}
    share = area / area.sum()
    return {name: float(np.sum((share * distance)[kind])) for name, kind in kinds.items()}


def _distance(q: Array, other: Array, relation: Relation) -> Array:
    """Return the distance (N,) to the nearest point of the curve, in units of the ranges."""
    least, largest = relation.range
    width, height = relation.high - relation.low, largest - least

    def squared(at: Array) -> Array:
        result: Array = ((at - q) / width) ** 2 + ((relation(at) - other) / height) ** 2
        return result

    nearest, best = np.full(q.shape, relation.low), squared(np.full(q.shape, relation.low))
    for point in np.linspace(relation.low, relation.high, SCAN)[1:]:
        candidate = squared(np.full(q.shape, point))
        nearest, best = np.where(candidate < best, point, nearest), np.minimum(candidate, best)
    for _ in range(REFINEMENTS):
        miss, slope = relation(nearest) - other, 2.0 * relation.a * nearest
        first = (nearest - q) / width**2 + miss * slope / height**2
        second = 1.0 / width**2 + (slope**2 + 2.0 * relation.a * miss) / height**2
        moved = np.clip(nearest - first / second, relation.low, relation.high)
        nearest = np.where((second > 0.0) & (squared(moved) < squared(nearest)), moved, nearest)
    return np.sqrt(squared(nearest))
