"""The diagrams of a sweep, one panel each, so that a page can set them side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from swe_sphere.studies.report.drawing import draw_by_step, draw_map, draw_work
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import MADE_FOR_OTHERS, Metric, Row
from swe_sphere.studies.report.statistics import Cost, candidates
from swe_sphere.studies.report.svg import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Diagram", "diagrams", "error_diagrams", "render"]

WIDTH, HEIGHT = 5.4, 3.7
"""Inches: on a telephone a point of text is about a pixel."""
DRIFTS = {"mass_drift": "mass", "energy_drift": "energy", "enstrophy_drift": "potential enstrophy"}
COUNTS = {"krylov_iterations": "Krylov", "newton_iterations": "Newton"}


@dataclass(frozen=True)
class Diagram:
    """A diagram that can be drawn."""

    name: str
    """Of its files, without ending."""
    title: str
    caption: str
    draw: Callable[[Axes, str], None]
    """Draws it into axes; the second argument goes before row numbers in links."""
    height: float = HEIGHT


def render(diagram: Diagram, anchor: str = "row") -> Figure:
    """Draw a diagram as a figure of its own."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, diagram.height), layout="constrained")
        diagram.draw(figure.subplots(), anchor)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # laid out once for all formats
    return figure


def error_diagrams(rows: Sequence[Row], metric: Metric, noise: float) -> list[Diagram]:
    """What an error costs on one mesh, and how it depends on the step."""
    time = _costs(rows, metric, noise, "wall time", _wall, "wall time of the steps [s]")
    work = _costs(rows, metric, noise, "work", _work, "CPU time [right-hand sides]")
    limits = (
        "Gravity limit: of leapfrog without filter; advective limit: the same for the wind alone."
    )
    step = _by_step(
        rows, f"{metric.name}_step", "Error against Δt", f"{metric.label}. {limits}",
        _axis(metric), lambda row: row.error(metric),
    )  # fmt: skip
    return [*time, *work, *step]


def _costs(
    rows: Sequence[Row], metric: Metric, noise: float, title: str, cost: Cost, label: str
) -> list[Diagram]:
    if not candidates(rows, metric, cost):
        return []
    caption = "The ringed points are the Pareto front: nothing measured is both cheaper and better."
    draw = partial(draw_work, rows, metric, cost, (label, _axis(metric)), noise)
    if cost is _work:
        draw = partial(draw_work, rows, metric, cost, (label, _axis(metric)), None)
    name = f"{metric.name}_{title.split()[0]}"
    return [Diagram(name, f"Error against {title}", f"{metric.label}. {caption}", draw)]


def _axis(metric: Metric) -> str:
    return metric.label.split(" at day")[0]


def _wall(row: Row) -> float:
    return row.wall_seconds


def _work(row: Row) -> float:
    return row.equivalents


def diagrams(rows: Sequence[Row]) -> list[Diagram]:
    """What does not depend on the choice of an error: counts, drifts, how runs ended."""
    counts = [
        _by_step(
            rows, name, f"{title} iterations a step", "By Δt; explicit steppers have none.",
            f"{title} iterations a step", partial(_per_step, name),
        )
        for name, title in COUNTS.items()
    ]  # fmt: skip
    drifts = [
        _by_step(
            rows, name, f"Drift of {title}", "Size of the relative change over the run, by Δt.",
            f"|relative change of {title}|", partial(_size, name),
        )
        for name, title in DRIFTS.items()
    ]  # fmt: skip
    return [diagram for found in (*counts, *drifts, _maps(rows)) for diagram in found]


def _per_step(name: str, row: Row) -> float:
    return row.per_step(name) or math.nan


def _size(name: str, row: Row) -> float:
    return abs(float(getattr(row, name)))


def _by_step(
    rows: Sequence[Row], name: str, title: str, caption: str, label: str,
    value: Callable[[Row], float],
) -> list[Diagram]:  # fmt: skip
    shown = [row for row in rows if row.compared and row.dt > 0.0 and math.isfinite(value(row))]
    draw = partial(draw_by_step, shown, value, label)
    return [Diagram(name, title, caption, draw)] if shown else []


def _maps(rows: Sequence[Row]) -> list[Diagram]:
    rows = [row for row in rows if row.role not in MADE_FOR_OTHERS and row.dt > 0.0]
    caption = "Every run by stepper and Δt; failures are told below."
    height = 1.4 + 0.25 * len(curves(rows))
    chart = Diagram("stability", "How runs ended", caption, partial(draw_map, rows), height)
    return [chart] if rows else []
