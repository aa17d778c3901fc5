"""Maps of the globe as axes of cartopy, and the overlays that are drawn on them.

Nothing is downloaded: coasts and other features of the Earth are left to the caller.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import cartopy.crs as crs
import numpy as np
from cartopy.mpl.geoaxes import GeoAxes
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from scipy.ndimage import distance_transform_edt
from shapely import LinearRing, Polygon, contains_xy

from swe_sphere.arrays import Array
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import frame, longitude_latitude, position
from swe_sphere.pictures.look import POLAR, Look
from swe_sphere.planet import EARTH

APART = (60.0, 30.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05)
"""Spacings of the meridians [degrees]: the widest with at least four meridians is drawn."""
GLOBE = crs.Globe(ellipse=None, semimajor_axis=EARTH.radius, semiminor_axis=EARTH.radius)
"""Globe of all maps: cartopy's own is an ellipsoid."""
STILL = 0.02
"""Winds weaker than this fraction of the strongest wind are not drawn."""


class MapGrid(NamedTuple):
    """Points (rows, columns) of a map: lon, lat [rad], and x, y in map coordinates."""

    lon: Array
    lat: Array
    x: Array
    y: Array


class PolarMap(crs.Stereographic):  # type: ignore[misc]
    """Stereographic map of the disc between a pole and a latitude.

    pole: 90 or -90. lon: longitude [degrees] that points down on a northern and up on a southern
    map. edge: latitude of the rim [degrees].
    """

    boundary: Any = None  # attributes, where cartopy has properties
    x_limits: Any = None
    y_limits: Any = None

    def __init__(self, pole: float, lon: float, edge: float) -> None:
        super().__init__(central_latitude=pole, central_longitude=lon, globe=GLOBE)
        radius = math.hypot(*self.transform_point(lon, edge, crs.Geodetic()))
        turn = np.linspace(0.0, 2.0 * np.pi, 361)
        self.boundary = LinearRing(radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1))
        self.x_limits = self.y_limits = -radius, radius


def new_map(figure: Figure | SubFigure, look: Look) -> GeoAxes:
    """Add a map with the projection, centre and region of `look` to a figure."""
    west, east, south, north = look.edges
    region = look.region and look.projection not in POLAR
    lon = wrapped(0.5 * (west + east) if region else look.centre[0])
    projections: dict[str, Callable[[], Any]] = {
        "equal-earth": lambda: crs.EqualEarth(lon, globe=GLOBE),
        "robinson": lambda: crs.Robinson(lon, globe=GLOBE),
        "lat-lon": lambda: crs.PlateCarree(lon, globe=GLOBE),
        "orthographic": lambda: crs.Orthographic(lon, look.centre[1], globe=GLOBE),
        "north-polar": lambda: PolarMap(90.0, lon, look.lowest),
        "south-polar": lambda: PolarMap(-90.0, lon, -look.lowest),
    }
    axes: GeoAxes = figure.add_subplot(projection=projections[look.projection]())
    axes.set_global()
    if region:
        half = min(0.5 * (east - west), 180.0 - 1e-6)  # both edges of a whole turn stay apart
        axes.set_extent((-half, half, south, north), crs.PlateCarree(lon, globe=GLOBE))
    return axes


def wrapped(lon: Any) -> Any:
    """Return longitudes [degrees] from -180 up to 180."""
    return (lon + 180.0) % 360.0 - 180.0


def aspect(axes: GeoAxes) -> float:
    """Height of a map divided by its width."""
    return abs(float(np.ptp(axes.get_ylim()) / np.ptp(axes.get_xlim())))


def grid_of(axes: GeoAxes, rows: int) -> MapGrid:
    """Return a grid of square cells, or of 1500 columns, that covers the axes' visible region.

    Points beyond the edge of the globe have the longitude and latitude of the nearest point on it:
    the axes clip them, and a field that is drawn on the grid reaches up to the edge.
    """
    columns = min(max(2, round(rows / aspect(axes))), 1500)  # about the pixels of a picture
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    x, y = np.meshgrid(np.linspace(west, east, columns), np.linspace(south, north, rows))
    degrees = axes.projection.as_geodetic().transform_points(axes.projection, x, y)
    lon, lat = np.radians(degrees[..., 0]), np.radians(degrees[..., 1])
    inside = contains_xy(Polygon(axes.projection.boundary), x, y) & np.isfinite(lon + lat)
    nearest = tuple(distance_transform_edt(~inside, return_distances=False, return_indices=True))
    return MapGrid(lon[nearest], lat[nearest], x, y)


def place(axes: GeoAxes, lon: Array, lat: Array) -> Array:
    """Return map coordinates (..., 2) of points [rad], NaN where the map cannot show them."""
    degrees = wrapped(np.degrees(lon)), np.degrees(lat)
    points = axes.projection.transform_points(axes.projection.as_geodetic(), *degrees)[..., :2]
    return np.where(np.isfinite(points).all(axis=-1, keepdims=True), points, np.nan)


