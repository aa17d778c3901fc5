"""The figures of a sweep: looks of steppers, axes with limits and names, one panel each; SVG."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from io import StringIO
from operator import attrgetter
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Marker
from swe_sphere.studies import words
from swe_sphere.studies.report.ranking import Cost, cost, pareto, with_cost
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Curve, Metric, Row, curves


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
    "font.family": "DejaVu Sans",
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
FONTS = "font-family:'DejaVu Sans',Verdana,system-ui,sans-serif"

SMALLEST = 1e-17
"""Zero is drawn here."""
LEAST, SHORT = 3.0, 300.0
"""From the lowest to the highest value of axes: at least, and where they have many ticks."""
LIMITS = (
    ("gravity_limit", "gravity limit", "right"),
    ("advective_limit", "advective limit", "left"),
)
"""Of the step: attribute of a row, name, side of the line on which the text ends."""


def finish(axes: Axes, x: str, y: str, scale: Literal["log", "linear"] = "log") -> None:
    """Axes with a grid and readable numbers; x is logarithmic, y as `scale` says."""
    axes.set_xscale("log")
    axes.set_yscale(scale)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    _ticks(axes.xaxis)
    if scale == "log":
        axes.set_ylim(*_widened(*axes.get_ylim()))
        _ticks(axes.yaxis)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _widened(low: float, high: float) -> tuple[float, float]:
    """Limits at least a factor of LEAST apart, so that noise does not fill the axes."""
    factor = math.sqrt(max(1.0, LEAST * low / high))
    return low / factor, high * factor


def _ticks(axis: Axis) -> None:
    """At powers of ten, and on short axes between them."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < SHORT * low else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(_number))


def _number(value: float, _: object = None) -> str:
    return f"{value:g}" if 1e-2 <= value < 1e6 else words.level(value)


def points(axes: Axes, curve: Curve, xy: Sequence[tuple[float, float]], anchor: str) -> None:
    """A curve through its rows; each point is a link to its row, `anchor` before its number."""
    x, y = np.array(xy, dtype=float).T
    y = np.maximum(y, SMALLEST)
    style = look(curve.stepper)
    axes.plot(x, y, curve.line, color=style.colour, linewidth=1.3)
    dots = axes.scatter(
        x, y, s=40, marker=style.marker, zorder=3, linewidths=0.5, c=style.colour,
        edgecolors=PAPER,
    )  # fmt: skip
    dots.set_urls([f"#{anchor}-{row.number}" for row in curve.rows])


