"""The graticule of a map: outline, parallels and meridians with their labels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from swe_sphere.pictures.projections import Disc, GeoMap, Map, Rounded

STEPS = (60, 30, 20, 10, 5, 2, 1)
"""Degrees between lines: the first that gives four of them."""
LABELS = 8.0
"""From the edge of a disc to its labels [points]."""


def draw_graticule(axes: Axes, on: Map) -> None:
    """Outline, thin parallels and meridians with their labels; no frame and no ticks."""
    if isinstance(on, GeoMap):
        on.draw_graticule()
        return
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.plot(*on.outline(), color="0.25", linewidth=0.9, clip_on=False, zorder=5)
    line: dict[str, Any] = {"color": "0.4", "linewidth": 0.4, "alpha": 0.5, "zorder": 4}
    across, up = _steps(on)
    along = np.radians(np.linspace(-90.0, 90.0, 361))
    for degrees in range(-180, 180, across):
        axes.plot(*on.place(np.full_like(along, np.radians(degrees)), along), **line)
    around = np.linspace(-np.pi, np.pi, 721)
    if isinstance(on, Rounded):
        around = around + on.centre
        around[[0, -1]] += [1e-9, -1e-9]
    for degrees in range(-90 + up, 90, up):
        axes.plot(*on.place(around, np.full_like(around, np.radians(degrees))), **line)
    if isinstance(on, Rounded):
        _label_edges(axes, on, across, up)
    elif isinstance(on, Disc):
        _label_disc(axes, on, across)
    axes.margins(0.004)


def _steps(on: Map) -> tuple[int, int]:
    """Degrees between meridians and between parallels."""
    if isinstance(on, Disc):
        return 30, 30
    assert isinstance(on, Rounded)
    west, east, south, north = np.degrees(on.edges)
    return _step(east - west), _step(north - south)


def _step(width: float) -> int:
    return next((step for step in STEPS if width / step >= 4.0), STEPS[-1])


def _label_edges(axes: Axes, on: Rounded, across: int, up: int) -> None:
    west, east, south, north = np.degrees(on.edges)
    centre = round(float(np.degrees(on.centre)), 9)
    for degrees in range(across * math.ceil((centre + west) / across), 720, across):
        if west < degrees - centre < east:
            point = on.formula(np.radians(degrees - centre), np.radians(south))
            text = _text((degrees + 180) % 360 - 180, "EW")
            _label(axes, point, text, (0, -5), "center", "top")
    for degrees in range(-90 + up, 90, up):
        if south < degrees < north:
            point = on.formula(np.radians(west), np.radians(degrees))
            _label(axes, point, _text(degrees, "NS"), (-7, 0), "right", "center")


def _label_disc(axes: Axes, on: Disc, across: int) -> None:
    """Longitudes around a polar map; a globe seen from outside has none."""
    if abs(on.lat) < 1.57:
        return
    edge = np.sign(on.lat) * (0.5 * np.pi - on.reach)
    for degrees in range(-180, 180, across):
        x, y = (float(v) for v in on.place(np.radians(degrees), edge))
        away = np.array([x, y]) / np.hypot(x, y)
        side = "center" if abs(away[0]) < 0.3 else "left" if away[0] > 0.0 else "right"
        _label(axes, (x, y), _text(degrees, "EW"), tuple(LABELS * away), side, "center")


def _text(degrees: int, letters: str) -> str:
    letter = letters[degrees < 0] if degrees % 180 else ""
    return f"{abs(degrees)}°{letter}"


def _label(axes: Axes, point: Any, text: str, offset: Any, ha: str, va: str) -> None:
    axes.annotate(
        text, point, xytext=offset, textcoords="offset points", ha=ha, va=va, fontsize=7.5,
        color="0.35", annotation_clip=False,
    )  # fmt: skip
