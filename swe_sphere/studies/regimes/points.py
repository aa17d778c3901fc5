"""The places of a map, from the records of its sweeps: what steps cost there, by family."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, get_args

from swe_sphere.errors import ConfigError
from swe_sphere.simulation.config import RunConfig
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies.report.ranking import FAILED
from swe_sphere.studies.sweep.record import RUNS, RunRecord, current, read_header, runs_of

UNIT = "rk4"
"""The stepper whose right-hand sides costs are told in."""


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
    failures: tuple[tuple[str, float], ...] = ()
    """Steppers with steps [s] at which they blew up or could not solve."""

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
        return any("viscosity." in setting for setting in self.config.settings)

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

    Raises ConfigError where there is no sweep.
    """
    sweeps = {}
    for path in sorted(path.parent for path in folder.glob(f"*/{RUNS}")):
        header, records = read_header(path), runs_of(path).records
        if header is not None and (of_now := current(records, header.sources)):
            sweeps[path.name] = of_now
    if not sweeps:
        raise ConfigError(f"there is no sweep in {folder}: leave report-only out to make one")
    seconds = {name: _shortest(records) for name, records in sweeps.items()}
    units: Units = {}
    for name, records in sweeps.items():
        _add_units(units, records, seconds[name])
    return [_point(name, records, seconds[name], units) for name, records in sweeps.items()]


Units = dict[tuple[object, ...], float]
"""Seconds of a right-hand side of `UNIT`, its part of the update included, by mesh size."""


def _shortest(records: Iterable[RunRecord]) -> dict[str, float]:
    """Shortest time of the repeats of each run [s], by its key."""
    found: dict[str, float] = {}
    for record in records:
        if math.isfinite(record.seconds):
            found[record.key] = min(record.seconds, found.get(record.key, math.inf))
    return found


def _size(record: RunRecord) -> tuple[object, ...]:
    of = record.config
    return of.ne, of.np, of.precision, of.device


def _add_units(units: Units, records: Iterable[RunRecord], seconds: Mapping[str, float]) -> None:
    for record in records:
        if record.config.stepper == UNIT and record.status == "completed":
            evaluations = record.numbers["rhs_evaluations"] or math.nan
            cost = seconds.get(record.key, math.inf) / evaluations
            units[_size(record)] = min(cost, units.get(_size(record), math.inf))


def _point(
    name: str, records: Sequence[RunRecord], seconds: Mapping[str, float], units: Units
) -> Point:
    runs = []
    for record in records:
        errors = {error.field: error for error in record.errors if error.kind == "slow"}
        if record.role != "grid" or record.status != "completed" or not errors:
            continue
        stepper, dt, error = record.config.stepper, record.config.dt, errors["vorticity"].l2
        assert error is not None and isinstance(dt, float)
        if _size(record) not in units:
            raise ConfigError(
                f"{name}: no run of {UNIT} in {record.config.precision} says what a right-hand side"
                f" costs, in which costs are told: add {UNIT} to the steppers"
            )
        if record.key not in seconds:
            raise ConfigError(
                f"{name}: it has runs that were not timed: make the sweeps again without jobs"
            )
        cost = seconds[record.key] / units[_size(record)]
        runs.append(Run(stepper, dt, record.numbers["steps"] or math.nan, error, cost))
    limits = records[0].numbers
    gravity, advective = limits["gravity_limit"], limits["advective_limit"]
    failures = tuple(
        (record.config.stepper, float(record.config.dt))
        for record in records
        if record.role == "grid" and record.status in FAILED
    )
    return Point(
        name, records[0].config, gravity or math.nan, advective or math.nan, tuple(runs), failures
    )


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
