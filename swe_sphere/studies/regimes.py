"""The map of regimes: which family of steppers is cheapest in which flow, on which mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import write_whole
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.report.figures import INK, PAPER, STYLE, svg_text
from swe_sphere.studies.report.ranking import Metric, read_runs
from swe_sphere.studies.sweep.record import (
    RUNS,
    Header,
    build_dataset,
    current,
    read_header,
    runs_of,
)

BASE = "explicit"
OTHERS: tuple[str, ...] = tuple(name for name in get_args(Family) if name != BASE)
CLASSIC = "rk4"
"""The stepper that families are compared with too."""
ERRORS = (1e-2, 3e-3, 1e-3)
USUAL = 3e-3
"""The slow-flow error of the tables and figures that are for one."""
PAGE = "README.md"

FARTHEST = 3.0
"""The colours end at two to this power and at one over it."""
CELL, MARGIN, TOP = (0.78, 0.52), (0.9, 0.5), 0.8
"""Inches: of a cell, beside and below the cells, and above them."""


@dataclass(frozen=True, eq=False)
class RegimeMap:
    """Places, each a scene with its wind on a mesh, and the runs there that came to their end."""

    places: pd.DataFrame
    """Columns: scene, stretch, settings, diffusive (whether there is viscosity), froude (U/c: the
    largest wind over the speed of the fastest gravity waves at the start), gravity_limit [s], days,
    title (of the places that differ in their wind only, which follow each other)."""
    runs: pd.DataFrame
    """place, stepper, dt [s], steps, error (of the slow flow at the end: l2, relative) and cost
    (CPU time, on a GPU wall time [s])."""
    headers: Sequence[Header] = ()
    """The requests of the sweeps."""

    def best(self, error: float) -> pd.DataFrame:
        """The cheapest step with that error of each family at each place, where a run has it.

        Columns: place, family, stepper, dt [s], cost, and the ratios of the cost to that of the
        best explicit step and to that of `CLASSIC`, NaN where that has no such error.
        """
        found = [
            (place, STEPPERS[stepper].family, stepper, *offer)
            for (place, stepper), runs in self.runs.groupby(["place", "stepper"], sort=False)
            if stepper in STEPPERS and (offer := cheapest_step(runs, error)) is not None
        ]
        names = ["place", "family", "stepper", "dt", "cost"]
        offers = pd.DataFrame(found, columns=names).sort_values("cost", kind="stable")
        units = offers[offers["stepper"] == CLASSIC].set_index("place")["cost"]
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
    firsts = runs.drop_duplicates("place").set_index("place")
    runs = runs[(runs["role"] == "grid") & runs["completed"] & runs["error"].notna()]
    for place in runs.loc[~runs["timed"], "place"]:
        raise ConfigError(
            f"{place}: it has runs that were not timed: make the sweeps again without jobs"
        )
    return RegimeMap(ordered_places(firsts), runs, headers)


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


# --- the page


def write_map(folder: Path, *, title: str, introduction: str = "") -> Path:
    """Write README.md and its figures (SVG) beside the sweeps of a map; returns its path.

    Raises:
        ConfigError: there are no sweeps in the folder.
        RunFailed: the disk does not take the files.
    """
    found = read_map(folder)
    best = {error: found.best(error) for error in ERRORS}
    usual, figures = best[USUAL], {}
    for name, (caption, figure) in _figures(found, best).items():
        write_whole(folder / f"{name}.svg", svg_text(figure, name))
        figures[caption] = f"{name}.svg"
    series = [*found.places.groupby("title", sort=False)]
    shown = [(family, error) for family in OTHERS for error in ERRORS]
    text = rendered(
        "swe_sphere.studies", "regimes.md.j2", title=title, introduction=introduction,
        rules=[_rule(found.places, usual[usual["family"] == family], family) for family in OTHERS],
        heads=[f"{family} {words.level(error)}" for family, error in shown],
        limits=[[name, *(_limit(of, best[error], family) for family, error in shown)]
                for name, of in series],
        series=series, offers={(of.place, of.family): of for of in usual.itertuples()},
        figures=figures, families=OTHERS, base=BASE, classic=CLASSIC, usual=words.level(USUAL),
        headers=found.headers, days=sorted({header.created[:10] for header in found.headers}),
    )  # fmt: skip
    write_whole(folder / PAGE, text)
    return folder / PAGE


def _limit(places: pd.DataFrame, best: pd.DataFrame, family: str) -> str:
    """Return the break-even Froude number of a family in a cell."""
    ratios = best[best["family"] == family].set_index("place")["ratio"].reindex(places.index)
    froude = [*places["froude"]]
    limit = break_even(froude, [*ratios])
    if limit == 0.0:
        return f"< {words.number(froude[0], 2)}"
    return f"> {words.number(froude[-1], 2)}" if math.isinf(limit) else words.number(limit, 2)


def _rule(places: pd.DataFrame, best: pd.DataFrame, family: str) -> dict[str, Any]:
    """Return a family's ratios to `BASE` and to `CLASSIC`, and the steps at which it is cheaper."""
    known = best[best["ratio"].notna()]
    steps = known["dt"] / known["place"].map(places["gravity_limit"])
    return {
        "family": family, "ratios": [*known["ratio"]], "beside": [*best["beside"].dropna()],
        "cheaper": [*steps[known["ratio"] <= 1.0]], "dearer": [*steps[known["ratio"] > 1.0]],
    }  # fmt: skip


