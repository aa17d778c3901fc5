"""The figures of a sweep: looks of steppers, and curves through runs on logarithmic axes; SVG."""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import StringIO
from operator import itemgetter
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Marker
from swe_sphere.studies import words
from swe_sphere.studies.report.ranking import FAILED, Metric, pareto, with_cost


class Look(NamedTuple):
    """How a stepper is drawn: a colour, and a marker of matplotlib."""

    colour: str
    marker: Marker


INK, FAINT, GRID, PAPER = "#1b1f24", "#6e7781", "#dfe3e8", "#fefefe"
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.facecolor": PAPER,
    "figure.facecolor": PAPER,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
}
MARKERS = ("8", "H", "d", "*", "X")
"""Markers of steppers that declare none."""
SIZE = (5.4, 3.7)
"""Size of a figure [inches]: on a telephone a point of text is about a pixel."""
SMALLEST = 1e-17
"""Zero is drawn here."""
LEAST, SHORT = 3.0, 300.0
"""Ratio of the highest to the lowest value of an axis: at least, and where it has many ticks."""

FRONT = "The ringed points are the Pareto front: nothing measured is both cheaper and better."
LIMITS = (
    "Gravity limit: of leapfrog without filter; advective limit: the same for the wind alone."
    " Crosses at the top: runs that became unstable or whose solver failed."
)


