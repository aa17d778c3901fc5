"""Pictures of the map: heat maps of cost ratios with the break-even line, and slices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swe_sphere.arrays import Array
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies import words
from swe_sphere.studies.regimes.points import BASE, OTHERS, Point, Series, ratio
from swe_sphere.studies.report.figures import INK, PAPER, STYLE, finish, look
from swe_sphere.studies.report.rows import LINES

COLOURS = "RdBu_r"
FARTHEST = 3.0
"""The colours end at two to this power and at one over it."""
CELL, MARGIN, TOP = (0.78, 0.52), (0.9, 0.5), 0.8
"""Inches: of a cell, beside and below the cells, and above them."""

Cells = Sequence[Sequence[tuple[Point, float] | None]]
"""The places and the errors by rows and columns of a heat map; None: no such place."""


def by_refinement(of: Sequence[Series], error: float) -> Figure:
    """Ratios by Froude number and refinement, a panel for each family.

    of: series of one scene that differ in their refinement.
    """
    winds = {point.config.settings: point.froude for point in of[0].points}
    places = [{p.config.settings: (p, error) for p in line.points} for line in of]
    cells = [[line.get(wind) for wind in winds] for line in places]
    return _panels(list(winds.values()), [f"{line.stretch:g}" for line in of], "refinement", cells)


def by_error(of: Series, errors: Sequence[float]) -> Figure:
    """Ratios by Froude number and error, a panel for each family."""
    cells = [[(point, error) for point in of.points] for error in errors]
    rows = [words.level(error) for error in errors]
    return _panels([point.froude for point in of.points], rows, "slow-flow error", cells)


def _panels(froude: Sequence[float], rows: Sequence[str], what: str, cells: Cells) -> Figure:
    with mpl.rc_context(STYLE):
        width = len(OTHERS) * (CELL[0] * len(froude) + 0.2) + MARGIN[0]
        size = width, CELL[1] * len(rows) + MARGIN[1] + TOP
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(1, len(OTHERS), sharey=True, squeeze=False)[0]
        for axes, family in zip(panels, OTHERS, strict=True):
            _heat(axes, family, cells)
            axes.set_title(f"{family} : {BASE}", fontsize=9.0)
            axes.set_xticks(range(len(froude)), [words.number(f, 2) for f in froude])
            axes.set_xlabel("U/c")
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        panels[0].set_yticks(range(len(rows)), rows)
        panels[0].set_ylabel(what)
    return figure


def _heat(axes: Axes, family: str, cells: Cells) -> None:
    """The cells with their ratios and the cheapest stepper, and the line where the ratio is 1."""
    values = np.full((len(cells), len(cells[0])), np.nan)
    for row, column in np.ndindex(values.shape):
        if (found := cells[row][column]) is None:
            continue
        point, error = found
        values[row, column] = value = ratio(point, family, error)
        offer = point.best(family, error)
        name = f"{words.number(value, 2)}\n{offer.stepper}" if offer else words.NOTHING
        dark = math.isfinite(value) and abs(math.log2(value)) > 0.6 * FARTHEST
        axes.text(column, row, name, ha="center", va="center", fontsize=6.5,
                  color=PAPER if dark else INK)  # fmt: skip
    _coloured(axes, values)


def _coloured(axes: Axes, values: Array) -> None:
    power = np.log2(values)
    axes.imshow(power, cmap=COLOURS, vmin=-FARTHEST, vmax=FARTHEST, origin="lower", aspect="auto")
    known = power[np.isfinite(power)]
    if min(power.shape) > 1 and known.size and known.min() < 0.0 < known.max():
        axes.contour(np.ma.masked_invalid(power), [0.0], colors=[INK], linewidths=1.6)


def by_step(points: Sequence[Point], error: float) -> Figure:
    """Ratios against the length of the step in gravity limits, a mark for each place."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.subplots()
        for point in points:
            for family in OTHERS:
                if (offer := point.best(family, error)) and (value := ratio(point, family, error)):
                    style, x = look(offer.stepper), offer.dt / point.gravity_limit
                    face = PAPER if point.diffusive else style.colour
                    shape: Any = {"marker": style.marker, "color": style.colour, "linestyle": ""}
                    axes.plot(x, value, markerfacecolor=face, label=offer.stepper, **shape)
        axes.axhline(1.0, color=INK, linewidth=1.6)
        finish(axes, "step with that error [gravity limits]", "cost over that of the best explicit")
        handles, names = axes.get_legend_handles_labels()
        by_name = dict(zip(names, handles, strict=True))
        figure.legend(by_name.values(), by_name.keys(), loc="outside right upper", frameon=False,
                      fontsize=8.0)  # fmt: skip
    return figure


def slices(points: Mapping[str, Point]) -> Figure:
    """Error against cost of all steppers at some places, a panel each, by title."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4 * len(points), 4.6), layout="constrained")
        panels = figure.subplots(1, len(points), sharey=True, squeeze=False)[0]
        names: dict[str, Any] = {}
        for axes, (title, point) in zip(panels, points.items(), strict=True):
            names |= _curves(axes, point)
            axes.set_title(title, fontsize=9.0)
        for axes in panels:  # they share their limits
            finish(axes, "cost of a day [right-hand sides]", "")
        panels[0].set_ylabel("slow-flow error")
        ordered = [name for name in STEPPERS if name in names]
        figure.legend([names[name] for name in ordered], ordered, loc="outside right upper",
                      frameon=False, fontsize=8.0)  # fmt: skip
    return figure


def _curves(axes: Axes, point: Point) -> dict[str, Any]:
    """Draw every stepper, and return its line by its name."""
    drawn = {}
    for name, runs in point.by_stepper.items():
        style, family = look(name), [BASE, *OTHERS].index(STEPPERS[name].family)
        x, y = zip(*((run.cost / point.days, run.error) for run in runs), strict=True)
        shape: Any = {"marker": style.marker, "color": style.colour, "linestyle": LINES[family]}
        (drawn[name],) = axes.plot(x, y, linewidth=1.2, markersize=5.0, **shape)
    return drawn
