"""The figures of a sweep: looks of steppers, axes with limits and names, one panel each; SVG."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from html import escape
from io import StringIO
from operator import itemgetter
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Marker
from swe_sphere.studies import words
from swe_sphere.studies.report.ranking import pareto, with_cost
from swe_sphere.studies.report.table import MADE_FOR_OTHERS, Metric


@dataclass(frozen=True)
class Look:
    """How something is drawn: a colour, and a marker of matplotlib."""

    colour: str
    marker: Marker


GREY = "#7F7F7F"
MARKERS = ("8", "H", "d", "*", "X")
STATUS = {
    "completed": Look("#009E73", "o"),
    "unstable": Look("#D55E00", "X"),
    "timed-out": Look("#E69F00", "s"),
    "solver-failed": Look("#CC79A7", "v"),
    "refused": Look(GREY, "_"),
    "failed": Look("#56B4E9", "P"),
}
"""How the ends of runs are drawn."""


def look(stepper: str) -> Look:
    """The colour and marker of a stepper; of one without, always the same for its name."""
    style = STEPPERS[stepper].style if stepper in STEPPERS else None
    if style is not None:
        return Look(*style)
    place = sum((i + 1) * byte for i, byte in enumerate(stepper.encode()))
    colours = (*COLOURS, GREY)
    return Look(colours[place % len(colours)], MARKERS[place // 7 % len(MARKERS)])


INK, FAINT, GRID, PAPER = "#1b1f24", "#6e7781", "#dfe3e8", "#fefefe"
"""Colours of a figure that follow the page, light or dark; no stepper has one of these."""
THEME = {INK: "var(--ink)", FAINT: "var(--faint)", GRID: "var(--grid)", PAPER: "var(--paper)"}

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

SMALLEST = 1e-17
"""Zero is drawn here."""
LEAST, SHORT = 3.0, 300.0
"""From the lowest to the highest value of axes: at least, and where they have many ticks."""


def finish(axes: Axes, x: str, y: str, scale: Literal["log", "linear"] = "log") -> None:
    """Axes with a grid and readable numbers; x is logarithmic, y as `scale` says."""
    axes.set_xscale("log")
    axes.set_yscale(scale)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    _ticks(axes.xaxis)
    if scale == "log":
        low, high = axes.get_ylim()  # farther apart, so that noise does not fill the axes
        factor = math.sqrt(max(1.0, LEAST * low / high))
        axes.set_ylim(low / factor, high * factor)
        _ticks(axes.yaxis)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _ticks(axis: Axis) -> None:
    """At powers of ten, and on short axes between them."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < SHORT * low else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(_number))


def _number(value: float, _: object = None) -> str:
    return f"{value:g}" if 1e-2 <= value < 1e6 else words.level(value)


def mark_limits(axes: Axes, runs: pd.DataFrame) -> None:
    """Vertical lines at the gravity-wave and the advective limit of the step."""
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


WIDTH, HEIGHT = 5.4, 3.7
"""Inches: on a telephone a point of text is about a pixel."""
DRIFTS = {"mass_drift": "mass", "energy_drift": "energy", "enstrophy_drift": "potential enstrophy"}
COUNTS = {"krylov": "Krylov", "newton": "Newton"}
FRONT = "The ringed points are the Pareto front: nothing measured is both cheaper and better."
LIMIT_CAPTION = (
    "Gravity limit: of leapfrog without filter; advective limit: the same for the wind alone."
)


@dataclass(frozen=True)
class Diagram:
    """A figure that can be drawn."""

    name: str
    """Of its files, without ending."""
    title: str
    caption: str
    draw: Callable[[Axes, str], None]
    """Draws it into axes; the second argument goes before the numbers of runs in links."""
    height: float = HEIGHT


