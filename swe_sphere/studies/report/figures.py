"""The figures of a sweep: colours and markers of steppers, and curves on logarithmic axes.

The page of a sweep and `ds.sweep` draw figures of errors with the same functions.
"""

import math
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from swe_sphere.settings.values import read_toml
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies import words
from swe_sphere.studies.report.ranking import BROKE_DOWN, Metric, with_cost

FAINT, PALE = "#6e7781", "#d0d7de"
STYLE = Path(__file__).with_name("templates") / "figures.mplstyle"
LOOKS = read_toml(STYLE.with_name("looks.toml"))
"""Colour, marker and fill of the steppers of the package, by family."""
CUSTOM = LOOKS.pop("custom")
"""Markers of custom steppers; no stepper of the package uses them."""
SCREEN = 122.0
"""Width of a figure of a page [mm]: on a telephone a point of text is about a pixel."""
WIDE = 110.0
"""Figures of at least this width [mm] have panels in two columns."""
MOST_CURVES = 8
"""A figure of more curves has a panel for each family, with the others in grey."""
SMALLEST = 1e-17
"""Value at which zero is drawn."""
LEAST, SHORT, LONG = 3.0, 10.0, 300.0
"""Ratios of the highest to the lowest value: least of the y axis; others add ticks below them."""

LIMITS = (
    "Limits are those of leapfrog without filter, the advective one for the wind alone."
    " Crosses at the top: runs that became unstable or whose solver failed."
)


