"""A field drawn in the terminal while a run is stepped (`run --live FIELD`)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from rich.console import Console
from rich.text import Text

from swe_sphere.errors import ConfigError
from swe_sphere.io.runfile import Frame
from swe_sphere.io.scalar_fields import check_field
from swe_sphere.pictures.drawing import Drawing, limits
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import MapGrid
from swe_sphere.pictures.plot import default_field

WIDEST, LINES_BESIDE = 160, 3
"""Largest number of columns; lines of the terminal left for the caption and the prompt."""


class LivePicture:
    """Draws a field over the picture before; a map of longitude by latitude, two rows a line.

    field: its name, or "auto" for what suits the scene.  own: names of user-defined fields.
    Raises ConfigError for an unknown field.
    """

    def __init__(self, field: str, own: Iterable[str] = ()) -> None:
        self._field = field if field == "auto" else check_field(field, own)
        self._console = Console(stderr=True, highlight=False)
        self._drawing: Drawing | None = None
        self._low, self._high = np.inf, -np.inf

    def check_terminal(self) -> None:
        """Raise ConfigError where there is no terminal with colours to draw on."""
        if not self._console.is_terminal or self._console.color_system is None:
            raise ConfigError(
                "live: pictures need a terminal with colours; leave it out, or draw with --plot"
            )

    def draw(self, frame: Frame, time: float, caption: str) -> None:
        """Draw the frame of a time [s]; the caption is completed with the field and its range."""
        first = self._drawing is None
        if self._drawing is None:
            name = default_field(frame) if self._field == "auto" else self._field
            self._drawing = Drawing(frame, name, Look(contours=False), self._grid())
        self._drawing.source = frame
        values, kind = self._drawing.values(time), self._drawing.kind
        low, high = limits(values, kind)  # one scale of colours, which widens where it must
        self._low, self._high = min(low, self._low), max(high, self._high)
        share = (values[::-1] - self._low) / (self._high - self._low)
        colours = self._drawing.colours(share, bytes=True)[..., :3]
        names = np.apply_along_axis(lambda c: "#{:02x}{:02x}{:02x}".format(*c), -1, colours)
        picture = Text(no_wrap=True, end="")
        for upper, lower in zip(names[::2], names[1::2], strict=True):
            for above, below in zip(upper, lower, strict=True):
                picture.append("▀", f"{above} on {below}")
            picture.append("\n")
        caption += f": {kind.title}, {self._low:.4g} to {self._high:.4g} {kind.plain_units}"
        if not first:
            self._console.file.write(f"\x1b[{len(values) // 2 + 1}F")
        self._console.print(picture, soft_wrap=True)
        self._console.print(caption[: self._console.width - 1].ljust(self._console.width - 1))

    def _grid(self) -> MapGrid:
        """Return a map of longitude by latitude with an even number of rows."""
        width, height = min(self._console.width, WIDEST), self._console.height - LINES_BESIDE
        rows = max(2 * (min((width + 1) // 2, 2 * height) // 2), 4)
        lon, lat = np.meshgrid(
            np.linspace(-np.pi, np.pi, 2 * rows - 1), np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
        )
        return MapGrid(lon, lat, lon, lat)
