"""Maps on axes of cartopy, for its projections: no coasts, and fields evaluated, not resampled."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from swe_sphere.arrays import Array
from swe_sphere.pictures.projections import Map


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

        axes, limits = self._axes, self._projection
        west, east = limits.x_limits if axes.get_autoscalex_on() else axes.get_xlim()
        south, north = limits.y_limits if axes.get_autoscaley_on() else axes.get_ylim()
        columns = max(2, round(rows * (east - west) / (north - south)))
        x, y = np.meshgrid(np.linspace(west, east, columns), np.linspace(south, north, rows))
        lon, lat = np.radians(self._angles.transform_points(self._projection, x, y).T[:2])
        lon, lat = lon.T, lat.T
        inside = contains_xy(Polygon(self._projection.boundary), x, y) & np.isfinite(lon + lat)
        nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
        return lon[tuple(nearest)], lat[tuple(nearest)], x, y

    def place(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """As `Map.place`."""
        points = self._projection.transform_points(self._angles, np.degrees(lon), np.degrees(lat))
        points[~np.isfinite(points)] = np.nan
        return points[..., 0], points[..., 1]

    def outline(self) -> tuple[Array, Array]:
        """As `Map.outline`."""
        x, y = np.array(self._projection.boundary.coords).T
        return x, y

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