def looks(steppers: Iterable[str]) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return family and matplotlib line properties of steppers by name, in the order of legends.

    The hue stands for the family and the shade for the stepper; custom steppers share a shade of
    their family, or of "other" where their class is not known, and differ by the marker.
    """
    names, known = {*steppers}, {name for family in LOOKS.values() for name in family}
    customs = {
        name: ("other" if name not in STEPPERS else STEPPERS[name].family, CUSTOM[n % len(CUSTOM)])
        for n, name in enumerate(sorted(names - known))
    }
    found: dict[str, tuple[str, dict[str, Any]]] = {}
    for family, looks in LOOKS.items():
        found |= {name: (family, look) for name, look in looks.items() if name in names}
        found |= {name: (family, looks[""] | look)
                  for name, (of, look) in customs.items() if of == family}  # fmt: skip
    return found


class Picture(NamedTuple):
    """A figure of a sweep."""

    name: str
    """Name of its file."""
    title: str
    caption: str
    svg: str

    @property
    def inline(self) -> str:
        """Data address that contains the whole figure."""
        return f"data:image/svg+xml;base64,{b64encode(self.svg.encode()).decode()}"


def error_pictures(
    runs: pd.DataFrame, metric: Metric, where: str, floor: float = 0.0
) -> Iterator[Picture]:
    """Yield pictures of an error on one mesh: against the cost, if runs were timed, and the step.

    where: first part of the names of files.  floor: error of the reference.
    """
    name = f"{where}-{metric.name}"
    for clock in with_cost(runs, metric)["clock"].head(1):
        caption = f"{metric.label}. Bars: how well the times are known."
        yield from Curves("cost", metric, floor).pictures(
            runs, f"{name}_time.svg", f"Error against {clock}", caption
        )
    yield from Curves("dt", metric, floor).pictures(
        runs, f"{name}_step.svg", "Error against Δt", f"{metric.label}. {LIMITS}"
    )


def other_pictures(runs: pd.DataFrame, where: str) -> Iterator[Picture]:
    """Yield pictures of iterations and energy, which do not depend on the choice of error."""
    krylov, drift = runs["krylov_a_step"], runs["energy_drift"].abs()
    title, label = "Krylov iterations a step", "|relative change of energy|"
    runs = runs.assign(**{title: krylov.where(krylov > 0.0), label: drift})
    name, what = f"{where}-krylov_iterations.svg", f"Explicit steppers have none. {LIMITS}"
    yield from Curves("dt", title).pictures(runs, name, title, what)
    name, what = f"{where}-energy_drift.svg", f"Size of the relative change over the run. {LIMITS}"
    yield from Curves("dt", label).pictures(runs, name, "Drift of energy", what)


def figure_of(
    draw: Callable[..., None], runs: pd.DataFrame, width: float = SCREEN,
    make: Callable[..., Figure] = Figure,
) -> Figure:  # fmt: skip
    """Return a figure of the runs on one mesh: one panel, or one for each family.

    draw: called with axes, runs and a family, which is empty for all families.  width: in mm.
    """
    with style.context(STYLE):
        families = [*dict.fromkeys(family for family, _ in looks(runs["stepper"]).values())]
        families = families if runs["curve"].nunique() > MOST_CURVES else [""]
        columns = 2 if len(families) > 1 and width >= WIDE else 1
        rows, inch = -(-len(families) // columns), width / 25.4
        figure = make(figsize=(inch, 0.68 * rows * inch / columns), layout="constrained")
        for n, family in enumerate(families):
            draw(figure.add_subplot(rows, columns, n + 1), runs, family)
    return figure


class Curves(NamedTuple):
    """Curves of an error or another column against the time step or the cost."""

    x: str
    """Column "dt" or "cost"."""
    y: str | Metric
    floor: float = 0.0
    """Error of the reference; the area below it is grey."""

    def shown(self, runs: pd.DataFrame) -> pd.DataFrame:
        """Return the comparable runs that have both values."""
        known = runs[runs["compared"] & np.isfinite(runs[self.y])]
        return known[known[self.x].between(0.0, math.inf, inclusive="neither")]

    def pictures(
        self, runs: pd.DataFrame, name: str, title: str, caption: str
    ) -> Iterator[Picture]:
        """Yield a picture of the curves if there are any."""
        if len(self.shown(runs)):
            yield Picture(name, title, caption, svg_text(figure_of(self.draw, runs), name))

    def draw(self, axes: Axes, runs: pd.DataFrame, family: str = "") -> None:
        """Draw the curves of a family, and other curves in grey; the legend is on the right."""
        shown, known, (x, y, floor) = self.shown(runs), looks(runs["stepper"]), self
        if x == "dt":
            _mark_limits(axes, shown)
            for name, steps in runs[runs["status"].isin(BROKE_DOWN)].groupby("stepper")["dt"]:
                if family in ("", known[name][0]):
                    colour, heights = known[name][1]["color"], [0.98] * len(steps)
                    place = axes.get_xaxis_transform()
                    axes.plot(steps, heights, "x", color=colour, markersize=4.0, transform=place)
        places = shown["stepper"].map([*known].index)
        for (_, label), curve in shown.sort_values("dt").groupby([places, "curve"]):
            (of, look), heights = known[curve["stepper"].iloc[0]], curve[y].clip(lower=SMALLEST)
            if family not in ("", of):
                axes.plot(curve[x], heights, color=PALE, linewidth=0.8, zorder=1)
                continue
            if x == "cost":  # zero is not on the axis
                least = np.maximum(curve["least"], 0.1 * curve["cost"])
                axes.hlines(heights, least, curve["most"], look["color"], linewidth=0.7)
            axes.plot(curve[x], heights, curve["line"].iloc[0], label=label, markersize=4.5,
                      linewidth=1.0, markeredgewidth=0.8, **look)  # fmt: skip
        curves = axes.get_legend_handles_labels()
        axes.legend(*curves, title=family, loc="upper left", bbox_to_anchor=(1.0, 1.02),
                    fontsize="small", handlelength=2.2, alignment="left")  # fmt: skip
        clock = f"{next(iter(shown['clock']), 'time')} of the steps [s]"
        label = y if isinstance(y, str) else f"relative {y.kind_title}\n{y.symbol}"
        finish(axes, clock if x == "cost" else "Δt [s]", label)
        if isinstance(y, Metric):
            _mark_slopes(axes, shown, x, y)
        if (low := axes.get_ylim()[0]) < floor < axes.get_ylim()[1]:
            axes.axhspan(low, floor, color=FAINT, alpha=0.15, linewidth=0.0)
            axes.annotate(
                "error of the reference", (0.99 if x == "cost" else 0.01, 0.01), color=FAINT,
                ha="right" if x == "cost" else "left", xycoords="axes fraction", fontsize="small",
            )  # fmt: skip


def draw_limits(axes: Axes, runs: pd.DataFrame, family: str = "") -> None:
    """Draw a row for each stepper: completed runs, crosses for breakdowns, its estimated limit."""
    known = [(name, *of) for name, of in looks(runs["stepper"]).items() if family in ("", of[0])]
    for row, (name, _, look) in enumerate(known):
        own = runs[(runs["stepper"] == name) & (runs["dt"] > 0.0)]
        good, bad = own["dt"][own["completed"]], own["dt"][own["status"].isin(BROKE_DOWN)]
        axes.plot(good, [row] * len(good), markersize=4.0, linewidth=0.8, **look)
        axes.plot(bad, [row] * len(bad), "x", markersize=4.0, color=look["color"])
        if math.isfinite(limit := own["stable_dt"].astype(float).max()):
            axes.plot(limit, row, "|", markersize=12.0, color=look["color"])
    _mark_limits(axes, runs)
    axes.set_ylim(len(known) - 0.5, -0.5)
    axes.set_yticks(range(len(known)), [name for name, *_ in known])
    axes.set(xscale="log", xlabel="Δt [s]; bar: estimated stability limit; crosses: breakdowns")
    axes.xaxis.set_major_formatter("{x:g}")


def _mark_slopes(axes: Axes, runs: pd.DataFrame, x: str, y: Metric) -> None:
    """Draw triangles in a free corner with the two slopes that most curves have."""
    orders: list[int] = []
    for _, curve in runs.sort_values("dt").groupby("curve"):
        steps, heights = np.diff(np.log(curve[[x, y]].clip(lower=SMALLEST).to_numpy(float)).T)
        if steps.all() and steps.size and 0.7 < (slope := abs(np.median(heights / steps))) < 6.3:
            orders += [round(slope)] if abs(slope - round(slope)) < 0.3 else []
    powers = sorted(sorted({*orders}, key=orders.count)[-2:])
    ends, (low, high) = np.log(axes.get_xlim()), np.log(axes.get_ylim())
    wide, tall, falls = np.ptp(ends), high - low, x == "cost"
    side = min(0.16 * wide, 0.35 * tall / max(powers, default=1))
    base, up = (high - 0.05 * tall, -side) if falls else (low + 0.05 * tall, side)
    corner = ends[1] - 0.05 * wide  # costly and inaccurate, or long and accurate
    for power in powers:
        top = base + power * up
        corners = np.exp([[corner - side, corner, corner, corner - side], [base, top, base, base]])
        axes.plot(*corners, color=FAINT, linewidth=0.7)
        axes.text(corners[0, 1], corners[1, 1], f"{power}", color=FAINT, va="center", size="small")


def _mark_limits(axes: Axes, runs: pd.DataFrame) -> None:
    """Draw lines at the gravity-wave and the advective limit."""
    for title, side in (("gravity limit", "right"), ("advective limit", "left")):
        limits = runs[title.replace(" ", "_")]
        known = limits[limits.between(0.0, math.inf, inclusive="neither")]
        if known.empty:
            continue
        where = float(known.median())
        axes.axvline(where, color=FAINT, linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
        axes.text(
            where, 1.01, f" {title} \n {words.step(where)} ", va="bottom", ha=side, color=FAINT,
            fontsize="small", transform=axes.get_xaxis_transform(),
        )  # fmt: skip


def finish(axes: Axes, x: str, y: str) -> None:
    """Make axes logarithmic, label them, and set ticks with readable numbers."""
    axes.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
    low, high = axes.get_ylim()  # widened, so that noise does not fill the axes
    factor = math.sqrt(max(1.0, LEAST * low / high))
    axes.set_ylim(low / factor, high * factor)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        many = (1.0, 2.0, 5.0) if high < SHORT * low else (1.0, 3.0)
        axis.set_major_locator(LogLocator(subs=many if high < LONG * low else (1.0,)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(lambda value, _: words.number(value, 1))


def svg_text(figure: Figure, name: str) -> str:
    """Return the text of an SVG file; the same figure gives the same bytes."""
    out = StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with style.context([STYLE, {"svg.hashsalt": name}]):
        figure.savefig(out, format="svg", metadata=nothing)
    return out.getvalue()
