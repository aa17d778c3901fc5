"""The places of a map, from the records of its sweeps: what steps cost there, by family."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd

from swe_sphere.errors import ConfigError
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies.report.table import Metric, read_runs
from swe_sphere.studies.sweep.dataset import build_dataset
from swe_sphere.studies.sweep.record import RUNS, Header, current, read_header, runs_of

BASE = "explicit"
OTHERS: tuple[str, ...] = tuple(name for name in get_args(Family) if name != BASE)
UNIT = "rk4"
"""The stepper whose right-hand sides costs are told in."""
SIZE = ["ne", "np", "precision", "device"]
"""What a right-hand side costs depends on."""


@dataclass(frozen=True, eq=False)
class RegimeMap:
    """Places, each a scene with its wind on a mesh, and the runs there that came to their end."""

    places: pd.DataFrame
    """By name: scene, stretch, settings, diffusive (whether there is viscosity), froude (U/c: the
    largest wind over the speed of the fastest gravity waves at the start), gravity_limit [s], days,
    title (of the places that differ in their wind only, which follow each other)."""
    runs: pd.DataFrame
    """place, stepper, dt [s], steps, error (of the slow flow at the end: l2, relative) and cost
    (CPU time [right-hand sides of `UNIT` on that mesh])."""
    headers: Sequence[Header] = ()
    """What the sweeps were asked for."""

    def best(self, error: float) -> pd.DataFrame:
        """The cheapest step with that error of each family at each place, where a run has it.

        Columns: place, family, stepper, dt [s], cost, and the ratios of the cost to that of the
        best explicit step and to that of `UNIT`, NaN where that has no such error.
        """
        found = [
            (place, STEPPERS[stepper].family, stepper, *offer)
            for (place, stepper), runs in self.runs.groupby(["place", "stepper"], sort=False)
            if stepper in STEPPERS and (offer := cheapest_step(runs, error)) is not None
        ]
        names = ["place", "family", "stepper", "dt", "cost"]
        offers = pd.DataFrame(found, columns=names).sort_values("cost", kind="stable")
        units = offers[offers["stepper"] == UNIT].set_index("place")["cost"]
        best = offers.drop_duplicates(["place", "family"])
        bases = best[best["family"] == BASE].set_index("place")["cost"]
        costs, places = best["cost"], best["place"]
        return best.assign(ratio=costs / places.map(bases), beside=costs / places.map(units))


def cheapest_step(runs: pd.DataFrame, error: float) -> tuple[float, float] | None:
    """Step [s] and cost of the cheapest step with an error of at most that, None if there is none.

    Between neighbouring steps of which one is good enough all logarithms are taken for linear;
    beyond the longest and the shortest step nothing is assumed.  runs: of one stepper at a place.
    """
    lines = [*runs.sort_values("dt", ascending=False)[["dt", "cost", "error"]].itertuples(False)]
    found = [(run.dt, run.cost) for run in lines if run.error <= error]
    for longer, shorter in pairwise(lines):
        if shorter.error <= error < longer.error:
            share = math.log(error / shorter.error) / math.log(longer.error / shorter.error)
            dt = shorter.dt * (longer.dt / shorter.dt) ** share
            found.append((dt, shorter.cost * (longer.cost / shorter.cost) ** share))
    return min(found, key=lambda offer: offer[1], default=None)


def read_map(folder: Path) -> RegimeMap:
    """Return the map of the sweeps in a folder.

    Raises ConfigError where there is no sweep, or one whose runs have no cost.
    """
    tables, headers = [], []
    for path in sorted(path.parent for path in folder.glob(f"*/{RUNS}")):
        header, records = read_header(path), runs_of(path).records
        if header is not None and current(records, header.sources):
            dataset = build_dataset(header, records)
            runs, end = read_runs(dataset), max(dataset["report_day"].values, default=math.nan)
            error = runs.get(Metric("slow", "vorticity", "l2", end), math.nan)
            tables.append(runs.assign(error=error, place=path.name))
            headers.append(header)
    if not tables:
        raise ConfigError(f"there is no sweep in {folder}: leave report-only out to make one")
    runs = pd.concat(tables)
    known = runs[(runs["stepper"] == UNIT) & runs["completed"] & runs["timed"]]
    units = (known["cost"] / known["rhs_evaluations"]).groupby([known[of] for of in SIZE]).min()
    firsts = runs.drop_duplicates("place").set_index("place")
    runs = runs[(runs["role"] == "grid") & runs["completed"] & runs["error"].notna()]
    for place in runs.loc[~runs["timed"], "place"]:
        raise ConfigError(
            f"{place}: it has runs that were not timed: make the sweeps again without jobs"
        )
    runs = runs.join(units.rename("unit"), SIZE)
    for run in runs[runs["unit"].isna()].itertuples():
        raise ConfigError(
            f"{run.place}: no run of {UNIT} in {run.precision} says what a right-hand side costs,"
            f" in which costs are told: add {UNIT} to the steppers"
        )
    return RegimeMap(ordered_places(firsts), runs.assign(cost=runs["cost"] / runs["unit"]), headers)


def ordered_places(firsts: pd.DataFrame) -> pd.DataFrame:
    """The places of a map, by scene, diffusion, refinement and wind; those of most places first.

    firsts: any run of each, by the name of the place.
    """
    places = firsts[["scene", "stretch", "settings", "gravity_limit"]].assign(
        days=firsts["days_planned"],
        froude=1.0 / (firsts["advective_limit"] / firsts["gravity_limit"] - 1.0),
        diffusive=firsts["settings"].str.contains("viscosity."),
    )
    title = places["scene"] + np.where(
        places["stretch"] == 1.0, "", ", refined " + places["stretch"].map("{:g}".format) + " times"
    )
    title += np.where(places["diffusive"], ", hyperviscosity", "")
    count = -places.groupby("scene")["scene"].transform("size")
    by = ["count", "scene", "diffusive", "stretch", "froude"]
    return places.assign(title=title, count=count).sort_values(by).drop(columns="count")


def break_even(froude: Sequence[float], ratios: Sequence[float]) -> float:
    """The Froude number up to which a family is cheaper than explicit steppers.

    froude: of places, rising; ratios: of the costs there, NaN where no step has the error, which
    counts as dearer.  Interpolated in the logarithms; 0 where it is dearer everywhere, infinite
    where it is cheaper up to the end, NaN if nothing is known.
    """
    cheaper = [i for i, ratio in enumerate(ratios) if ratio <= 1.0]
    if not cheaper:
        return 0.0 if np.isfinite(ratios).any() else math.nan
    last = cheaper[-1]
    if last == len(ratios) - 1:
        return math.inf
    (f0, f1), (r0, r1) = froude[last : last + 2], ratios[last : last + 2]
    share = math.log(r0) / math.log(r0 / r1) if math.isfinite(r1) else 0.0
    return float(f0 * (f1 / f0) ** share)
