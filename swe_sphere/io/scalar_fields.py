"""The scalar fields of files: names, units, colours, and how to derive them."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.io.layout import TRACER, VARIABLES


@dataclass(frozen=True)
class FieldStyle:
    """Title, units, colour map of cmcrameri and drawing options of a field."""

    title: str
    units: str
    colours: str
    diverging: bool = False
    """True if zero is the middle of the scale."""
    contours: bool = True
    """True if contour lines are drawn; derivatives have too many small closed loops."""

    @property
    def plain_units(self) -> str:
        """Units for a terminal and for captions; empty for pure numbers."""
        plain = POWER.sub(lambda found: found[1].translate(RAISED), self.units)
        return "" if self.units == "1" else plain


POWER, RAISED = re.compile(r"\$\^\{(.*?)\}\$"), str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


STYLES = VARIABLES["pictures"] | VARIABLES["derived"]
FIELDS = {name: FieldStyle(**table) for name, table in STYLES.items()}
"""Scalar fields by name.  Errors are also available for the vector "wind", and a run with tracers
has the mixing ratio "q_NAME" of each."""


def describe(name: str, about: Mapping[str, Any] | None = None) -> FieldStyle:
    """Return title and drawing options of a field by name; about: attributes of its variable."""
    if name.startswith(TRACER):
        title = f"mixing ratio of {name.removeprefix(TRACER)}"
        return FieldStyle(title, "1", "lajolla_r", contours=False)
    if name in FIELDS:
        return FIELDS[name]
    given = {"long_name": name.replace("_", " "), "units": "", **(about or {})}
    units = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"$^{\1}$", str(given["units"]))
    return FieldStyle(str(given["long_name"]), units, "lapaz_r", contours=False)


def check_field(name: str, own: Iterable[str] = (), *, vector: bool = False) -> str:
    """Return the name of an existing field; "wind" is one only with `vector`.

    own: names of the fields in a file. Only the file determines which names of tracers exist.

    Raises ConfigError, with the nearest name, if there is no such field.
    """
    names = [*FIELDS, "wind"] if vector else [*FIELDS]
    names += [each for each in own if each not in names]
    if name in names or name.startswith(TRACER):
        return name
    raise unknown_name("field", name, names)


def derive(fields: Mapping[str, Array], name: str) -> Array:
    """Return the named field from stored ones (u, h, f, area, ...): (N,), for "wind" (2, N)."""
    if name in fields:
        return fields[name]
    if name == "surface":
        return derive(fields, "h") + fields.get("b", 0.0)
    if name == "speed":
        return np.hypot(derive(fields, "u"), derive(fields, "v"))
    if name == "kinetic_energy":
        return 0.5 * derive(fields, "speed") ** 2
    if name == "potential_vorticity":
        return (derive(fields, "vorticity") + derive(fields, "f")) / derive(fields, "h")
    if name == "potential_vorticity_anomaly":
        return at_depth(fields, np.average(derive(fields, "h"), weights=derive(fields, "area")))
    if name == "wind":
        return np.stack([derive(fields, "u"), derive(fields, "v")])
    raise ConfigError(f"the field {name!r} is missing; there are {', '.join(fields)}")


def at_depth(fields: Mapping[str, Array], depth: float) -> Array:
    """Return the relative vorticity (N,) [s-1] of the columns brought to that depth [m]."""
    coriolis = derive(fields, "f")
    return (derive(fields, "vorticity") + coriolis) * depth / derive(fields, "h") - coriolis


class Sampler(Protocol):
    """Evaluates fields given at the points of a source at other points."""

    def __call__(self, field: Array, /) -> Array:
        """Return a scalar field at these points."""

    def wind(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Return the eastward and northward components of a vector at these points."""


def evaluate(sampler: Sampler | None, fields: Mapping[str, Array], name: str) -> Array:
    """Return the named field at the points of a sampler from fields (N,) of a source.

    Fields derived from the wind use the vector, because its components jump at the poles. Without a
    sampler nothing is interpolated: the points are those of the source.
    """
    if sampler is None:
        return derive(fields, name)
    if (name in ("speed", "wind", "kinetic_energy") and name not in fields) or name in ("u", "v"):
        u, v = sampler.wind(*derive(fields, "wind"))
        return derive({"u": u, "v": v}, name)
    return sampler(derive(fields, name))
