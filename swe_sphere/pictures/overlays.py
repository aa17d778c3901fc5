"""What is drawn over a field: the graticule, the elements of the mesh, and the wind."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon

from swe_sphere.arrays import Array
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import frame, longitude_latitude, position
from swe_sphere.pictures.projections import Disc, GeoMap, Map, Rounded

APART = (60, 30, 20, 10, 5, 2, 1)
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
    return next((step for step in APART if width / step >= 4.0), APART[-1])


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


ARROWS, LINES = 900, 500
"""On a map."""
LONGEST = 1.2
"""Arrow, in mean distances from one to the next."""
DENSEST = 50_000
"""On the globe, of which a map may show a small part."""
STEPS, LENGTH = 24, 0.16
"""Of a streamline: points, and its length [rad]."""

Wind = Callable[[Array], tuple[Array, Array]]
"""Unit vectors (..., 3) to those of the wind's direction, and its speed (...)."""


def draw_mesh(axes: Axes, on: Map, mesh: Mesh) -> None:
    """The edges of the elements."""
    last = mesh.np - 1
    n = mesh.nodes
    edges = np.concatenate([n[:, 0, :], n[:, last, :], n[:, :, 0], n[:, :, last]])
    x, y = on.place(mesh.lon[edges], mesh.lat[edges])
    lines = np.stack([x, y], axis=-1)
    steps = np.nan_to_num(np.abs(np.diff(lines, axis=1)))  # what is not on the map has none
    whole = steps.max(axis=(1, 2)) < on.radius  # not across the map's seam
    axes.add_collection(
        LineCollection(list(lines[whole]), colors="0.15", linewidths=0.35, alpha=0.6, zorder=3)
    )


def draw_winds(axes: Axes, on: Map, mesh: Mesh, fields: dict[str, Array], how: str) -> float:
    """Arrows or streamlines of the wind u, v among the fields; the largest speed [m s-1]."""

    def wind(xyz: Array) -> tuple[Array, Array]:
        lon, lat = longitude_latitude(xyz)
        u, v = evaluate(Interpolator(mesh, lon, lat), fields, "wind")
        east, north = frame(lon, lat)
        speed = np.hypot(u, v)
        vector = u[..., None] * east + v[..., None] * north
        return vector / np.where(speed > 0.0, speed, 1.0)[..., None], speed

    points = _points_on(on, ARROWS if how == "arrows" else LINES)
    _, speed = wind(points)
    strongest = float(speed.max())
    points, speed = points[speed > 0.02 * strongest], speed[speed > 0.02 * strongest]
    if points.size:
        (_draw_arrows if how == "arrows" else _draw_streamlines)(axes, on, points, speed, wind)
    return strongest


def _draw_arrows(axes: Axes, on: Map, points: Array, speed: Array, wind: Wind) -> None:
    x, y = _placed(on, points)
    ahead = _placed(on, _moved(points, wind(points)[0], 1e-4))
    dx, dy = ahead[0] - x, ahead[1] - y
    length = np.hypot(dx, dy)
    good = np.isfinite(length) & (length < 1e-2 * on.radius) & (length > 0.0)
    size = (speed / speed.max() / np.where(length > 0.0, length, 1.0))[good]
    outline = np.transpose(on.outline())
    apart = math.sqrt(abs(_area(*outline.T)) / ARROWS)
    edge = Polygon(outline, transform=axes.transData)
    axes.quiver(
        x[good], y[good], dx[good] * size, dy[good] * size, units="width", width=0.0011,
        headwidth=4.0, color="0.1", zorder=4, scale_units="xy", scale=1.0 / (LONGEST * apart),
        pivot="mid",
    ).set_clip_path(edge)  # fmt: skip


def _area(x: Array, y: Array) -> float:
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _draw_streamlines(axes: Axes, on: Map, points: Array, speed: Array, wind: Wind) -> None:
    path = [points]
    for _ in range(STEPS):  # the midpoint rule, by arc length
        half = _moved(path[-1], wind(path[-1])[0], 0.5 * LENGTH / STEPS)
        path.append(_moved(path[-1], wind(half)[0], LENGTH / STEPS))
    x, y = _placed(on, np.stack(path, axis=1))
    for k, strength in enumerate(speed / speed.max()):
        if not np.hypot(np.diff(x[k]), np.diff(y[k])).max() <= 0.2 * on.radius:
            continue
        width = 0.35 + 0.75 * float(strength)
        axes.plot(x[k], y[k], color="0.1", linewidth=width, alpha=0.8, zorder=4)
        axes.annotate(
            "", (x[k, -1], y[k, -1]), (x[k, -3], y[k, -3]),
            arrowprops={"arrowstyle": "->", "lw": width, "color": "0.1", "mutation_scale": 4.0,
                        "shrinkA": 0.0, "shrinkB": 0.0}, zorder=4,
        )  # fmt: skip


def _moved(xyz: Array, direction: Array, distance: float) -> Array:
    moved = xyz + distance * direction
    result: Array = moved / np.linalg.norm(moved, axis=-1, keepdims=True)
    return result


def _placed(on: Map, xyz: Array) -> tuple[Array, Array]:
    return on.place(*longitude_latitude(xyz))


def _points_on(on: Map, count: int) -> Array:
    """About so many evenly spread points that the map shows."""
    shown = np.isfinite(_placed(on, _even_points(4 * count))[0]).mean()
    points = _even_points(min(int(count / max(float(shown), 1e-3)), DENSEST))
    return points[np.isfinite(_placed(on, points)[0])]


def _even_points(count: int) -> Array:
    """Unit vectors (count, 3) that are evenly spread, on a spiral of the golden angle."""
    k = np.arange(count)
    lat = np.arcsin((2.0 * k + 1.0) / count - 1.0)
    return position(np.pi * (3.0 - np.sqrt(5.0)) * k, lat)
