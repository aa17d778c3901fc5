"""The figures of a sweep, one panel each, so that a page can set them side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.report.axes import (
    FAINT,
    INK,
    PAPER,
    SMALLEST,
    STYLE,
    finish,
    mark_limits,
    name_curves,
    points,
)
from swe_sphere.studies.report.palette import STATUS, Curve, curves, look
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row
from swe_sphere.studies.report.statistics import Cost, cost, pareto, with_cost

WIDTH, HEIGHT = 5.4, 3.7
"""Inches: on a telephone a point of text is about a pixel."""
DRIFTS = {"mass_drift": "mass", "energy_drift": "energy", "enstrophy_drift": "potential enstrophy"}
COUNTS = {"krylov_iterations": "Krylov", "newton_iterations": "Newton"}
FRONT = "The ringed points are the Pareto front: nothing measured is both cheaper and better."
LIMITS = "Gravity limit: of leapfrog without filter; advective limit: the same for the wind alone."

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
        rows, f"{metric.name}_step", "Error against Δt", f"{metric.label}. {LIMITS}",
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
