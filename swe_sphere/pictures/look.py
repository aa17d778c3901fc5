"""The look of a picture: the options of `plot` and `animate`."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, model_validator

from swe_sphere.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

    from swe_sphere.io import scalar_fields

Pair = tuple[float, float]
Four = tuple[float, float, float, float]

PROJECTIONS = ("equal-earth", "robinson", "lat-lon", "orthographic", "north-polar", "south-polar")
POLAR = PROJECTIONS[-2:]
"""Names of the stereographic projections."""


def _numbers(*counts: int) -> Callable[[Any], Any]:
    """Return a function that splits texts such as "1,2" and pads with "0" to the largest count."""

    def read(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        if len(parts := value.split(",")) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"must be {wanted} numbers, separated by commas")
        return [*parts, *["0"] * (counts[-1] - len(parts))]

    return read


class Look(
    BaseModel, frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
):
    """Projection, region and colours of a map, and the overlays on the field."""

    projection: str = "equal-earth"
    """equal-earth (the default), robinson, lat-lon, orthographic, north-polar, south-polar."""
    centre: Annotated[Pair, BeforeValidator(_numbers(1, 2))] = (0.0, 0.0)
    """Longitude of the middle [degrees] unless a region sets it, and latitude for orthographic."""
    region: Annotated[Four, BeforeValidator(_numbers(4))] | None = None
    """West, east, south, north [degrees]; a polar map uses south or north, its edge."""
    limits: Annotated[Pair, BeforeValidator(_numbers(2))] | None = None
    """Ends of the colour scale."""
    levels: Annotated[int, Field(ge=1, le=100)] | None = None
    """Approximate number of contours."""
    colours: str | None = None
    """Colour map of cmcrameri or matplotlib."""
    contours: bool | None = None
    """Draw contour lines; by default not for fields whose contours are small closed loops."""
    panel: bool = True
    """Draw curves of errors and drifts below the map."""
    mesh: bool = False
    """Draw the edges of the elements."""
    winds: Literal["arrows", "streamlines"] | None = None
    """Draw the wind."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        """Raise ConfigError for a look that cannot be drawn."""
        low, high = self.limits or (0.0, 1.0)
        if not 1e-300 <= high - low <= 1e300:
            raise ConfigError(f"limits must be low < high, 1e-300 to 1e300 apart, got {low},{high}")
        if self.projection not in PROJECTIONS:
            raise unknown_name("projection", self.projection, PROJECTIONS)
        if abs(self.centre[1]) > 90.0:
            raise ConfigError(
                f"the latitude of the centre must be -90 to 90 degrees, got {self.centre[1]:g}"
            )
        if self.region is None:
            return self
        west, east, south, north = self.region
        wide = min(north - south, abs(east - west)) >= 0.01
        if not (wide and -90.0 <= south < north <= 90.0 and -360.0 < east - west <= 360.0):
            raise ConfigError(
                "a region is west,east,south,north in degrees, at least 0.01 wide and high: -360 <"
                " east - west <= 360, -90 <= south < north <= 90, not"
                f" {west:g},{east:g},{south:g},{north:g}"
            )
        if self.projection == "orthographic":
            raise ConfigError("the orthographic globe accepts a centre but no region")
        if self.projection in POLAR and self.lowest < -60.0:
            raise ConfigError("a polar map reaches to 60 degrees beyond the equator at most")
        return self

    @property
    def edges(self) -> Four:
        """West, east, south, north of the map [degrees], west < east."""
        west, east, south, north = self.region or (-180.0, 180.0, -90.0, 90.0)
        return west, east + 360.0 * (east < west), south, north

    @property
    def lowest(self) -> float:
        """Latitude at the edge of a polar map [degrees], positive on the side of its pole."""
        _, _, south, north = self.region or (0.0, 0.0, 0.0, 0.0)
        return south if self.projection == "north-polar" else -north

    def colour_map(self, kind: "scalar_fields.FieldStyle") -> "Colormap":
        """Return the requested colour map, or that of the field; ConfigError if it is unknown."""
        import matplotlib as mpl
        from cmcrameri import cm
        from matplotlib.colors import ListedColormap

        if self.colours is None:
            colours: Colormap = cm.cmaps[kind.colours]
            if kind.diverging:
                return colours
            # without the dark end, which would hide contour lines
            return ListedColormap(colours(np.linspace(0.0, 0.72, 256)), kind.colours)
        own = f"cmc.{self.colours}"  # the prefix under which cmcrameri registers its maps
        name = own if own in mpl.colormaps else self.colours
        if name not in mpl.colormaps:
            names = [*cm.cmaps, "viridis", "RdBu_r", "coolwarm", "turbo"]
            raise unknown_name("colour map", self.colours, names)
        return mpl.colormaps[name]
