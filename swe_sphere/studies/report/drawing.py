"""What goes into the axes of the diagrams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from swe_sphere.studies.report.axes import SMALLEST, finish, mark_limits, name_curves, points
from swe_sphere.studies.report.palette import STATUS, Curve, curves
from swe_sphere.studies.report.rows import Metric, Row
from swe_sphere.studies.report.statistics import Cost, candidates, pareto, time_interval
from swe_sphere.studies.report.svg import FAINT, INK, PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_by_step", "draw_map", "draw_work"]

Position = Callable[[Row], tuple[float, float]]


def draw_work(
    rows: Sequence[Row], metric: Metric, cost: Cost, labels: tuple[str, str],
    noise: float | None, axes: Axes, anchor: str,
) -> None:  # fmt: skip
    """Error against a cost, with the Pareto front.

    noise: of wall times, drawn as bars behind the points; None where the cost is another.
    """
    front = pareto(rows, metric, cost)
    _draw_front(axes, [(cost(row), max(row.error(metric), SMALLEST)) for row in front])
    drawn = curves(candidates(rows, metric, cost))
    _draw_curves(axes, drawn, lambda row: (cost(row), row.error(metric)), anchor)
    if noise is not None:
        _draw_uncertainty(axes, drawn, metric, noise)
    finish(axes, *labels)
    _name(axes, drawn, lambda row: (cost(row), row.error(metric)))


def draw_by_step(
    rows: Sequence[Row], value: Callable[[Row], float], label: str, axes: Axes, anchor: str
) -> None:
    """A value against the step, with the limits of the step."""
    drawn = curves(rows)
    _draw_curves(axes, drawn, lambda row: (row.dt, value(row)), anchor)
    mark_limits(axes, rows)
    finish(axes, "Δt [s]", label)
    _name(axes, drawn, lambda row: (row.dt, value(row)))


def _draw_curves(axes: Axes, drawn: Sequence[Curve], position: Position, anchor: str) -> None:
    for curve in drawn:
        points(axes, curve, [position(row) for row in curve.rows], anchor)


def _name(axes: Axes, drawn: Sequence[Curve], position: Position) -> None:
    """Name curves by their rightmost points."""
    name_curves(axes, [(curve, max(position(row) for row in curve.rows)) for curve in drawn])


def _draw_front(axes: Axes, front: Sequence[tuple[float, float]]) -> None:
    x, y = zip(*front, strict=True)
    axes.plot(x, y, color=INK, linewidth=3.5, alpha=0.12, drawstyle="steps-post", zorder=1)
    axes.scatter(x, y, s=95, facecolors="none", edgecolors=INK, linewidths=0.9, zorder=4)


def _draw_uncertainty(axes: Axes, drawn: Sequence[Curve], metric: Metric, noise: float) -> None:
    for curve in drawn:
        for row in curve.rows:
            low, high = time_interval(row, noise)
            axes.plot(
                [max(low, 0.1 * row.wall_seconds), high],  # zero is not on the axis
                [max(row.error(metric), SMALLEST)] * 2,
                color=curve.look.colour, linewidth=2.6, alpha=0.4, zorder=2,
            )  # fmt: skip


def draw_map(rows: Sequence[Row], axes: Axes, anchor: str) -> None:
    """How every run ended, by stepper and step."""
    from swe_sphere.steppers import STEPPERS

    order = {name: i for i, name in enumerate(STEPPERS)}
    drawn = sorted(curves(rows), key=lambda c: order.get(c.rows[0].stepper, len(order)))[::-1]
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
    for status, look in STATUS.items():
        if rows := [row for row in curve.rows if row.status == status]:
            line = look.marker == "_"
            dots = axes.scatter(
                [row.dt for row in rows], [height] * len(rows), s=46, marker=look.marker,
                c=look.colour, linewidths=2.0 if line else 0.8, zorder=3,
                edgecolors=None if line else PAPER,
            )  # fmt: skip
            dots.set_urls([f"#{anchor}-{row.number}" for row in rows])


def _explain_marks(axes: Axes, found: set[str]) -> None:
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], marker=look.marker, color=look.colour, linestyle="", label=status)
        for status, look in STATUS.items()
        if status in found
    ]
    axes.figure.legend(
        handles=marks, loc="outside lower center", ncols=3, frameon=False, fontsize=8.5,
        labelcolor=INK, handletextpad=0.2,
    )  # fmt: skip
    axes.tick_params(colors=FAINT, labelcolor=INK)