def mark_limits(axes: Axes, rows: Iterable[Row]) -> None:
    """Vertical lines at the gravity-wave and the advective limit of the step."""
    rows = list(rows)
    for name, title, side in LIMITS:
        values = [v for row in rows if math.isfinite(v := getattr(row, name)) and v > 0.0]
        if not values:
            continue
        where = float(np.median(values))
        axes.axvline(where, color=FAINT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
        axes.text(
            where, 1.01, f" {title} \n {words.step(where)} ", va="bottom", ha=side, fontsize=7.5,
            color=FAINT, transform=axes.get_xaxis_transform(),
        )  # fmt: skip


def name_curves(axes: Axes, ends: Mapping[Curve, float]) -> None:
    """Names right of the axes, in the order of the heights of the curves' ends."""
    handles: list[Any] = []
    for curve in sorted(ends, key=lambda curve: -ends[curve]):
        style = look(curve.stepper)
        shape: Any = {"color": style.colour, "marker": style.marker, "linestyle": curve.line}
        handles.append(Line2D([], [], markersize=5.5, label=curve.label, **shape))
    if handles:
        axes.legend(
            handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False,
            fontsize=8.5, labelcolor=INK, handlelength=2.4,
        )  # fmt: skip


WIDTH, HEIGHT = 5.4, 3.7
"""Inches: on a telephone a point of text is about a pixel."""
DRIFTS = {"mass_drift": "mass", "energy_drift": "energy", "enstrophy_drift": "potential enstrophy"}
COUNTS = {"krylov_iterations": "Krylov", "newton_iterations": "Newton"}
FRONT = "The ringed points are the Pareto front: nothing measured is both cheaper and better."
LIMIT_CAPTION = (
    "Gravity limit: of leapfrog without filter; advective limit: the same for the wind alone."
)

Position = Callable[[Row], tuple[float, float]]


@dataclass(frozen=True)
class Diagram:
    """A figure that can be drawn."""

    name: str
    """Of its files, without ending."""
    title: str
    caption: str
    draw: Callable[[Axes, str], None]
    """Draws it into axes; the second argument goes before row numbers in links."""
    height: float = HEIGHT


def render(diagram: Diagram, anchor: str = "row") -> Figure:
    """Draw a diagram as a figure of its own."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, diagram.height), layout="constrained")
        diagram.draw(figure.subplots(), anchor)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # laid out once for all formats
    return figure


def error_diagrams(rows: Sequence[Row], metric: Metric) -> list[Diagram]:
    """What an error costs on one mesh, and how it depends on the step."""
    clock = rows[0].clock
    label = f"{clock} of the steps [s]"
    time = _against(rows, metric, f"{metric.name}_time", clock, cost, label)
    name, unit = f"{metric.name}_work", "right-hand sides and Jacobian products"
    work = _against(rows, metric, name, "work", attrgetter("evaluations"), unit)
    step = _by_step(
        rows, f"{metric.name}_step", "Error against Δt", f"{metric.label}. {LIMIT_CAPTION}",
        _axis(metric), lambda row: row.error(metric),
    )  # fmt: skip
    return [*time, *step, *work]


def diagrams(rows: Sequence[Row]) -> list[Diagram]:
    """What does not depend on the choice of an error: counts, drifts, how runs ended."""
    none, size = "By Δt; explicit steppers have none.", "Size of the relative change over the run"
    counts = [
        (name, f"{what} iterations a step", none, f"{what} iterations a step", _per_step)
        for name, what in COUNTS.items()
    ]
    drifts = [
        (name, f"Drift of {what}", f"{size}, by Δt.", f"|relative change of {what}|", _size)
        for name, what in DRIFTS.items()
    ]
    by_step = [
        _by_step(rows, name, title, caption, label, partial(of, name))
        for name, title, caption, label, of in (*counts, *drifts)
    ]
    return [diagram for found in (*by_step, _map(rows)) for diagram in found]


def _axis(metric: Metric) -> str:
    return metric.label.split(" at day")[0]


def _per_step(name: str, row: Row) -> float:
    return row.per_step(name) or math.nan


def _size(name: str, row: Row) -> float:
    return abs(float(getattr(row, name)))


def _against(
    rows: Sequence[Row], metric: Metric, name: str, title: str, of: Cost, label: str
) -> list[Diagram]:
    """Error against a cost, where there is any."""
    if not with_cost(rows, metric, of):
        return []
    draw = partial(_draw_costs, rows, metric, of, label)
    return [Diagram(name, f"Error against {title}", f"{metric.label}. {FRONT}", draw)]


def _by_step(
    rows: Sequence[Row], name: str, title: str, caption: str, label: str,
    value: Callable[[Row], float],
) -> list[Diagram]:  # fmt: skip
    shown = [row for row in rows if row.compared and row.dt > 0.0 and math.isfinite(value(row))]
    draw = partial(_draw_by_step, shown, value, label)
    return [Diagram(name, title, caption, draw)] if shown else []


def _map(rows: Sequence[Row]) -> list[Diagram]:
    rows = [row for row in rows if row.role not in MADE_FOR_OTHERS and row.dt > 0.0]
    caption = "Every run by stepper and Δt; failures are told below."
    height = 1.4 + 0.25 * len(curves(rows))
    chart = Diagram("stability", "How runs ended", caption, partial(_draw_map, rows), height)
    return [chart] if rows else []


def _draw_costs(
    rows: Sequence[Row], metric: Metric, of: Cost, label: str, axes: Axes, anchor: str
) -> None:
    front = pareto(rows, metric, of)
    x, y = zip(*((of(row), max(row.error(metric), SMALLEST)) for row in front), strict=True)
    axes.plot(x, y, color=INK, linewidth=3.5, alpha=0.12, drawstyle="steps-post", zorder=1)
    axes.scatter(x, y, s=95, facecolors="none", edgecolors=INK, linewidths=0.9, zorder=4)
    drawn = curves(with_cost(rows, metric, of))
    if of is cost:
        _draw_uncertainty(axes, drawn, metric)
    _draw_curves(axes, drawn, lambda row: (of(row), row.error(metric)), anchor)
    finish(axes, label, _axis(metric))


def _draw_by_step(
    rows: Sequence[Row], value: Callable[[Row], float], label: str, axes: Axes, anchor: str
) -> None:
    _draw_curves(axes, curves(rows), lambda row: (row.dt, value(row)), anchor)
    mark_limits(axes, rows)
    finish(axes, "Δt [s]", label)


def _draw_curves(axes: Axes, drawn: Sequence[Curve], position: Position, anchor: str) -> None:
    for curve in drawn:
        points(axes, curve, [position(row) for row in curve.rows], anchor)
    name_curves(axes, {curve: max(map(position, curve.rows))[1] for curve in drawn})


def _draw_uncertainty(axes: Axes, drawn: Sequence[Curve], metric: Metric) -> None:
    for curve in drawn:
        for row in curve.rows:
            low, high = row.interval
            axes.plot(
                [max(low, 0.1 * row.cost), high],  # zero is not on the axis
                [max(row.error(metric), SMALLEST)] * 2,
                color=look(curve.stepper).colour, linewidth=2.6, alpha=0.4, zorder=2,
            )  # fmt: skip


def _draw_map(rows: Sequence[Row], axes: Axes, anchor: str) -> None:
    """How every run ended, by stepper and step."""
    order = {name: i for i, name in enumerate(STEPPERS)}
    drawn = sorted(curves(rows), key=lambda c: order.get(c.stepper, len(order)))[::-1]
    for height, curve in enumerate(drawn):
        _draw_ends(axes, curve, height, anchor)
    mark_limits(axes, rows)
    finish(axes, "Δt [s]", "", scale="linear")
    axes.set_ylim(-0.6, len(drawn) - 0.4)
    axes.set_yticks(range(len(drawn)), [curve.label for curve in drawn])
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    _explain_marks(axes, {row.status for row in rows})


def _draw_ends(axes: Axes, curve: Curve, height: int, anchor: str) -> None:
    for status, style in STATUS.items():
        if rows := [row for row in curve.rows if row.status == status]:
            line = style.marker == "_"
            dots = axes.scatter(
                [row.dt for row in rows], [height] * len(rows), s=46, marker=style.marker,
                c=style.colour, linewidths=2.0 if line else 0.8, zorder=3,
                edgecolors=None if line else PAPER,
            )  # fmt: skip
            dots.set_urls([f"#{anchor}-{row.number}" for row in rows])


def _explain_marks(axes: Axes, found: set[str]) -> None:
    marks = [
        Line2D([], [], marker=style.marker, color=style.colour, linestyle="", label=status)
        for status, style in STATUS.items()
        if status in found
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
    with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata=nothing)
    return _shortened(out.getvalue()) + "\n"


def _shortened(text: str) -> str:
    """An SVG file without what changes nothing to the eye."""
    text = re.sub(r"<metadata>.*?</metadata>|<!DOCTYPE.*?>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"(\d\.\d{2})\d{3,}", r"\1", text)  # hundredths of a point are fine enough
    text = re.sub(r"\s*font-family: [^;\"]*;?", "", text)
    text = text.replace("</style>", f" text{{{FONTS}}}</style>")
    text = re.sub(r">\s+<", "><", re.sub(r"\s*\n\s*", " ", text))
    meant = set(re.findall(r"#([\w.-]+)[\")]", text))
    return re.sub(r' id="([^"]*)"', lambda m: m[0] if m[1] in meant else "", text)


def inline(svg: str, name: str, title: str, tips: Mapping[str, str]) -> str:
    """An SVG file's text as an element of a page that can hold others.

    name: made part of every id, so that ids differ between figures.
    title: read out in place of the picture.  tips: the target of a link -> what to show over it.
    """
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<style.*?</style>", "", text)  # the page has it
    text = re.sub(r'\s+xmlns(?::\w+)?="[^"]*"', "", text)
    text = text.replace('<use xlink:href="#', f'<use href="#{name}-')
    text = text.replace("url(#", f"url(#{name}-").replace(' id="', f' id="{name}-')
    text = re.sub(r'<a xlink:href="(#[^"]*)"[^>]*>', lambda m: _link(m[1], tips), text)
    for colour, variable in THEME.items():
        text = text.replace(colour, variable)
    size = re.search(r'viewBox="[^"]*"', text)
    head = f'<svg {size[0] if size else ""} role="img" aria-label="{escape(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: head, text, count=1)


def _link(target: str, tips: Mapping[str, str]) -> str:
    tip = tips.get(target.removeprefix("#"))
    return f'<a href="{target}">' + (f"<title>{escape(tip)}</title>" if tip else "")
