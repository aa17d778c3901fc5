"""A map of the whole globe on plain axes: the Equal Earth projection and its graticule.

Savric, Patterson and Jenny (2018), The Equal Earth map projection, Int. J. Geogr. Inf. Sci. 33,
454-465, eqs. 1-2, doi:10.1080/13658816.2018.1504949.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_graticule", "equal_earth", "globe_grid"]

Array = NDArray[np.float64]

COEFFICIENTS = (1.340264, -0.081106, 0.000893, 0.003796)
POWERS = np.array([0, 2, 6, 8])


def equal_earth(lon: ArrayLike, lat: ArrayLike) -> tuple[Array, Array]:
    """Coordinates x, y on the unit sphere's map of lon in [-pi, pi], lat [rad]."""
    lon, lat = np.asarray(lon, dtype=float), np.asarray(lat, dtype=float)
    angle = np.arcsin(0.5 * np.sqrt(3.0) * np.sin(lat))
    powers = angle[..., None] ** POWERS
    slope = powers @ (COEFFICIENTS * (POWERS + 1))
    x = 2.0 * np.sqrt(3.0) * lon * np.cos(angle) / (3.0 * slope)
    return x, angle * (powers @ np.array(COEFFICIENTS))


def globe_grid(rows: int) -> tuple[Array, Array]:
    """Longitudes and latitudes [rad] of a grid (rows, 2 rows - 1) from edge to edge of the map."""
    lat = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
    lon = np.linspace(-np.pi, np.pi, 2 * rows - 1)
    lon, lat = np.meshgrid(lon, lat)
    return lon, lat


def draw_graticule(axes: Axes) -> None:
    """Outline, thin parallels and meridians with their labels; no frame and no ticks."""
    axes.set_axis_off()
    axes.set_aspect("equal")
    lat = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 181)
    side = [equal_earth(np.full_like(lat, edge), lat) for edge in (-np.pi, np.pi)]
    outline = [
        np.concatenate([left, right[::-1], left[:1]]) for left, right in zip(*side, strict=True)
    ]
    axes.plot(*outline, color="0.25", linewidth=0.9, clip_on=False, zorder=5)
    line: dict[str, Any] = {"color": "0.4", "linewidth": 0.4, "alpha": 0.5, "zorder": 4}
    for degrees in range(-120, 121, 60):
        axes.plot(*equal_earth(np.full_like(lat, np.radians(degrees)), lat), **line)
        _label(axes, degrees, -90, "EW", (0, -5), "center", "top")
    for degrees in range(-60, 61, 30):
        ends = np.array([-np.pi, np.pi])
        axes.plot(*equal_earth(ends, np.full(2, np.radians(degrees))), **line)
        _label(axes, -180, degrees, "NS", (-7, 0), "right", "center")
    axes.margins(0.004)


def _label(
    axes: Axes, lon: int, lat: int, letters: str, offset: tuple[int, int], ha: str, va: str
) -> None:
    """Degrees of the meridian (letters "EW") or parallel ("NS") at a point on the outline."""
    degrees = lon if letters == "EW" else lat
    letter = letters[degrees < 0] if degrees else ""
    axes.annotate(
        f"{abs(degrees)}°{letter}", equal_earth(np.radians(lon), np.radians(lat)), xytext=offset,
        textcoords="offset points", ha=ha, va=va, fontsize=7.5, color="0.35", annotation_clip=False,
    )  # fmt: skip
