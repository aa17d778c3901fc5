"""What the families of steppers cost against explicit ones, along the axes of the map."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

from swe_sphere.steppers.stepper import Family
from swe_sphere.studies.regimes.points import Point

BASE = "explicit"
OTHERS: tuple[str, ...] = tuple(name for name in get_args(Family) if name != BASE)


@dataclass(frozen=True)
class Series:
    """Places that differ in their wind only, by rising Froude number."""

    scene: str
    stretch: float
    diffusive: bool
    points: tuple[Point, ...]

    @property
    def title(self) -> str:
        """In words."""
        mesh = f", refined {self.stretch:g} times" if self.stretch != 1.0 else ""
        return f"{self.scene}{mesh}{', hyperviscosity' if self.diffusive else ''}"


def series(points: Sequence[Point]) -> list[Series]:
    """All series, by scene, diffusion and refinement; first the scene with most places."""
    found: dict[tuple[str, bool, float], list[Point]] = {}
    for point in points:
        key = (point.config.scene, point.diffusive, point.config.stretch)
        found.setdefault(key, []).append(point)
    places = Counter(point.config.scene for point in points)
    return [
        Series(scene, stretch, diffusive, tuple(sorted(found[key], key=lambda p: p.froude)))
        for key in sorted(found, key=lambda key: (-places[key[0]], key))
        for scene, diffusive, stretch in [key]
    ]


def ratio(point: Point, family: str, error: float) -> float:
    """Cost of the best of a family over that of the best explicit stepper; NaN where unknown."""
    offer, base = point.best(family, error), point.best(BASE, error)
    return offer.cost / base.cost if offer and base else math.nan


def break_even(of: Series, family: str, error: float) -> float:
    """The Froude number up to which the family is cheaper than explicit steppers.

    Interpolated in the logarithms; where no step of it has the error it counts as dearer.  0 where
    it is dearer everywhere, infinite where it is cheaper up to the end, NaN if nothing is known.
    """
    ratios = [(point.froude, ratio(point, family, error)) for point in of.points]
    cheaper = [i for i, (_, r) in enumerate(ratios) if r <= 1.0]
    if not cheaper:
        return 0.0 if any(math.isfinite(r) for _, r in ratios) else math.nan
    if cheaper[-1] == len(ratios) - 1:
        return math.inf
    (f0, r0), (f1, r1) = ratios[cheaper[-1]], ratios[cheaper[-1] + 1]
    share = math.log(r0) / math.log(r0 / r1) if math.isfinite(r1) else 0.0
    return float(f0 * (f1 / f0) ** share)
