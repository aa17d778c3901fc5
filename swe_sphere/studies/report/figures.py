"""The figures of a sweep: looks of steppers, and curves through runs on logarithmic axes; SVG."""

import math
import tomllib
from base64 import b64encode
from collections.abc import Iterator
from io import StringIO
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from swe_sphere.studies import words
from swe_sphere.studies.report.ranking import FAILED, Metric, with_cost

Marker = str | tuple[int, int, int]
INK, FAINT = "#1b1f24", "#6e7781"
STYLE = Path(__file__).with_name("templates") / "figures.mplstyle"
LOOKS = tomllib.loads(STYLE.with_name("looks.toml").read_text("utf-8"))
"""Colours and markers of the steppers of the package."""
CUSTOM = ("#00005a", "#3c0000", "#961e00", "#96965a"), ("1", "2", "3", "4", "+")
"""Colours and markers of other steppers, which are far from those of the package."""
SIZE = (5.4, 3.7)
"""Size of a figure [inches]: on a telephone a point of text is about a pixel."""
SMALLEST = 1e-17
"""Zero is drawn here."""
LEAST, SHORT = 3.0, 300.0
"""Ratio of the highest to the lowest value of an axis: at least, and where it has many ticks."""

LIMITS = (
    "Gravity limit: of leapfrog without filter; advective limit: the same for the wind alone."
    " Crosses at the top: runs that became unstable or whose solver failed."
)


def look(stepper: str) -> tuple[str, Marker]:
    """Return the colour and marker of a stepper; of a custom one, always the same for its name."""
    if stepper in LOOKS:
        colour, marker = LOOKS[stepper]
        return colour, marker if isinstance(marker, str) else tuple(marker)
    place = sum((i + 1) * byte for i, byte in enumerate(stepper.encode()))
    colours, markers = CUSTOM
    return colours[place % len(colours)], markers[place // 4 % len(markers)]


class Picture(NamedTuple):
    """A figure of a sweep."""

    name: str
    """Name of its file."""
    title: str
    caption: str
    svg: str

    @property
    def inline(self) -> str:
        """Address of the figure that contains all of it."""
        return f"data:image/svg+xml;base64,{b64encode(self.svg.encode()).decode()}"


def error_pictures(runs: pd.DataFrame, metric: Metric, where: str) -> Iterator[Picture]:
    """Draw an error on one mesh against the cost and against the step, where runs are known.

    where: first part of the names of files.
    """
    (label, _, _), name = metric.label.partition(" at day"), f"{where}-{metric.name}"
    timed = with_cost(runs, metric)
    for clock in timed["clock"].head(1):
        svg = _drawn(timed, runs[:0], "cost", metric, (f"{clock} of the steps [s]", label))
        caption = f"{metric.label}. Bars: how well the times are known."
        yield Picture(f"{name}_time.svg", f"Error against {clock}", caption, svg)
    yield from _by_step(runs, metric, f"{name}_step.svg", "Error against Δt", metric.label, label)


def other_pictures(runs: pd.DataFrame, where: str) -> Iterator[Picture]:
    """Draw iterations and energy, which do not depend on the choice of error."""
    krylov, drift = runs["krylov_a_step"], runs["energy_drift"].abs()
    runs = runs.assign(krylov_a_step=krylov.where(krylov > 0.0), energy_drift=drift)
    name, title = f"{where}-krylov_iterations.svg", "Krylov iterations a step"
    yield from _by_step(runs, "krylov_a_step", name, title, "Explicit steppers have none", title)
    name, what = f"{where}-energy_drift.svg", "Size of the relative change over the run"
    label = "|relative change of energy|"
    yield from _by_step(runs, "energy_drift", name, "Drift of energy", what, label)


def _by_step(
    runs: pd.DataFrame, y: str | Metric, name: str, title: str, what: str, label: str
) -> Iterator[Picture]:
    shown = runs[runs["compared"] & (runs["dt"] > 0.0) & np.isfinite(runs[y])]
    if len(shown):
        svg = _drawn(shown, runs[runs["status"].isin(FAILED)], "dt", y, ("Δt [s]", label))
        yield Picture(name, title, f"{what}. {LIMITS}", svg)


def _drawn(
    runs: pd.DataFrame, failed: pd.DataFrame, x: str, y: str | Metric, labels: tuple[str, str]
) -> str:
    """Draw curves through runs, a column against another; failed: runs that failed."""
    with style.context(STYLE):
        figure = Figure(figsize=SIZE, layout="constrained")
        axes = figure.subplots()
        if x == "dt":
            _mark_limits(axes, runs, failed)
        else:
            least = np.maximum(runs["least"], 0.1 * runs["cost"])  # zero is not on the axis
            colours = [look(name)[0] for name in runs["stepper"]]
            heights = runs[y].clip(lower=SMALLEST)
            axes.hlines(heights, least, runs["most"], colours, linewidth=2.6, alpha=0.4)
        _draw_curves(axes, runs, x, y)
        finish(axes, *labels)
    return svg_text(figure, str(y))


def _draw_curves(axes: Axes, runs: pd.DataFrame, x: str, y: str | Metric) -> None:
    """Draw curves, with their names right of the axes in the order of their ends."""
    handles = []
    for label, curve in runs.sort_values("dt", kind="stable").groupby("curve"):
        colour, marker = look(curve["stepper"].iloc[0])
        (line,) = axes.plot(
            curve[x], curve[y].clip(lower=SMALLEST), curve["line"].iloc[0], color=colour,
            marker=marker, markersize=6.0, linewidth=1.3, label=label,
        )  # fmt: skip
        handles.append((-curve.sort_values([x, y])[y].iloc[-1], line))
    axes.legend(
        handles=[line for _, line in sorted(handles, key=itemgetter(0))], loc="upper left",
        bbox_to_anchor=(1.0, 1.02), fontsize=8.5, handlelength=2.4,
    )  # fmt: skip


def _mark_limits(axes: Axes, runs: pd.DataFrame, failed: pd.DataFrame) -> None:
    """Draw lines at the gravity-wave and the advective limit, and crosses at steps that failed."""
    colours = [look(name)[0] for name in failed["stepper"]]
    axes.scatter(failed["dt"], [0.98] * len(failed), c=colours, s=22.0, marker="x",
                 transform=axes.get_xaxis_transform())  # fmt: skip
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
        low, high = sorted(axis.get_view_interval())
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < SHORT * low else (1.0,)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter("{x:g}")


def svg_text(figure: Figure, name: str) -> str:
    """Return the text of an SVG file; the same figure gives the same bytes."""
    out = StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with style.context([STYLE, {"svg.hashsalt": name}]):
        figure.savefig(out, format="svg", metadata=nothing)
    return out.getvalue()
