"""The places of a map, from the records of its sweeps: what steps cost there, by family."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, get_args

from swe_sphere.errors import ConfigError
from swe_sphere.simulation.config import RunConfig
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies.report.rows import Row, read_rows
from swe_sphere.studies.sweep.dataset import build_dataset
from swe_sphere.studies.sweep.record import RUNS, current, read_header, runs_of

UNIT = "rk4"
"""The stepper whose right-hand sides costs are told in."""
SLOW = ("slow", "vorticity", "l2")
"""The error of a run."""


@dataclass(frozen=True)
class Run:
    """One run at a place of the map."""

    stepper: str
    dt: float
    """[s]"""
    steps: float
    error: float
    """Slow-flow error at the end (l2, relative)."""
    cost: float
    """CPU time [right-hand sides of `UNIT` on that mesh]."""


@dataclass(frozen=True)
class Point:
    """A place of the map: a scene with its wind on a mesh, and the runs that came to their end."""

    name: str
    config: RunConfig
    """Of any run there."""
    gravity_limit: float
    """Longest step of leapfrog [s]."""
    advective_limit: float
    """The same, were there no gravity waves [s]."""
    runs: tuple[Run, ...]

    @property
    def froude(self) -> float:
        """U/c, the largest wind over the speed of the fastest gravity waves at the start."""
        return 1.0 / (self.advective_limit / self.gravity_limit - 1.0)

    @property
    def days(self) -> float:
        """Length of the runs."""
        assert self.config.days is not None
        return self.config.days

    @property
    def diffusive(self) -> bool:
        """Whether the run has viscosity or hyperviscosity."""
        return any(setting.owner.endswith("viscosity") for setting in self.config.settings)

    @cached_property
    def by_stepper(self) -> dict[str, list[Run]]:
        """The runs of each stepper, longest step first."""
        found: dict[str, list[Run]] = {}
        for run in sorted(self.runs, key=lambda run: -run.dt):
            found.setdefault(run.stepper, []).append(run)
        return found

    def best(self, family: str, error: float) -> Offer | None:
        """The cheapest step with that error of a family, or of the stepper of that name.

        None where no run there has it.
        """
        found = [
            offer
            for name, runs in self.by_stepper.items()
            if name in STEPPERS
            and family in (name, STEPPERS[name].family)
            and (offer := cheapest_step(runs, error)) is not None
        ]
        return min(found, key=lambda offer: offer.cost, default=None)


class Offer(NamedTuple):
    """A step of a stepper with an error that was asked for."""

    stepper: str
    dt: float
    """[s]"""
    cost: float
    """[right-hand sides]"""


def cheapest_step(runs: Sequence[Run], error: float) -> Offer | None:
    """The cheapest step with an error of at most that, of one stepper; None if no run reaches it.

    Between neighbouring steps of which one is good enough all logarithms are taken for linear;
    beyond the longest and the shortest step nothing is assumed.  runs: longest step first.
    """
    found = [Offer(run.stepper, run.dt, run.cost) for run in runs if run.error <= error]
    for longer, shorter in pairwise(runs):
        if shorter.error <= error < longer.error:
            share = math.log(error / shorter.error) / math.log(longer.error / shorter.error)
            dt, cost = (
                a * (b / a) ** share
                for a, b in ((shorter.dt, longer.dt), (shorter.cost, longer.cost))
            )
            found.append(Offer(longer.stepper, dt, cost))
    return min(found, key=lambda offer: offer.cost, default=None)


def read_points(folder: Path) -> list[Point]:
    """All places of a map, from the folders of its sweeps.

    Raises ConfigError where there is no sweep, or one whose runs have no cost.
    """
    places = {}
    for path in sorted(path.parent for path in folder.glob(f"*/{RUNS}")):
        header, records = read_header(path), runs_of(path).records
        if header is not None and (of_now := current(records, header.sources)):
            places[path.name] = (of_now[0].config, read_rows(build_dataset(header, records)))
    if not places:
        raise ConfigError(f"there is no sweep in {folder}: leave report-only out to make one")
    units: dict[tuple[object, ...], float] = {}
    for row in (row for _, rows in places.values() for row in rows):
        if row.stepper == UNIT and row.completed and row.timed:
            a_side = row.cost / row.rhs_evaluations
            units[_size(row)] = min(a_side, units.get(_size(row), math.inf))
    return [_point(name, config, rows, units) for name, (config, rows) in places.items()]


def _size(row: Row) -> tuple[object, ...]:
    return row.ne, row.np, row.precision, row.device


def _point(
    name: str, config: RunConfig, rows: Sequence[Row], units: Mapping[tuple[object, ...], float]
) -> Point:
    """A place; units: seconds of a right-hand side of `UNIT`, its part of the update included."""
    runs = []
    for row in rows:
        errors = [
            of
            for metric, of in row.errors.items()
            if (metric.kind, metric.field, metric.norm) == SLOW
        ]
        if row.role != "grid" or not row.completed or not errors:
            continue
        if not row.timed:
            raise ConfigError(
                f"{name}: it has runs that were not timed: make the sweeps again without jobs"
            )
        if _size(row) not in units:
            raise ConfigError(
                f"{name}: no run of {UNIT} in {row.precision} says what a right-hand side costs, in"
                f" which costs are told: add {UNIT} to the steppers"
            )
        cost = row.cost / units[_size(row)]
        runs.append(Run(row.stepper, row.dt, row.steps, errors[-1], cost))
    return Point(name, config, rows[0].gravity_limit, rows[0].advective_limit, tuple(runs))


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


def ratio(point: Point, family: str, error: float, base: str = BASE) -> float:
    """Cost of the best of a family over that of the best of the base; NaN where unknown."""
    offer, known = point.best(family, error), point.best(base, error)
    return offer.cost / known.cost if offer and known else math.nan


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
