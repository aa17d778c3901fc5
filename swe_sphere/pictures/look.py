"""How a picture shall look: what `plot` and `animate` can be told."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.pictures.projections import Map, make_map

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

    from swe_sphere.io import scalar_fields

Pair = tuple[float, float]
Four = tuple[float, float, float, float]


def _numbers(*counts: int) -> Callable[[Any], Any]:
    """A text "1,2" as so many numbers, filled up with zeros; what is no text stays."""

    def read(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        parts = value.split(",")
        if len(parts) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"must be {wanted} numbers, separated by commas")
        return [*parts, *["0"] * (counts[-1] - len(parts))]

    return read


class Look(BaseModel):
    """Projection, region, colours and what is drawn over the field."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    projection: str = "equal-earth"
    """equal-earth (the default), robinson, lat-lon, orthographic, north-polar, south-polar."""
    centre: Annotated[Pair, BeforeValidator(_numbers(1, 2))] = (0.0, 0.0)
    """Longitude of the middle of the map [degrees], and latitude for orthographic."""
    region: Annotated[Four, BeforeValidator(_numbers(4))] | None = None
    """Part of the globe that is shown: west, east, south, north [degrees]."""
    limits: Annotated[Pair, BeforeValidator(_numbers(2))] | None = None
    """Ends of the colour scale."""
    levels: Annotated[int, Field(ge=1, le=100)] | None = None
    """About how many contours."""
    colours: str | None = None
    """Colour map of cmocean or matplotlib."""
    contours: bool | None = None
    """Contour lines; by default where they are not all loops and islands."""
    panel: bool = True
    """Curves of errors and drifts underneath."""
    mesh: bool = False
    """Draw the edges of the elements."""
    winds: Literal["arrows", "streamlines"] | None = None
    """Draw the wind."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        """ConfigError for what cannot be drawn."""
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise ConfigError(f"limits are low,high with low < high, not {self.limits}")
        self.map()
        return self

    def map(self) -> Map:
        """The map that is drawn on."""
        return make_map(self.projection, self.centre, self.region)

    def colour_map(self, kind: scalar_fields.Field) -> Colormap:
        """The colours asked for, or those of the field."""
        import cmocean
        import matplotlib as mpl

        if self.colours is None:
            found: Colormap = getattr(cmocean.cm, kind.colours)
            # the darkest end hides the contour lines
            crop = cmocean.tools.crop_by_percent
            return found if kind.diverging else crop(found, 28, which="max")
        if self.colours in cmocean.cm.cmapnames:
            found = getattr(cmocean.cm, self.colours)
        elif self.colours in mpl.colormaps:
            found = mpl.colormaps[self.colours]
        else:
            names = [*cmocean.cm.cmapnames, "viridis", "RdBu_r", "coolwarm", "turbo"]
            raise unknown_name("colour map", self.colours, names)
        return found