# --- figures


def _figures(found: RegimeMap, best: dict[float, pd.DataFrame]) -> dict[str, tuple[str, Figure]]:
    """Return captions and figures by name."""
    places, usual = found.places, words.level(USUAL)
    made = {}
    for (scene, diffusive), of in places.groupby(["scene", "diffusive"], sort=False):
        what = f"{scene}{', hyperviscosity' if diffusive else ''}"
        name = what.replace(", ", "-")
        first = of[of["stretch"] == of["stretch"].iloc[0]]
        at = of.reset_index().pivot(index="stretch", columns="settings", values="place")
        lines = [(f"{stretch:g}", best[USUAL], at.loc[stretch, first["settings"]])
                 for stretch in at.index]  # fmt: skip
        if len(lines) > 1:
            caption = f"{what}: cost ratios at a slow-flow error of {usual}, by refinement"
            made[f"{name}-refinement"] = caption, _heat_maps(first["froude"], lines, "refinement")
        caption = f"{what}: cost ratios by slow-flow error, on the uniform mesh"
        lines = [(words.level(error), best[error], first.index) for error in ERRORS]
        made[f"{name}-error"] = caption, _heat_maps(first["froude"], lines, "slow-flow error")
    return made


def _heat_maps(
    froude: Sequence[float], lines: Sequence[tuple[str, pd.DataFrame, Sequence[str]]], what: str
) -> Figure:
    """Draw cost ratios by Froude number, a panel for each family.

    lines: from below, label, offers as of `RegimeMap.best`, and names of the places by the Froude
    numbers, NaN where there is none; what: the quantity that the labels tell.
    """
    with mpl.rc_context(STYLE):
        width = len(OTHERS) * (CELL[0] * len(froude) + 0.2) + MARGIN[0]
        size = width, CELL[1] * len(lines) + MARGIN[1] + TOP
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(1, len(OTHERS), sharey=True, squeeze=False)[0]
        for axes, family in zip(panels, OTHERS, strict=True):
            _draw_heat(axes, [
                best[best["family"] == family].set_index("place").reindex([*of])
                for _, best, of in lines
            ])  # fmt: skip
            axes.set_title(f"{family} : {BASE}", fontsize=9.0)
            axes.set_xticks(range(len(froude)), [words.number(f, 2) for f in froude])
            axes.set_xlabel("U/c")
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        panels[0].set_yticks(range(len(lines)), [label for label, _, _ in lines])
        panels[0].set_ylabel(what)
    return figure


def _draw_heat(axes: Axes, found: Sequence[pd.DataFrame]) -> None:
    """Draw cells with their ratios and the cheapest stepper, and the line where the ratio is 1."""
    power = np.log2([of["ratio"] for of in found])
    for (row, column), value in np.ndenumerate(power):
        offer = found[row].iloc[column]
        if pd.isna(offer.name):
            continue
        known = pd.notna(offer["stepper"])
        name = f"{words.number(offer['ratio'], 2)}\n{offer['stepper']}" if known else words.NOTHING
        dark = math.isfinite(value) and abs(value) > 0.6 * FARTHEST
        axes.text(column, row, name, ha="center", va="center", fontsize=6.5,
                  color=PAPER if dark else INK)  # fmt: skip
    axes.imshow(power, cmap="RdBu_r", vmin=-FARTHEST, vmax=FARTHEST, origin="lower", aspect="auto")
    finite = power[np.isfinite(power)]
    if min(power.shape) > 1 and finite.size and finite.min() < 0.0 < finite.max():
        axes.contour(np.ma.masked_invalid(power), [0.0], colors=[INK], linewidths=1.6)