def draw_graticule(axes: GeoAxes, grid: MapGrid) -> None:
    """Draw labelled parallels and meridians; the orthographic globe has no labels."""
    style, projection = {"size": 7.5, "alpha": 0.7}, axes.projection
    labels: Any = not isinstance(projection, crs.Orthographic)
    if labels and not isinstance(projection, crs.Stereographic):
        labels = ["x", "y", "left", "bottom", "geo"]
    axes.gridlines(
        draw_labels=labels, xlocs=_meridians(grid), x_inline=False, y_inline=False,
        rotate_labels=False, xlabel_style=style, ylabel_style=style, color="0.4", linewidth=0.4,
        alpha=0.5,
    )  # fmt: skip


def _meridians(grid: MapGrid) -> list[float]:
    """Return round longitudes [degrees] on a grid, also on one that crosses the date line."""
    middle = np.degrees(grid.lon[grid.lon.shape[0] // 2, grid.lon.shape[1] // 2])
    away = wrapped(np.degrees(grid.lon) - middle)
    west, east = middle + away.min(), middle + away.max()
    step = next((step for step in APART if east - west + 1e-6 > 4.0 * step), APART[-1])
    return sorted({*wrapped(np.arange(step * math.ceil(west / step), east + 1e-6, step)).tolist()})


def draw_mesh(axes: GeoAxes, mesh: Mesh) -> None:
    """Draw the edges of the elements, except those that cross the seam of the map."""
    nodes = mesh.nodes
    edges = np.concatenate([nodes[:, 0], nodes[:, -1], nodes[:, :, 0], nodes[:, :, -1]])
    lines = place(axes, mesh.lon[edges], mesh.lat[edges])
    longest = np.nan_to_num(np.abs(np.diff(lines, axis=1))).max(axis=(1, 2))
    whole = list(lines[longest < 0.25 * np.ptp(axes.projection.x_limits)])
    drawn = LineCollection(whole, colors="0.15", linewidths=0.35, alpha=0.6, zorder=3)
    axes.add_collection(drawn, autolim=False)


def draw_winds(axes: GeoAxes, mesh: Mesh, fields: dict[str, Array], how: str) -> float:
    """Draw arrows or streamlines of the wind; return the strongest wind on the map [m s-1].

    fields: u and v (N,) [m s-1] at the nodes.  how: "arrows" or "streamlines".
    """
    count = 900 if how == "arrows" else 6400
    grid = grid_of(axes, max(2, round(math.sqrt(count * aspect(axes)))))
    flat = evaluate(Interpolator(mesh, grid.lon.ravel(), grid.lat.ravel()), fields, "wind")
    u, v = flat.reshape(2, *grid.x.shape)
    speed = np.hypot(u, v)
    if (strongest := float(speed.max())) == 0.0:
        return strongest
    there, direction = _direction(axes, grid, u, v)
    seen = np.where(speed > STILL * strongest, speed, np.nan)
    along, up = np.moveaxis(direction * seen[..., None], -1, 0)
    if how == "arrows":
        apart = float(grid.x[0, 1] - grid.x[0, 0])
        same = np.abs(there - np.stack([grid.x, grid.y], axis=-1)).max(axis=-1) < 1e-3 * apart
        shown = same & np.isfinite(along)
        axes.quiver(
            grid.x[shown], grid.y[shown], along[shown], up[shown], units="inches", width=0.011,
            headwidth=4.0, color="0.1", edgecolor="white", linewidth=0.2, zorder=4,
            scale_units="xy", pivot="mid", angles="xy", scale=strongest / (1.2 * apart),
        )  # fmt: skip
    else:
        inches = axes.get_window_extent().width / axes.figure.dpi
        # matplotlib's method, because cartopy would interpolate the wind to another grid
        Axes.streamplot(
            axes, grid.x, grid.y, np.ma.masked_invalid(along), np.ma.masked_invalid(up),
            density=1.6 * min(1.0, inches / 7.0), color="0.1", arrowsize=0.6, arrowstyle="->",
            linewidth=0.35 + 0.75 * speed / strongest, zorder=4,
        )  # fmt: skip
    return strongest


def _direction(axes: GeoAxes, grid: MapGrid, u: Array, v: Array) -> tuple[Array, Array]:
    """Return map coordinates (..., 2) of a grid, and unit vectors (..., 2) along the wind there.

    Directions are measured over 1e-4 rad, forwards or backwards so as to stay within the map.
    """
    xyz, (east, north) = position(grid.lon, grid.lat), frame(grid.lon, grid.lat)
    wind = u[..., None] * east + v[..., None] * north
    step = 1e-4 * wind / np.maximum(np.linalg.norm(wind, axis=-1, keepdims=True), 1e-300)
    here = place(axes, grid.lon, grid.lat)
    moves = [
        sign * (place(axes, *longitude_latitude(xyz + sign * step)) - here) for sign in (1.0, -1.0)
    ]
    lengths = [np.linalg.norm(move, axis=-1, keepdims=True) for move in moves]
    length = np.fmin(*lengths)
    move = np.where(lengths[0] == length, *moves)
    with np.errstate(invalid="ignore", divide="ignore"):
        return here, move / length
