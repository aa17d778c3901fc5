"""The page of a map: the rule of thumb with its numbers, heat maps, and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swe_sphere.files.durable import write_whole
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.regimes.places import BASE, OTHERS, UNIT, RegimeMap, break_even, read_map
from swe_sphere.studies.report.figures import INK, PAPER, STYLE, finish, look, svg_text

ERRORS = (1e-2, 3e-3, 1e-3)
USUAL = 3e-3
"""The slow-flow error of the tables and figures that are for one."""
PAGE = "README.md"

FARTHEST = 3.0
"""The colours end at two to this power and at one over it."""
CELL, MARGIN, TOP = (0.78, 0.52), (0.9, 0.5), 0.8
"""Inches: of a cell, beside and below the cells, and above them."""


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
        "swe_sphere.studies.regimes", "page.md.j2", title=title, introduction=introduction,
        rules=[_rule(found.places, usual[usual["family"] == family], family) for family in OTHERS],
        heads=[f"{family} {words.level(error)}" for family, error in shown],
        limits=[[name, *(_limit(of, best[error], family) for family, error in shown)]
                for name, of in series],
        series=series, offers={(of.place, of.family): of for of in usual.itertuples()},
        figures=figures, families=OTHERS, base=BASE, unit=UNIT, usual=words.level(USUAL),
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
    """Return a family's ratios to `BASE` and to `UNIT`, and the steps at which it is cheaper."""
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
    caption = f"Cost ratio against the step, at a slow-flow error of {usual}; open: hyperviscosity"
    made = {"steps": (caption, _by_step(places, best[USUAL]))}
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


def _by_step(places: pd.DataFrame, best: pd.DataFrame) -> Figure:
    """Draw ratios against the length of the step in gravity limits, a mark for each place."""
    shown = best[(best["family"] != BASE) & best["ratio"].notna()]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.subplots()
        for stepper, offers in shown.groupby("stepper"):
            style, label = look(str(stepper)), str(stepper)
            diffusive = offers["place"].map(places["diffusive"])
            for of, face in ((offers[~diffusive], style.colour), (offers[diffusive], PAPER)):
                limits = of["place"].map(places["gravity_limit"])
                axes.plot(of["dt"] / limits, of["ratio"], "", linestyle="", color=style.colour,
                          marker=style.marker, markerfacecolor=face, label=label)  # fmt: skip
                label = ""
        axes.axhline(1.0, color=INK, linewidth=1.6)
        finish(axes, "step with that error [gravity limits]", "cost over that of the best explicit")
        figure.legend(loc="outside right upper", frameon=False, fontsize=8.0)
    return figure
