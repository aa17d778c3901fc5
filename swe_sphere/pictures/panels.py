"""The curves under a map: error norms over time, and the drift of conserved quantities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import DAY

Array = NDArray[np.float64]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's palette, told apart by colour-blind readers too, without black and yellow, which
vanish on dark or on light paper."""
STYLES = ("-", "--", "-.", ":", "-", "--")
ERRORS = {
    "l2_h": "$l_2$ height",
    "linf_h": r"$l_\infty$ height",
    "l2_v": "$l_2$ wind",
    "linf_v": r"$l_\infty$ wind",
}
CONSERVED = {
    "mass_drift": "mass",
    "energy_drift": "energy",
    "enstrophy_drift": "potential enstrophy",
}
ROUND_OFF = 2.0**-53
"""Relative drifts below this, zero among them, are drawn here."""


@dataclass(frozen=True)
class Panel:
    """Curves to draw on one pair of axes: their times (D,) [s], and label -> values (D,) > 0."""

    title: str
    times: Array
    curves: dict[str, Array]


def panels(run: RunFile) -> list[Panel]:
    """The panels that the series in a file allow, of two samples at least: two, one or none."""
    times, series = run.series()
    found = (
        Panel("relative error", times, _errors(series)),
        Panel("relative drift since the start", times, _drifts(times, series)),
    )
    return [panel for panel in found if panel.curves]


def _errors(series: dict[str, Array]) -> dict[str, Array]:
    return _several({label: series[name] for name, label in ERRORS.items() if name in series})


def _drifts(times: Array, series: dict[str, Array]) -> dict[str, Array]:
    curves = {
        label: np.where(times > 0.0, np.maximum(np.abs(series[name]), ROUND_OFF), np.nan)
        for name, label in CONSERVED.items()
        if name in series
    }
    return _several(curves)


def _several(curves: dict[str, Array]) -> dict[str, Array]:
    """The curves with two or more points that a log axis can show; the others left out."""
    shown = {label: np.where(values > 0.0, values, np.nan) for label, values in curves.items()}
    return {k: values for k, values in shown.items() if np.isfinite(values).sum() >= 2}


def draw_panel(axes: Axes, panel: Panel, time: float | None) -> None:
    """Draw a panel over time in days, its values on a log axis, with a mark at time [s]."""
    days = panel.times / DAY
    for (label, values), colour, style in zip(panel.curves.items(), COLOURS, STYLES, strict=False):
        axes.semilogy(days, values, color=colour, linestyle=style, linewidth=1.7, label=label)
    if time is not None and time < panel.times[-1]:
        axes.axvline(time / DAY, color="0.6", linewidth=0.8, zorder=0)
    axes.set_title(panel.title, fontsize=11, loc="left")
    axes.set_xlabel("time [days]", fontsize=10)
    axes.set_xlim(0.0, days[-1])
    axes.tick_params(labelsize=9)
    axes.grid(color="0.88", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    _fit(axes, np.concatenate([*panel.curves.values()]))
    columns = 2 if len(panel.curves) > 3 else 1
    axes.legend(fontsize=9, frameon=True, framealpha=0.85, edgecolor="none", ncols=columns)


def _fit(axes: Axes, values: Array) -> None:
    """Whole decades and a little room, and at least two of them."""
    decades = np.log10(values[np.isfinite(values)])
    low, high = np.floor(decades.min()), np.ceil(decades.max())
    high = max(high, low + 2)
    room = 0.03 * (high - low)  # a line along the edge is drawn in its whole width
    axes.set_ylim(10.0 ** (low - room), 10.0 ** (high + room))