def render(diagram: Diagram, anchor: str = "row") -> Figure:
    """Draw a diagram as a figure of its own."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, diagram.height), layout="constrained")
        diagram.draw(figure.subplots(), anchor)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # laid out once for all formats
    return figure


def error_diagrams(runs: pd.DataFrame, metric: Metric) -> list[Diagram]:
    """What an error costs on one mesh, and how it depends on the step."""
    clock, (label, _, _) = runs["clock"].iloc[0], metric.label.partition(" at day")
    costs = {
        "time": ("cost", clock, f"{clock} of the steps [s]"),
        "work": ("evaluations", "work", "right-hand sides and Jacobian products"),
    }
    time, work = (
        [Diagram(
            f"{metric.name}_{name}", f"Error against {title}", f"{metric.label}. {FRONT}",
            partial(_draw_costs, runs, metric, cost, axis, label),
        )] if len(with_cost(runs, metric, cost)) else []
        for name, (cost, title, axis) in costs.items()
    )  # fmt: skip
    caption = f"{metric.label}. {LIMIT_CAPTION}"
    step = _by_step(runs, runs[metric], f"{metric.name}_step", "Error against Δt", caption, label)
    return [*time, *step, *work]


def diagrams(runs: pd.DataFrame) -> list[Diagram]:
    """What does not depend on the choice of an error: counts, drifts, how runs ended."""
    found = []
    for name, what in COUNTS.items():
        values, title = runs[f"{name}_a_step"], f"{what} iterations a step"
        none = "By Δt; explicit steppers have none."
        found += _by_step(
            runs, values.where(values > 0.0), f"{name}_iterations", title, none, title
        )
    for name, what in DRIFTS.items():
        caption = "Size of the relative change over the run, by Δt."
        label = f"|relative change of {what}|"
        found += _by_step(runs, runs[name].abs(), name, f"Drift of {what}", caption, label)
    shown = runs[(runs["role"] != MADE_FOR_OTHERS) & (runs["dt"] > 0.0)]
    if len(shown):
        caption = "Every run by stepper and Δt; failures are told below."
        height = 1.4 + 0.25 * shown["curve"].nunique()
        draw = partial(_draw_ends, shown)
        found.append(Diagram("stability", "How runs ended", caption, draw, height))
    return found


def _by_step(
    runs: pd.DataFrame, values: pd.Series, name: str, title: str, caption: str, label: str
) -> list[Diagram]:
    """The diagram of values of runs, where there are any."""
    runs = runs.assign(value=values)
    shown = runs[runs["compared"] & (runs["dt"] > 0.0) & np.isfinite(values)]
    draw = partial(_draw_by_step, shown, label)
    return [Diagram(name, title, caption, draw)] if len(shown) else []


def _draw_costs(
    runs: pd.DataFrame,
    metric: Metric,
    cost: str,
    label: str,
    ordinate: str,
    axes: Axes,
    anchor: str,
) -> None:
    front = pareto(runs, metric, cost)
    x, y = front[cost], front[metric].clip(lower=SMALLEST)
    axes.plot(x, y, color=INK, linewidth=3.5, alpha=0.12, drawstyle="steps-post", zorder=1)
    axes.scatter(x, y, s=95, facecolors="none", edgecolors=INK, linewidths=0.9, zorder=4)
    drawn = with_cost(runs, metric, cost)
    if cost == "cost":
        least = np.maximum(drawn["least"], 0.1 * drawn["cost"])  # zero is not on the axis
        colours = [look(of).colour for of in drawn["stepper"]]
        heights = drawn[metric].clip(lower=SMALLEST)
        axes.hlines(heights, least, drawn["most"], colours, linewidth=2.6, alpha=0.4, zorder=2)
    _draw_curves(axes, drawn, cost, metric, anchor)
    finish(axes, label, ordinate)


def _draw_by_step(runs: pd.DataFrame, label: str, axes: Axes, anchor: str) -> None:
    _draw_curves(axes, runs, "dt", "value", anchor)
    mark_limits(axes, runs)
    finish(axes, "Δt [s]", label)


def _draw_curves(axes: Axes, runs: pd.DataFrame, x: str, y: str | Metric, anchor: str) -> None:
    """Curves through runs, with their names right of the axes in the order of their ends."""
    handles = []
    for label, curve in runs.sort_values("dt", kind="stable").groupby("curve"):
        style, line = look(curve["stepper"].iloc[0]), curve["line"].iloc[0]
        shape: Any = {"color": style.colour, "marker": style.marker, "linestyle": line}
        heights = curve[y].clip(lower=SMALLEST)
        axes.plot(curve[x], heights, line, color=style.colour, linewidth=1.3)
        _draw_points(axes, curve, x, heights, style, anchor, s=40, linewidths=0.5)
        end = curve.sort_values([x, y])[y].iloc[-1]
        handles.append((-end, Line2D([], [], markersize=5.5, label=label, **shape)))
    axes.legend(
        handles=[handle for _, handle in sorted(handles, key=itemgetter(0))], loc="upper left",
        bbox_to_anchor=(1.0, 1.02), frameon=False, fontsize=8.5, labelcolor=INK, handlelength=2.4,
    )  # fmt: skip


def _draw_points(
    axes: Axes, runs: pd.DataFrame, x: str, y: Any, style: Look, anchor: str, **more: Any
) -> None:
    """Points, each of which is a link to its run: `anchor` before its number."""
    edges = None if style.marker == "_" else PAPER
    dots = axes.scatter(
        runs[x], y, marker=style.marker, c=style.colour, zorder=3, edgecolors=edges, **more
    )  # fmt: skip
    dots.set_urls([f"#{anchor}-{number}" for number in runs["number"]])


def _draw_ends(runs: pd.DataFrame, axes: Axes, anchor: str) -> None:
    """How every run ended, by stepper and step."""
    order = {name: i for i, name in enumerate(STEPPERS)}
    steppers = runs.groupby("curve")["stepper"].first()
    labels = sorted(steppers.index, key=lambda of: order.get(steppers[of], len(order)))[::-1]
    for (curve, status), found in runs.groupby(["curve", "status"]):
        style, height = STATUS[status], [labels.index(curve)] * len(found)
        width = 2.0 if style.marker == "_" else 0.8
        _draw_points(axes, found, "dt", height, style, anchor, s=46, linewidths=width)
    mark_limits(axes, runs)
    finish(axes, "Δt [s]", "", scale="linear")
    axes.set_ylim(-0.6, len(labels) - 0.4)
    axes.set_yticks(range(len(labels)), labels)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    marks = [
        Line2D([], [], marker=style.marker, color=style.colour, linestyle="", label=status)
        for status, style in STATUS.items()
        if (runs["status"] == status).any()
    ]
    axes.figure.legend(
        handles=marks, loc="outside lower center", ncols=3, frameon=False, fontsize=8.5,
        labelcolor=INK, handletextpad=0.2,
    )  # fmt: skip
    axes.tick_params(colors=FAINT, labelcolor=INK)


def save_svg(figure: Figure, name: str) -> str:
    """The text of an SVG file; the same figure gives the same bytes."""
    out = StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with mpl.rc_context(STYLE | {"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata=nothing)
    return out.getvalue()


def inline(svg: str, name: str, title: str, tips: Mapping[str, str]) -> str:
    """An SVG file's text as an element of a page that can hold others.

    name: made part of every id, so that ids differ between figures.
    title: read out in place of the picture.  tips: the target of a link -> what to show over it.
    """
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<style.*?</style>", "", text)  # the page has it
    text = re.sub(r'(<use xlink:href="#|url\(#| id=")', rf"\1{name}-", text)
    text = re.sub(r'<a xlink:href="#([^"]*)"[^>]*>', lambda m: _link(m[1], tips[m[1]]), text)
    text = text.replace("xlink:href", "href")
    for colour, variable in THEME.items():
        text = text.replace(colour, variable)
    size = re.search(r'viewBox="[^"]*"', text)
    head = f'<svg {size[0] if size else ""} role="img" aria-label="{escape(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: head, text, count=1)


def _link(target: str, tip: str) -> str:
    return f'<a href="#{target}"><title>{escape(tip)}</title>'
