"""The functions of a scene with checks at each evaluation, so that callers get sound arrays."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.files.user_file import guarded

STATE, RATES, WIND = ("u", "v", "h"), ("du/dt", "dv/dt", "dh/dt"), ("u", "v")

RETURNS: Mapping[str, tuple[str, ...]] = {
    "initial": STATE, "exact": STATE, "base": STATE, "forcing": RATES, "wind": WIND,
    "bottom": (), "coriolis": (), "equilibrium": (),
}  # fmt: skip
"""Return values of the functions of a scene, by name: a tuple of fields, or one field."""


def checked_functions(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the functions of a scene by attribute name, wrapped so that they check their results.

    given: the attributes of the scene by name. Raises ConfigError for one that is not a function.
    """
    scene, tracers, exact = given["name"], given["tracers"], given["exact_tracers"]
    functions: dict[str, Any] = {
        name: _Function(f"{scene}: {name}", given[name], returns, may_be_nan=name == "exact")
        for name, returns in RETURNS.items()
        if given[name] is not None or name == "initial"
    }
    if tracers is not None:
        functions["tracers"] = {
            name: _Function(f"{scene}: tracer {name}", function)
            for name, function in tracers.items()
        }
    if exact is not None:
        label = f"{scene}: exact_tracers"
        functions["exact_tracers"] = _Function(label, exact, (*tracers,), True, True)
    return functions


@dataclass(frozen=True)
class _Function:
    """A function of (lon, lat) [rad], or of (lon, lat, t) [rad, rad, s].

    It returns float64 arrays of the broadcast shape of lon and lat; numbers and smaller arrays are
    broadcast. Raises ConfigError, with the names of scene and field, for a function that fails and
    for anything but finite real numbers of that shape.
    """

    label: str
    function: Callable[..., Any]
    names: tuple[str, ...] = ()
    """Names of the fields that it returns; empty for a single field."""
    may_be_nan: bool = False
    """True if NaN may stand for unknown values."""
    by_name: bool = False
    """True if the function returns fields by name, some or all of them, instead of a tuple."""

    def __post_init__(self) -> None:
        function = self.function.function if isinstance(self.function, _Function) else self.function
        if not callable(function):
            raise ConfigError(f"{self.label} must be a function, got {type(function).__name__}")
        object.__setattr__(self, "function", function)

    def __call__(self, lon: ArrayLike, lat: ArrayLike, *time: float) -> Any:
        return guarded(self.label, self._evaluated, np.asarray(lon), np.asarray(lat), *time)

    def _evaluated(self, lon: Array, lat: Array, *time: float) -> Any:
        with np.errstate(all="ignore"):  # the result is checked
            result = self.function(lon, lat, *time)
        lon, lat = np.broadcast_arrays(lon, lat)
        if not self.names:
            return fitted(self.label, result, lon, lat, self.may_be_nan)
        named = self._named(result)
        if not isinstance(named, dict):
            what = "fields by the names of tracers" if self.by_name else f"{len(self.names)} fields"
            raise ConfigError(
                f"{self.label} must return {what} ({', '.join(self.names)}), got {named}"
            )
        fields = {
            name: fitted(f"{self.label} {name}", field, lon, lat, self.may_be_nan)
            for name, field in named.items()
        }
        return fields if self.by_name else tuple(fields.values())

    def _named(self, result: Any) -> dict[str, Any] | str:
        """Return the fields by name, or a description of any other result."""
        if not isinstance(result, Mapping if self.by_name else Iterable):
            return type(result).__name__
        if self.by_name:
            return str([*result]) if {*result} - {*self.names} else dict(result)
        fields = [*result]
        fits = len(fields) == len(self.names)
        return dict(zip(self.names, fields, strict=True)) if fits else f"{len(fields)} of them"


def fitted(label: str, original: Any, lon: Array, lat: Array, may_be_nan: bool = False) -> Array:
    """Return the values as a float64 array of the shape of lon and lat.

    Raises ConfigError for anything but finite real numbers that broadcast to that shape.
    """
    values = np.asanyarray(original)
    if values.dtype.kind not in "fiub":  # real numbers, or booleans that stand for 0 and 1
        kind = type(original).__name__ if values.ndim == 0 else f"an array of {values.dtype}"
        raise ConfigError(f"{label} must be real numbers, got {kind}")
    values = values.astype(np.float64, copy=False)
    if hasattr(values, "filled"):  # a masked array; numpy has them in a module that loads late
        values = values.filled(np.nan)
    try:
        field = np.broadcast_to(np.asarray(values), lon.shape)
    except ValueError:
        raise ConfigError(
            f"{label} has the shape {values.shape}; it must be an array of shape"
            f" {lon.shape}, like the longitudes given, or a number"
        ) from None
    sound = np.abs(field) < 1e30  # powers of larger numbers do not fit into a float64
    if may_be_nan:
        sound |= np.isnan(field)
    if not sound.all():
        value, *where = (a[~sound][0] for a in (field, np.degrees(lon), np.degrees(lat)))
        fault = "too large" if np.isfinite(value) else "not finite"
        raise ConfigError(
            f"{label} is {fault} ({value:.3g}) at longitude {where[0]:.4g}°,"
            f" latitude {where[1]:.4g}°: correct its formula"
        )
    return field
