"""Winds and heights on a latitude-longitude grid in a netCDF file, checked and interpolated.

The file has

* one-dimensional variables `lat` or `latitude` and `lon` or `longitude` [degrees]: latitudes in
  order, up to the poles but for a grid spacing; longitudes equally spaced eastward, an even number
  of them, once around without repeating the first;
* `u` and `v`, eastward and northward wind, with units of m s-1;
* `z`, geopotential height with units of m, or geopotential with units of m2 s-2;

each of the three on (lat, lon), other dimensions of length 1 being ignored, and nothing missing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from swe_sphere.equations.scene import Array
from swe_sphere.errors import ConfigError
from swe_sphere.lat_lon import global_spline
from swe_sphere.planet import EARTH

AXES = {"lat": ("lat", "latitude"), "lon": ("lon", "longitude")}
WIND = ("m s-1", "m/s", "m s**-1", "m s^-1", "ms-1", "m.s-1")
METRES = ("m", "metre", "metres", "meter", "meters", "gpm")
GEOPOTENTIAL = ("m2 s-2", "m**2 s**-2", "m^2 s^-2", "m2/s2", "m^2/s^2", "m2 s**-2")
LEAST = 8
"""So many latitudes and longitudes there must be."""


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

    @cached_property
    def _splines(self) -> list[Callable[[Array, Array], Array]]:
        fields = ((self.u, -1.0), (self.v, -1.0), (self.z, 1.0))
        return [global_spline(self.lat, self.lon, field, 3, sign) for field, sign in fields]


def read_analysis(path: Path) -> Analysis:
    """The winds and heights in the file.

    Raises:
        ConfigError: the file is not there, is no netCDF, or is not as described above; one line
            that says what to change.
    """
    import netCDF4

    try:
        dataset = netCDF4.Dataset(path)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror or 'not a netCDF file'}") from None
    try:
        with dataset:
            return _read(dataset)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _read(dataset: Any) -> Analysis:
    lat, lon = (_axis(dataset, name) for name in AXES)
    dims = [dataset[_name_of(dataset, name)].dimensions[0] for name in AXES]
    fields = {name: _field(dataset, name, dims) for name in "uvz"}
    lat, lon = np.radians(lat), np.radians(lon)
    order = np.argsort(lat)
    u, v, z = (field[order] for field in fields.values())
    return Analysis(lat[order], lon, u, v, z)


def _name_of(dataset: Any, axis: str) -> str:
    for name in AXES[axis]:
        if name in dataset.variables:
            return name
    raise ConfigError(f"there is no variable {' or '.join(AXES[axis])}")


def _axis(dataset: Any, axis: str) -> Array:
    """Latitudes or longitudes [degrees]."""
    name = _name_of(dataset, axis)
    variable = dataset[name]
    if variable.ndim != 1 or variable.size < LEAST:
        raise ConfigError(f"{name} must have one dimension and at least {LEAST} values")
    units = getattr(variable, "units", "degrees")
    if not units.startswith("degree"):
        raise ConfigError(f"{name} must be in degrees, not in {units!r}")
    values = _numbers(variable, name)
    (_check_latitudes if axis == "lat" else _check_longitudes)(name, values)
    return values


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


def _field(dataset: Any, name: str, dims: list[str]) -> Array:
    """A field (latitudes, longitudes) in m s-1 or m."""
    if name not in dataset.variables:
        raise ConfigError(f"there is no variable {name}; u, v and z are needed")
    variable = dataset[name]
    factor = _factor(name, str(getattr(variable, "units", "")).strip())
    kept = [d for d, n in zip(variable.dimensions, variable.shape, strict=True) if n > 1]
    if sorted(kept) != sorted(dims):
        shape = ", ".join(
            f"{d}={n}" for d, n in zip(variable.dimensions, variable.shape, strict=True)
        )
        raise ConfigError(
            f"{name} must be on ({', '.join(dims)}), not on ({shape}): take one level and time"
        )
    values = _numbers(variable, name).squeeze() * factor
    return values if kept == dims else values.T


def _factor(name: str, units: str) -> float:
    """What the numbers are to be multiplied by."""
    if name != "z":
        if units in WIND:
            return 1.0
        raise ConfigError(f"{name} must have units 'm s-1', not {units!r}")
    if units in METRES:
        return 1.0
    if units in GEOPOTENTIAL:
        return 1.0 / EARTH.gravity
    raise ConfigError(f"z must have units 'm' (height) or 'm2 s-2' (geopotential), not {units!r}")


def _numbers(variable: Any, name: str) -> Array:
    values = np.ma.filled(np.ma.asarray(variable[:], dtype=np.float64), np.nan)
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing:
        raise ConfigError(f"{name} has {missing} missing or infinite values; there must be none")
    return np.asarray(values)
