"""Axes of the figures, logarithmic with limits marked and names in the margin; and their SVG."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from io import StringIO
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from swe_sphere.studies.report import words
from swe_sphere.studies.report.palette import Curve, look
from swe_sphere.studies.report.rows import Row

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
