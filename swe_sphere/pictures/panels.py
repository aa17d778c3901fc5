"""The curves under a map: error norms over time, and the drift of conserved quantities."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from swe_sphere.arrays import Array
from swe_sphere.io.integrals import DRIFTS
from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import DAY

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Palette of Okabe and Ito, which colour-blind readers can distinguish, without black and yellow,
which vanish on dark and on light paper."""
ROUND = 2.0**-53
STYLES = ("-", "--", "-.", ":", "-", "--")
ERRORS = {
    "l2_h": "$l_2$ height", "linf_h": r"$l_\infty$ height", "l2_v": "$l_2$ wind",
    "linf_v": r"$l_\infty$ wind",
}  # fmt: skip


class Panel(NamedTuple):
    """Curves to draw on one pair of axes: times (D,) [s], and positive values (D,) by label."""

    title: str
    times: Array
    curves: dict[str, Array]


def panels(run: RunFile) -> list[Panel]:
    """Return the panels that the series in a file allow: two, one or none.

    Curves with fewer than two positive values are left out, because the axis is logarithmic.
    """
    times, series = run.series()
    later = np.where(times > 0.0, 1.0, np.nan)
    errors = {label: series[name] for name, label in ERRORS.items() if name in series}
    drifts = {  # drifts below round-off, including zero, are drawn at round-off
        of.removeprefix("axial_").replace("_", " "): later * np.maximum(np.abs(series[name]), ROUND)
        for name, of in DRIFTS.items()
        if name in series
    }
    found = []
    for title, curves in (("relative error", errors), ("relative drift since the start", drifts)):
        shown = {label: np.where(values > 0.0, values, np.nan) for label, values in curves.items()}
        several = {label: x for label, x in shown.items() if np.isfinite(x).sum() >= 2}
        found += [Panel(title, times, several)] if several else []
    return found


def draw_panel(axes: Axes, panel: Panel, time: float | None) -> None:
    """Draw a panel over time in days, its values on a log axis, with a mark at time [s]."""
    days = panel.times / DAY
    for (label, values), colour, style in zip(panel.curves.items(), COLOURS, STYLES, strict=False):
        axes.semilogy(days, values, color=colour, linestyle=style, linewidth=1.7, label=label)
    if time is not None and time < panel.times[-1]:
        axes.axvline(time / DAY, color="0.6", linewidth=0.8, zorder=0)
    axes.set_title(panel.title, fontsize=11, loc="left")
    axes.set_xlabel("time [days]", fontsize=10)
    axes.set_xlim(0.0, days[-1] or 1.0)
    axes.tick_params(labelsize=9)
    axes.grid(color="0.88", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    # at least two whole decades, and a margin so that lines at the edge are not cut
    decades = np.log10(np.concatenate([*panel.curves.values()]))
    low, high = np.floor(np.nanmin(decades)), np.ceil(np.nanmax(decades))
    high = max(high, low + 2)
    room = 0.03 * (high - low)
    axes.set_ylim(10.0 ** (low - room), 10.0 ** (high + room))
    columns = 2 if len(panel.curves) > 3 else 1
    axes.legend(fontsize=9, frameon=True, framealpha=0.85, edgecolor="none", ncols=columns)
