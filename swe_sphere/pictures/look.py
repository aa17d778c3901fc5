"""How a picture shall look: what `plot` and `animate` can be told."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.io.scalar_fields import Field
from swe_sphere.pictures.projections import Map, make_map

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

WINDS = ("arrows", "streamlines")


@dataclass(frozen=True)
class Look:
    """Projection, region, colours and what is drawn over the field.

    Raises ConfigError for what cannot be drawn, in one line.
    """

    projection: str = "equal-earth"
    """One of `projections.PROJECTIONS`."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Longitude and latitude of the middle [degrees]; latitude for orthographic alone."""
    region: tuple[float, float, float, float] | None = None
    """West, east, south, north [degrees]."""
    limits: tuple[float, float] | None = None
    """Ends of the colour scale."""
    levels: int | None = None
    """About how many contours."""
    colours: str | None = None
    """A colour map of cmocean or matplotlib."""
    contours: bool | None = None
    """None: where they are not all loops and islands."""
    panel: bool = True
    """Curves of errors and drifts underneath."""
    mesh: bool = False
    """Edges of the elements."""
    winds: str | None = None
    """"arrows" or "streamlines"."""

    def __post_init__(self) -> None:
        if self.winds not in (None, *WINDS):
            raise unknown_name("drawing of winds", self.winds, WINDS)
        if self.limits is not None and not (
            all(map(math.isfinite, self.limits)) and self.limits[0] < self.limits[1]
        ):
            raise ConfigError(f"limits are low,high with low < high, not {self.limits}")
        if self.levels is not None and not 1 <= self.levels <= 100:
            raise ConfigError(f"levels={self.levels}: 1 to 100 contours can be told apart")
        self.map()

    def map(self) -> Map:
        """The map that is drawn on."""
        return make_map(self.projection, self.centre, self.region)

    def colour_map(self, kind: Field) -> Colormap:
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
