"""States on latitude-longitude grids: references, regridded runs; errors of a run against them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import in_python
from swe_sphere.io.norms import Norms, norms
from swe_sphere.io.runfile import nearest_time, reading
from swe_sphere.io.scalar_fields import check_field, derive, evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import frame, global_spline
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    import xarray as xr

NAMES = {"h": "h", "b": "b", "surface": "surface_height", "u": "u", "v": "v",
         "vorticity": "vorticity", "divergence": "divergence"}  # fmt: skip
"""Our name of each field and that of the variable (lat, lon)."""
ON_GRID = ("lat", "lon"), ("time", "lat", "lon")

SHIPPED = Path(__file__).parents[1] / "data"
"""Where the references lie that come with the package; each says in its attributes what it is."""


def shipped_reference(scene: str, days: float) -> Path | None:
    """File of the solution of a scene at that day [days] that comes with the package, if any.

    The scene "galewsky_viscous" is galewsky with the viscosity of 1e5 m2 s-1.
    """
    path = SHIPPED / f"{scene}_day{days:g}.nc"
    return path if path.exists() else None


def latitude_weights(lat: Array, bounds: Array | None = None) -> Array:
    """Share (M,) of the sphere's area that each latitude circle lat (M,) [rad] stands for.

    Gauss weights where the latitudes are those of the Gaussian grid; else the zones between
    bounds (M, 2) [rad], or, without bounds, between the middles of neighbours.
    """
    nodes, weights = np.polynomial.legendre.leggauss(lat.size)
    if bounds is not None:
        return np.abs(np.diff(np.sin(bounds), axis=1)[:, 0]) / 2.0
    order = np.argsort(lat)
    sines = np.sin(lat[order])
    if not np.allclose(sines, nodes, rtol=0.0, atol=1e-6):
        weights = np.diff(0.5 * (sines[1:] + sines[:-1]), prepend=-1.0, append=1.0)
    return weights[np.argsort(order)] / 2.0


class Reference:
    """States on a global grid: lat (M,), lon (K,) evenly spaced [rad], fields (M, K).

    A reference is one state; a regridded run has one for each of its times.

    `points` and `area` run over the M K grid points; areas are shares of the sphere.  Raises
    ConfigError if the file is missing or damaged, or its grid does not go round the sphere.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with reading(path) as data:
            self.attributes = in_python(data.attrs)
            self.title = str(self.attributes.get("title", self.path.stem))
            self.lat, self.lon = (np.radians(data[x].values.astype(float)) for x in ("lat", "lon"))
            self._has_frames = "time" in data.variables
            self.times: Array = data["time"].values if self._has_frames else _titled(self.title)
            """Times [s since the start]; none where neither file nor title states one."""
            self.fields = _fields(self.path, data, -1)
            """Fields of the reference, or of the last time."""
            there = self.fields.keys() & data.variables.keys()
            self.about = {name: in_python(data[name].attrs) for name in there}
            """Attributes of their variables, by our names where those are the same."""
            bounds = np.radians(data["lat_bnds"].values) if "lat_bnds" in data else None
        count = self.lon.size
        around = np.diff(np.unwrap(np.append(self.lon, self.lon[0])))
        if count % 2 or not np.allclose(around, 2.0 * np.pi / count, atol=1e-6):
            raise ConfigError(
                f"{self.path}: longitudes must go round the globe evenly eastward, an even number"
            )
        self.area: Array = np.repeat(latitude_weights(self.lat, bounds) / count, count)

    def nearest(self, time: float | None) -> float | None:
        """As `RunFile`; None for a reference without a time."""
        return nearest_time(self.path, self.times, time) if self.times.size else None

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitude and latitude [rad] of the M K grid points."""
        lat, lon = np.meshgrid(self.lat, self.lon, indexing="ij")
        return lon.ravel(), lat.ravel()

    def values(self, field: str, time: float | None = None) -> Array:
        """A field at the grid points: (M K,), or (2, M K) for "wind"."""
        grids = self.fields
        if self._has_frames and time is not None:
            at = nearest_time(self.path, self.times, time)
            with reading(self.path) as data:
                grids = _fields(self.path, data, int(np.argmin(np.abs(self.times - at))))
        return derive({name: grid.ravel() for name, grid in grids.items()}, field)

    def at(self, field: str, lon: Array, lat: Array, time: float | None = None) -> Array:
        """A field at any points lon, lat (P,) [rad], by a quintic spline through the grid."""

        def spline(values: Array) -> Array:
            grid = values.reshape(self.lat.size, self.lon.size)
            return global_spline(self.lat, self.lon, grid, 5)(lon, lat)

        if field not in ("u", "v", "speed", "wind"):
            return spline(self.values(field, time))
        u, v = self.values("wind", time)[..., None]
        east, north = frame(*self.points)
        cartesian = np.stack([spline(w) for w in (u * east + v * north).T], axis=-1)
        u, v = (np.sum(cartesian * unit, axis=-1) for unit in frame(lon, lat))
        return derive({"u": u, "v": v}, field)


def _titled(title: str) -> Array:
    """Return the time [s] in the title of a reference; none where it states none."""
    return np.array([float(day) * DAY for day in re.findall(r"day (\d+(?:\.\d+)?)", title)[:1]])


def _fields(path: Path, data: xr.Dataset, index: int) -> dict[str, Array]:
    """Return the fields, at the time of that index where there are times."""
    found = {k: data.variables[name] for k, name in NAMES.items() if name in data.variables}
    found |= {
        str(name): variable for name, variable in data.variables.items()
        if variable.dims in ON_GRID and np.issubdtype(variable.dtype, np.number)
        and name not in NAMES.values()
    }  # fmt: skip
    if not found:
        raise ConfigError(
            f"cannot read {path}: it is no file of a run, and as a reference on a grid"
            f" it lacks all of {', '.join(NAMES.values())}"
        )
    for name, variable in found.items():
        if variable.dims not in ON_GRID:
            raise ValueError(f"{NAMES[name]} is not on (lat, lon)")
    return {
        name: variable[index if variable.ndim == 3 else ...].values.astype(float)
        for name, variable in found.items()
    }


class OnGrid:
    """A reference, and the matrix that takes a mesh to its grid, which takes time to make."""

    def __init__(self, reference: Reference, mesh: Mesh) -> None:
        self._reference = reference
        self._interpolator = Interpolator(mesh, *reference.points)

    def norms(self, fields: Mapping[str, Array], field: str = "h") -> dict[str, float]:
        """Return l1, l2, linf of the polynomials in the elements at the points of the grid.

        fields: u, v [m s-1], h, b [m], vorticity, divergence [s-1] at the nodes (N,), as far as the
        field needs them.  field: "h", "surface" (h + b), "vorticity", "wind" (the vector), ...
        Raises ConfigError for an unknown field, or one that the reference does not have.
        """
        name = reference_field(self._reference, check_field(field, vector=True), fields.get("b"))
        return norms(self._reference.area, *self._pair(fields, name))

    def errors(self, fields: Mapping[str, Array], height: str) -> Norms:
        """Errors of height and, as far as the reference has them, of vorticity and wind "v".

        height: "h" or "surface", which is taken where the reference has no depth.
        """
        has = self._reference.fields.keys()
        names = {"h": height if height in has or "surface" not in has else "surface"}
        names |= {"vorticity": "vorticity"} if "vorticity" in has else {}
        names |= {"v": "wind"} if {"u", "v"} <= has else {}
        area = self._reference.area
        return {field: norms(area, *self._pair(fields, name)) for field, name in names.items()}

    def decorrelation(self, fields: Mapping[str, Array]) -> float:
        """1 less the correlation of vorticity with that of the reference."""
        pair = self._pair(fields, "vorticity")
        covariance = np.cov(*pair, aweights=self._reference.area)
        return 1.0 - float(covariance[0, 1]) / float(np.sqrt(covariance[0, 0] * covariance[1, 1]))

    def _pair(self, fields: Mapping[str, Array], name: str) -> tuple[Array, Array]:
        return evaluate(self._interpolator, fields, name), self._reference.values(name)


def reference_field(reference: Reference, field: str, bottom: Array | None) -> str:
    """The field to compare where a reference may hold the free surface and not the depth."""
    if field != "h" or "h" in reference.fields:
        return field
    if bottom is not None and np.any(bottom):
        raise ConfigError(
            f"{reference.path} holds the free surface, not the depth: compare field 'surface'"
        )
    return "surface"