def look(stepper: str) -> Look:
    """Return the colour and marker of a stepper; of one without, always the same for its name."""
    style = STEPPERS[stepper].style if stepper in STEPPERS else None
    if style is not None:
        return Look(*style)
    place = sum((i + 1) * byte for i, byte in enumerate(stepper.encode()))
    return Look(COLOURS[place % len(COLOURS)], MARKERS[place // 7 % len(MARKERS)])


@dataclass(frozen=True, eq=False)
class Diagram:
    """Curves through runs of one mesh that can be drawn: a column against another."""

    name: str
    """Part of the name of its file."""
    title: str
    caption: str
    x: str
    x_label: str
    y: str | Metric
    y_label: str
    runs: pd.DataFrame
    """Runs on the curves."""
    marked: pd.DataFrame
    """Runs on the Pareto front, or against the step the failed ones."""


def error_diagrams(runs: pd.DataFrame, metric: Metric) -> list[Diagram]:
    """Return the diagrams of an error on one mesh: against the cost and against the step."""
    clock, (label, _, _) = runs["clock"].iloc[0], metric.label.partition(" at day")
    cost = Diagram(
        f"{metric.name}_time", f"Error against {clock}", f"{metric.label}. {FRONT}",
        "cost", f"{clock} of the steps [s]", metric, label,
        with_cost(runs, metric), pareto(runs, metric),
    )  # fmt: skip
    step = _by_step(runs, metric, f"{metric.name}_step", "Error against Δt", metric.label, label)
    return [diagram for diagram in (cost, step) if len(diagram.runs)]


def other_diagrams(runs: pd.DataFrame) -> list[Diagram]:
    """Return the diagrams of iterations and energy, which do not depend on the choice of error."""
    krylov, drift = runs["krylov_a_step"], runs["energy_drift"].abs()
    runs = runs.assign(krylov_a_step=krylov.where(krylov > 0.0), energy_drift=drift)
    found = (
        _by_step(runs, "krylov_a_step", "krylov_iterations", "Krylov iterations a step",
                 "Explicit steppers have none", "Krylov iterations a step"),
        _by_step(runs, "energy_drift", "energy_drift", "Drift of energy",
                 "Size of the relative change over the run", "|relative change of energy|"),
    )  # fmt: skip
    return [diagram for diagram in found if len(diagram.runs)]


def _by_step(
    runs: pd.DataFrame, y: str | Metric, name: str, title: str, what: str, label: str
) -> Diagram:
    shown = runs[runs["compared"] & (runs["dt"] > 0.0) & np.isfinite(runs[y])]
    caption, failed = f"{what}. {LIMITS}", runs[runs["status"].isin(FAILED)]
    return Diagram(name, title, caption, "dt", "Δt [s]", y, label, shown, failed)


def render(diagram: Diagram) -> Figure:
    """Draw a diagram."""
    runs, marked, x, y = diagram.runs, diagram.marked, diagram.x, diagram.y
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE, layout="constrained")
        axes = figure.subplots()
        if x == "dt":
            colours = [look(stepper).colour for stepper in marked["stepper"]]
            axes.scatter(marked["dt"], [0.98] * len(marked), c=colours, s=22.0, marker="x",
                         transform=axes.get_xaxis_transform())  # fmt: skip
            _mark_limits(axes, runs)
        else:
            front = marked[x], marked[y].clip(lower=SMALLEST)
            axes.plot(*front, color=INK, linewidth=3.5, alpha=0.12, drawstyle="steps-post")
            axes.scatter(*front, 95.0, facecolors="none", edgecolors=INK, linewidths=0.9, zorder=4)
            least = np.maximum(runs["least"], 0.1 * runs["cost"])  # zero is not on the axis
            colours = [look(stepper).colour for stepper in runs["stepper"]]
            heights = runs[y].clip(lower=SMALLEST)
            axes.hlines(heights, least, runs["most"], colours, linewidth=2.6, alpha=0.4)
        _draw_curves(axes, runs, x, y)
        finish(axes, diagram.x_label, diagram.y_label)
    return figure


def _draw_curves(axes: Axes, runs: pd.DataFrame, x: str, y: str | Metric) -> None:
    """Draw curves, with their names right of the axes in the order of their ends."""
    handles = []
    for label, curve in runs.sort_values("dt", kind="stable").groupby("curve"):
        style, end = look(curve["stepper"].iloc[0]), curve.sort_values([x, y])[y].iloc[-1]
        (line,) = axes.plot(
            curve[x], curve[y].clip(lower=SMALLEST), curve["line"].iloc[0], color=style.colour,
            marker=style.marker, markersize=6.0, linewidth=1.3, label=label,
        )  # fmt: skip
        handles.append((-end, line))
    axes.legend(
        handles=[line for _, line in sorted(handles, key=itemgetter(0))], loc="upper left",
        bbox_to_anchor=(1.0, 1.02), frameon=False, fontsize=8.5, handlelength=2.4,
    )  # fmt: skip


def _mark_limits(axes: Axes, runs: pd.DataFrame) -> None:
    """Draw vertical lines at the gravity-wave and the advective limit of the step."""
    for title, side in (("gravity limit", "right"), ("advective limit", "left")):
        limits = runs[title.replace(" ", "_")]
        known = limits[limits.between(0.0, math.inf, inclusive="neither")]
        if known.empty:
            continue
        where = float(known.median())
        axes.axvline(where, color=FAINT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
        axes.text(
            where, 1.01, f" {title} \n {words.step(where)} ", va="bottom", ha=side, fontsize=7.5,
            color=FAINT, transform=axes.get_xaxis_transform(),
        )  # fmt: skip


def finish(axes: Axes, x: str, y: str) -> None:
    """Give logarithmic axes their names, a grid and readable numbers."""
    axes.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
    low, high = axes.get_ylim()  # farther apart, so that noise does not fill the axes
    factor = math.sqrt(max(1.0, LEAST * low / high))
    axes.set_ylim(low / factor, high * factor)
    for axis in (axes.xaxis, axes.yaxis):
        _set_ticks(axis)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _set_ticks(axis: Axis) -> None:
    """Set ticks at powers of ten, and on short axes between them."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < SHORT * low else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(_number))


def _number(value: float, _: object = None) -> str:
    return f"{value:g}" if 1e-2 <= value < 1e6 else words.level(value)


def svg_text(figure: Figure, name: str) -> str:
    """Return the text of an SVG file; the same figure gives the same bytes."""
    out = StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with mpl.rc_context(STYLE | {"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata=nothing)
    return out.getvalue()
