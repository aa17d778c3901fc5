"""Maps on axes of cartopy, for its projections: no coasts, and fields evaluated, not resampled."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from swe_sphere.arrays import Array
from swe_sphere.pictures.projections import Map, Region


class GeoMap(Map):
    """The map of axes of cartopy: x, y in the units of their projection.

    Only what the axes show is evaluated, if they were told.  What lies outside the map has the
    values of the nearest point on it: the axes cut it off, so that the edge is smooth.
    """

    def __init__(self, axes: Any) -> None:
        self._axes, self._projection = axes, axes.projection
        self._angles = self._projection.as_geodetic()

    def grid(self, rows: int) -> tuple[Array, Array, Array, Array]:
        """As `Map.grid`."""
        from scipy.ndimage import distance_transform_edt
        from shapely import Polygon, contains_xy

        west, east, south, north = self._limits()
        columns = max(2, round(rows * (east - west) / (north - south)))
        x, y = np.meshgrid(np.linspace(west, east, columns), np.linspace(south, north, rows))
        lon, lat = np.radians(self._angles.transform_points(self._projection, x, y).T[:2])
        lon, lat = lon.T, lat.T
        inside = contains_xy(Polygon(self._projection.boundary), x, y) & np.isfinite(lon + lat)
        nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
        return lon[tuple(nearest)], lat[tuple(nearest)], x, y

    def place(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """As `Map.place`."""
        points = self._projection.transform_points(
            self._angles, (np.degrees(lon) + 180.0) % 360.0 - 180.0, np.degrees(lat)
        )
        x, y = points[..., 0], points[..., 1]
        west, east, south, north = self._limits()
        shown = (x >= west) & (x <= east) & (y >= south) & (y <= north)
        return np.where(shown, x, np.nan), np.where(shown, y, np.nan)

    def outline(self) -> tuple[Array, Array]:
        """As `Map.outline`."""
        from shapely import Polygon, box

        west, east, south, north = self._limits()
        shown = Polygon(self._projection.boundary) & box(west, south, east, north)
        x, y = np.array(shown.exterior.coords).T[:2]
        return x, y

    @property
    def radius(self) -> float:
        """As `Map.radius`, about."""
        west, east = self._projection.x_limits
        return 0.25 * float(east - west)

    def _limits(self) -> Region:
        """West, east, south, north of what the axes show."""
        axes, whole = self._axes, self._projection
        x = whole.x_limits if axes.get_autoscalex_on() else axes.get_xlim()
        y = whole.y_limits if axes.get_autoscaley_on() else axes.get_ylim()
        return (*x, *y)

    def draw_graticule(self) -> None:
        """Parallels and meridians with their labels, as cartopy draws them."""
        lines = self._axes.gridlines(
            draw_labels=True, x_inline=False, y_inline=False, color="0.4", linewidth=0.4, alpha=0.5
        )
        lines.top_labels = lines.right_labels = False
        lines.xlabel_style = lines.ylabel_style = {"size": 7.5, "color": "0.35"}


def map_of(axes: Axes | None) -> GeoMap | None:
    """The map of axes of cartopy, None for others."""
    return GeoMap(axes) if hasattr(axes, "projection") else None
