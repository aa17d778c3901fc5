"""Pictures of the map: heat maps of cost ratios with the break-even line, and slices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swe_sphere.steppers import STEPPERS
from swe_sphere.studies import words
from swe_sphere.studies.regimes.places import BASE, OTHERS, RegimeMap
from swe_sphere.studies.report.figures import INK, PAPER, STYLE, finish, look
from swe_sphere.studies.report.table import LINES

COLOURS = "RdBu_r"
FARTHEST = 3.0
"""The colours end at two to this power and at one over it."""
CELL, MARGIN, TOP = (0.78, 0.52), (0.9, 0.5), 0.8
"""Inches: of a cell, beside and below the cells, and above them."""


def heat_maps(
    froude: Sequence[float], lines: Sequence[tuple[str, pd.DataFrame, Sequence[str]]], what: str
) -> Figure:
    """Cost ratios by Froude number, a panel for each family.

    lines: from below, label, offers as of `RegimeMap.best`, and names of the places by the Froude
    numbers, NaN where there is none; what: the quantity that the labels tell.
    """
    with mpl.rc_context(STYLE):
        width = len(OTHERS) * (CELL[0] * len(froude) + 0.2) + MARGIN[0]
        size = width, CELL[1] * len(lines) + MARGIN[1] + TOP
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(1, len(OTHERS), sharey=True, squeeze=False)[0]
        for axes, family in zip(panels, OTHERS, strict=True):
            _heat(axes, [(best[best["family"] == family], of) for _, best, of in lines])
            axes.set_title(f"{family} : {BASE}", fontsize=9.0)
            axes.set_xticks(range(len(froude)), [words.number(f, 2) for f in froude])
            axes.set_xlabel("U/c")
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        panels[0].set_yticks(range(len(lines)), [label for label, _, _ in lines])
        panels[0].set_ylabel(what)
    return figure


def _heat(axes: Axes, lines: Sequence[tuple[pd.DataFrame, Sequence[str]]]) -> None:
    """The cells with their ratios and the cheapest stepper, and the line where the ratio is 1."""
    found = [best.set_index("place").reindex([*places]) for best, places in lines]
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
    axes.imshow(power, cmap=COLOURS, vmin=-FARTHEST, vmax=FARTHEST, origin="lower", aspect="auto")
    finite = power[np.isfinite(power)]
    if min(power.shape) > 1 and finite.size and finite.min() < 0.0 < finite.max():
        axes.contour(np.ma.masked_invalid(power), [0.0], colors=[INK], linewidths=1.6)


def by_step(places: pd.DataFrame, best: pd.DataFrame) -> Figure:
    """Ratios against the length of the step in gravity limits, a mark for each place."""
    shown = best[(best["family"] != BASE) & best["ratio"].notna()]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.subplots()
        order = {name: n for n, name in enumerate([*places.index, *OTHERS])}
        ordered = shown.sort_values(["place", "family"], key=lambda of: of.map(order))
        for offer in ordered.itertuples():
            place, style = places.loc[offer.place], look(offer.stepper)
            face = PAPER if place.diffusive else style.colour
            shape: Any = {"marker": style.marker, "color": style.colour, "linestyle": ""}
            axes.plot(offer.dt / place.gravity_limit, offer.ratio, markerfacecolor=face,
                      label=offer.stepper, **shape)  # fmt: skip
        axes.axhline(1.0, color=INK, linewidth=1.6)
        finish(axes, "step with that error [gravity limits]", "cost over that of the best explicit")
        handles, names = axes.get_legend_handles_labels()
        _legend(figure, dict(zip(names, handles, strict=True)))
    return figure


def slices(found: RegimeMap, chosen: Mapping[str, pd.Series]) -> Figure:
    """Error against cost of all steppers at some places, a panel each, by title."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4 * len(chosen), 4.6), layout="constrained")
        panels = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
        drawn: dict[str, Any] = {}
        for axes, (title, place) in zip(panels, chosen.items(), strict=True):
            runs = found.runs[found.runs["place"] == place.name]
            for name, of in runs.sort_values("dt", ascending=False).groupby("stepper", sort=False):
                style, family = look(name), [BASE, *OTHERS].index(STEPPERS[name].family)
                shape: Any = {"marker": style.marker, "color": style.colour}
                (drawn[name],) = axes.plot(
                    of["cost"] / place.days, of["error"], linewidth=1.2, markersize=5.0,
                    linestyle=LINES[family], **shape,
                )  # fmt: skip
            axes.set_title(title, fontsize=9.0)
        for axes in panels:  # they share their limits
            finish(axes, "cost of a day [right-hand sides]", "")
        panels[0].set_ylabel("slow-flow error")
        _legend(figure, {name: drawn[name] for name in STEPPERS if name in drawn})
    return figure


def _legend(figure: Figure, handles: Mapping[str, Any]) -> None:
    figure.legend(handles.values(), handles.keys(), loc="outside right upper", frameon=False,
                  fontsize=8.0)  # fmt: skip
