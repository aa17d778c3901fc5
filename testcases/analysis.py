"""Winds and heights on a latitude-longitude grid in a netCDF file, checked and interpolated.

The file has

* one-dimensional variables `lat` or `latitude` and `lon` or `longitude` [degrees]: latitudes in
  order, up to the poles but for a grid spacing; longitudes equally spaced eastward, an even number
  of them, once around without repeating the first;
* eastward wind `u`, northward wind `v`, with units of m s-1, and `z`, geopotential height with
  units of m or geopotential with units of m2 s-2, by the names of ERA5 or those of NCEP (`uwnd`,
  `vwnd`, `hgt`) or CMIP (`ua`, `va`, `zg`);

each of the three on (lat, lon), nothing missing.  Of a dimension of pressures the level of 500 hPa
is taken; other dimensions must have length 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from swe_sphere.equations.scene import Array, State
from swe_sphere.errors import ConfigError
from swe_sphere.mesh.sphere import global_spline
from swe_sphere.planet import EARTH
from swe_sphere.testcases.harmonics import Complex, GaussGrid, synthesis
from swe_sphere.testcases.random_flow import BalancedFlow, inverse_laplacian

NAMES = {
    "lat": ("lat", "latitude"),
    "lon": ("lon", "longitude"),
    "u": ("u", "uwnd", "ua"),
    "v": ("v", "vwnd", "va"),
    "z": ("z", "hgt", "zg"),
}
PASCALS = {"Pa": 1.0, "hPa": 100.0, "millibar": 100.0, "millibars": 100.0, "mb": 100.0}
LEVEL = 5e4
"""Pressure [Pa] of the level that is read."""
WIND = dict.fromkeys(("m s-1", "m/s", "m s**-1", "m s^-1", "ms-1", "m.s-1"), 1.0)
HEIGHT = dict.fromkeys(("m", "metre", "metres", "meter", "meters", "gpm"), 1.0) | dict.fromkeys(
    ("m2 s-2", "m**2 s**-2", "m^2 s^-2", "m2/s2", "m^2/s^2", "m2 s**-2"), 1.0 / EARTH.gravity
)
"""Factors that take numbers of these units to m s-1 and to m."""
LEAST = 8
"""Smallest number of latitudes and of longitudes."""


@dataclass(frozen=True)
class Analysis:
    """Fields (latitudes, longitudes) on a grid: lat ascending, lon equally spaced [rad]."""

    lat: Array
    lon: Array
    u: Array
    v: Array
    z: Array

    def mean_height(self) -> float:
        """Area mean of z [m]: trapezoidal rule in the sine of the latitude."""
        edges = 0.5 * (np.sin(self.lat[1:]) + np.sin(self.lat[:-1]))
        weights = np.diff(edges, prepend=-1.0, append=1.0)
        return float(weights @ self.z.mean(axis=1) / 2.0)

    def state(self, lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        """Eastward wind, northward wind [m s-1] and height [m], by bicubic splines."""
        u, v, z = (spline(lon, lat) for spline in self._splines)
        return u, v, z

    def filtered(self, degree: int, balanced: bool = False) -> State:
        """The state without spherical harmonics above the degree; mean height as it is.

        balanced: without the divergent wind, and with the height that keeps it from growing at
        once (`BalancedFlow`), so that next to no gravity waves are left.
        """
        grid = GaussGrid(max(degree, self.lat.size))
        u, v, z = self.state(*grid.points)
        wanted = slice(degree + 1), slice(degree + 1)

        def potential(east: Array, north: Array) -> Complex:
            """Of which the field is the gradient, as far as it is one."""
            return -EARTH.radius * inverse_laplacian(grid.against_gradients(east, north)[wanted])

        streamfunction, height = potential(v, -u), grid.coefficients(z)[wanted]
        if balanced:
            return BalancedFlow(streamfunction, EARTH, height[0, 0].real).state
        parts = np.stack([height, streamfunction, potential(u, v)])

        def state(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
            value, east, north = synthesis(parts, lon, lat)
            slopes = (east[2] - north[1]) / EARTH.radius, (north[2] + east[1]) / EARTH.radius
            return *slopes, value[0]

        return state

    @cached_property
    def _splines(self) -> list[Callable[[Array, Array], Array]]:
        fields = ((self.u, -1.0), (self.v, -1.0), (self.z, 1.0))
        return [global_spline(self.lat, self.lon, field, 3, sign) for field, sign in fields]


def read_analysis(path: Path) -> Analysis:
    """The winds and heights in the file.

    Raises:
        ConfigError: the file is not there, is no netCDF, is damaged, or is not as described above;
            one line that says what to change.
    """
    import netCDF4

    try:
        with netCDF4.Dataset(path) as dataset:
            return _read(dataset)
    except (OSError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or "damaged, or not a netCDF file"
        raise ConfigError(f"cannot read {path}: {why}") from None
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _read(dataset: Any) -> Analysis:
    lat_name, lon_name = (_name_of(dataset, axis) for axis in ("lat", "lon"))
    lat, lon = (_degrees(dataset[name], name) for name in (lat_name, lon_name))
    _check_latitudes(lat_name, lat)
    _check_longitudes(lon_name, lon)
    dims = [dataset[name].dimensions[0] for name in (lat_name, lon_name)]
    order = np.argsort(lat)
    u, v, z = (_field(dataset, field, dims)[order] for field in "uvz")
    return Analysis(np.radians(lat)[order], np.radians(lon), u, v, z)


def _name_of(dataset: Any, ours: str) -> str:
    for name in NAMES[ours]:
        if name in dataset.variables:
            return name
    wanted = "; u, v and z are needed" if ours in "uvz" else ""
    raise ConfigError(f"there is no variable {' or '.join(NAMES[ours])}{wanted}")


def _degrees(variable: Any, name: str) -> Array:
    """Return latitudes or longitudes [degrees]."""
    if variable.ndim != 1 or variable.size < LEAST:
        raise ConfigError(f"{name} must have one dimension and at least {LEAST} values")
    units = getattr(variable, "units", "degrees")
    if not units.startswith("degree"):
        raise ConfigError(f"{name} must be in degrees, not in {units!r}")
    return _numbers(variable, name)


def _check_latitudes(name: str, lat: Array) -> None:
    steps = np.diff(lat)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        raise ConfigError(f"{name} must rise or fall from pole to pole")
    if np.abs(lat).max() > 90.0 + 1e-6:
        raise ConfigError(f"{name} must lie between -90 and 90, not reach {np.abs(lat).max():g}")
    gap = max(90.0 - lat.max(), 90.0 + lat.min())
    if gap > 1.5 * np.abs(steps).max():
        raise ConfigError(f"{name} must reach the poles; {gap:.3g} degrees are missing")


def _check_longitudes(name: str, lon: Array) -> None:
    if len(lon) % 2:
        raise ConfigError(
            f"{name} must be an even number of values, not {len(lon)} (is the first one repeated?)"
        )
    step = 360.0 / len(lon)
    if np.abs(np.diff(lon) - step).max() > 1e-3 * step:
        raise ConfigError(f"{name} must be {len(lon)} equal steps of {step:.4g} degrees eastward")


def _field(dataset: Any, ours: str, dims: list[str]) -> Array:
    """Return a field (latitudes, longitudes) in m s-1 or m."""
    name = _name_of(dataset, ours)
    variable = dataset[name]
    units, known = str(getattr(variable, "units", "")).strip(), HEIGHT if ours == "z" else WIND
    if units not in known:
        wanted = "'m' (height) or 'm2 s-2' (geopotential)" if ours == "z" else "'m s-1'"
        raise ConfigError(f"{name} must have units {wanted}, not {units!r}")
    sizes = dict(zip(variable.dimensions, variable.shape, strict=True))
    levels = {d: _level(dataset, d) for d in sizes if d not in dims}
    key = tuple(levels.get(d, slice(None)) for d in sizes)
    kept = [d for d, n in sizes.items() if n > 1 and not isinstance(levels.get(d), int)]
    if sorted(kept) != sorted(dims):
        shape = ", ".join(f"{d}={n}" for d, n in sizes.items())
        raise ConfigError(
            f"{name} must be on ({', '.join(dims)}), not on ({shape}): take one level and time"
        )
    values = _numbers(variable, name, key).squeeze() * known[units]
    return values if kept == dims else values.T


def _level(dataset: Any, axis: str) -> int | slice:
    """Return the index of 500 hPa on an axis of pressures, all of any other."""
    variable = dataset.variables.get(axis)
    factor = PASCALS.get(getattr(variable, "units", ""))
    if factor is None or variable.shape == (1,):
        return slice(None)
    found = np.flatnonzero(np.isclose(variable[:] * factor, LEVEL))
    if found.size != 1:
        raise ConfigError(f"{axis} does not hold the level of 500 hPa")
    return int(found[0])


def _numbers(variable: Any, name: str, key: Any = slice(None)) -> Array:
    values = np.ma.filled(np.ma.asarray(variable[key], dtype=np.float64), np.nan)
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing:
        raise ConfigError(f"{name} has {missing} missing or infinite values; there must be none")
    return np.asarray(values)
