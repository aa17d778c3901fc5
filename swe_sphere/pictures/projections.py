"""Maps of the globe: projections, and the grids on which fields are evaluated.

On plain axes lengths are in radii of the sphere.  Robinson: table of Robinson (1974), by monotone
cubics between its latitudes.  Equal Earth: Savric, Patterson and Jenny (2018), Int. J. Geogr. Inf.
Sci. 33, 454-465, eqs. 1-2, doi:10.1080/13658816.2018.1504949.  The others: Snyder (1987), Map
Projections: A Working Manual, U.S. Geol. Surv. Prof. Pap. 1395, chapters 12, 20 and 21.
Those of axes of cartopy have no coasts, and fields are evaluated, not resampled.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.mesh.sphere import frame, longitude_latitude, position

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Region = tuple[float, float, float, float]

COEFFICIENTS = (1.340264, -0.081106, 0.000893, 0.003796)
POWERS = np.array([0, 2, 6, 8])

ROBINSON_WIDTH = (
    1.0, 0.9986, 0.9954, 0.99, 0.9822, 0.973, 0.96, 0.9427, 0.9216, 0.8962, 0.8679, 0.835, 0.7986,
    0.7597, 0.7186, 0.6732, 0.6213, 0.5722, 0.5322,
)  # fmt: skip
ROBINSON_HEIGHT = (
    0.0, 0.062, 0.124, 0.186, 0.248, 0.31, 0.372, 0.434, 0.4958, 0.5571, 0.6176, 0.6769, 0.7346,
    0.7903, 0.8435, 0.8936, 0.9394, 0.9761, 1.0,
)  # fmt: skip

PROJECTIONS = (
    "equal-earth", "robinson", "lat-lon", "orthographic", "north-polar", "south-polar",
)  # fmt: skip
"""Names of the projections; the last two are stereographic."""


def equal_earth(lon: ArrayLike, lat: ArrayLike) -> tuple[Array, Array]:
    """x, y of lon in [-pi, pi], lat [rad]."""
    lon, lat = np.asarray(lon, dtype=float), np.asarray(lat, dtype=float)
    angle = np.arcsin(0.5 * np.sqrt(3.0) * np.sin(lat))
    powers = angle[..., None] ** POWERS
    slope = powers @ (COEFFICIENTS * (POWERS + 1))
    x = 2.0 * np.sqrt(3.0) * lon * np.cos(angle) / (3.0 * slope)
    return x, angle * (powers @ np.array(COEFFICIENTS))


@cache
def _robinson_table() -> Any:
    from scipy.interpolate import PchipInterpolator

    degrees = np.arange(0.0, 91.0, 5.0)
    return PchipInterpolator(degrees, np.stack([ROBINSON_WIDTH, ROBINSON_HEIGHT], axis=-1))


def robinson(lon: ArrayLike, lat: ArrayLike) -> tuple[Array, Array]:
    """x, y of lon in [-pi, pi], lat [rad]."""
    width, height = np.moveaxis(_robinson_table()(np.abs(np.degrees(lat))), -1, 0)
    return 0.8487 * width * lon, 1.3523 * height * np.sign(lat)


def plate_carree(lon: ArrayLike, lat: ArrayLike) -> tuple[Array, Array]:
    """The angles themselves."""
    return np.asarray(lon, dtype=float), np.asarray(lat, dtype=float)


class Map(ABC):
    """A projection with its centre and the part of the globe that it shows."""

    @abstractmethod
    def grid(self, rows: int) -> tuple[Array, Array, Array, Array]:
        """lon, lat [rad] and x, y of a grid that covers the map, so many rows from end to end."""

    @abstractmethod
    def place(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """x, y of points [rad]; NaN where they are not on the map."""

    @abstractmethod
    def outline(self) -> tuple[Array, Array]:
        """x, y along the edge of the map."""

    @property
    def radius(self) -> float:
        """That of the sphere in units of x and y."""
        return 1.0


@dataclass(frozen=True)
class Rounded(Map):
    """Longitudes side by side; centre [rad]; edges [rad]: west, east (from it), south, north."""

    formula: Callable[[ArrayLike, ArrayLike], tuple[Array, Array]]
    centre: float
    edges: Region

    def grid(self, rows: int) -> tuple[Array, Array, Array, Array]:
        """As `Map.grid`."""
        west, east, south, north = self.edges
        away = np.linspace(west, east, 2 * rows - 1)
        lon, lat = np.meshgrid(away, np.linspace(south, north, rows))
        return (lon + self.centre, lat, *self.formula(lon, lat))

    def place(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """As `Map.place`."""
        west, east, south, north = (self.edges[k] + d for k, d in enumerate((-1e-9, 1e-9) * 2))
        away = (np.asarray(lon) - self.centre + np.pi) % (2.0 * np.pi) - np.pi
        inside = (away >= west) & (away <= east) & (lat >= south) & (lat <= north)
        x, y = self.formula(away, lat)
        return np.where(inside, x, np.nan), np.where(inside, y, np.nan)

    def outline(self) -> tuple[Array, Array]:
        """As `Map.outline`."""
        west, east, south, north = self.edges
        up, along = np.linspace(south, north, 181), np.linspace(west, east, 181)
        lon = np.concatenate([0.0 * up + east, along[::-1], 0.0 * up + west, along])
        lat = np.concatenate([up, 0.0 * up + north, up[::-1], 0.0 * up + south])
        return self.formula(lon, lat)


@dataclass(frozen=True)
class Disc(Map):
    """What is within an angle `reach` [rad] of a point, as far from the middle as formula says."""

    formula: Callable[[Array], Array]
    lon: float
    lat: float
    reach: float

    def grid(self, rows: int) -> tuple[Array, Array, Array, Array]:
        """As `Map.grid`."""
        angle = np.linspace(0.0, self.reach, rows)[:, None]
        turn = np.linspace(0.0, 2.0 * np.pi, 2 * rows - 1)[None, :]
        x, y = np.sin(turn) * self.formula(angle), np.cos(turn) * self.formula(angle)
        (east, north), up = frame(*self._centre), position(*self._centre)
        across = np.sin(turn)[..., None] * east + np.cos(turn)[..., None] * north
        xyz = np.cos(angle)[..., None] * up + np.sin(angle)[..., None] * across
        return (*longitude_latitude(xyz), x, y)

    def place(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """As `Map.place`."""
        xyz = position(lon, lat)
        east, north, up = (xyz @ axis for axis in (*frame(*self._centre), position(*self._centre)))
        away = np.hypot(east, north)
        angle = np.arctan2(away, up)
        scale = self.formula(angle) / np.where(away > 0.0, away, 1.0)
        scale = np.where(angle <= self.reach + 1e-9, scale, np.nan)
        return scale * east, scale * north

    def outline(self) -> tuple[Array, Array]:
        """As `Map.outline`."""
        turn = np.linspace(0.0, 2.0 * np.pi, 361)
        radius = float(self.formula(np.array(self.reach)))
        return radius * np.cos(turn), radius * np.sin(turn)

    @property
    def _centre(self) -> tuple[Array, Array]:
        return np.array(self.lon), np.array(self.lat)


def _stereographic(angle: Array) -> Array:
    return np.asarray(2.0 * np.tan(0.5 * angle))


def _orthographic(angle: Array) -> Array:
    return np.asarray(np.sin(angle))


ROUNDED = {"equal-earth": equal_earth, "robinson": robinson, "lat-lon": plate_carree}
GLOBE = (-180.0, 180.0, -90.0, 90.0)


def make_map(name: str, centre: tuple[float, float], region: Region | None = None) -> Map:
    """The map of a projection; centre (lon, lat) and region (west, east, south, north) in degrees.

    The polar maps reach to the equator, or to the edge of the region; that of the southern pole
    has the longitude of the centre upwards, the others downwards or in the middle.  A region whose
    east is less than its west goes across the date line.

    Raises ConfigError for an unknown name, a region that has no width, one on a globe seen from
    outside, or a centre beyond a pole.
    """
    if name not in PROJECTIONS:
        raise unknown_name("projection", name, PROJECTIONS)
    west, east, south, north = region or GLOBE
    if not (-90.0 <= south < north <= 90.0 and west != east and -360.0 <= east - west <= 360.0):
        raise ConfigError(
            "a region is west,east,south,north in degrees: east within 360 degrees of west and not"
            f" the same, -90 <= south < north <= 90, not {west:g},{east:g},{south:g},{north:g}"
        )
    east += 360.0 * (east < west)  # across the date line
    if abs(centre[1]) > 90.0:
        raise ConfigError(f"the latitude of the centre is -90 to 90 degrees, not {centre[1]:g}")
    lon, lat = np.radians(centre)
    if name in ROUNDED:
        middle = np.radians(0.5 * (west + east)) if region else lon
        half = np.radians(0.5 * (east - west))
        edges = (-half, half, np.radians(south), np.radians(north))
        return Rounded(ROUNDED[name], float(middle), edges)
    if name == "orthographic":
        if region:
            raise ConfigError("the orthographic globe takes a centre and no region")
        return Disc(_orthographic, lon, lat, 0.5 * np.pi)
    side = 1.0 if name == "north-polar" else -1.0
    edge = (south if side > 0 else -north) if region else 0.0
    reach = np.radians(90.0 - edge)
    if reach > np.radians(150.0):
        raise ConfigError("a polar map reaches to 60 degrees beyond the equator at most")
    return Disc(_stereographic, lon, side * 0.5 * np.pi, float(reach))


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
