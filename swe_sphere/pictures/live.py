"""A field drawn in the terminal while a run is stepped (`run --live FIELD`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.runfile import Frame
from swe_sphere.io.scalar_fields import check_field
from swe_sphere.pictures.drawing import Drawing, limits
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import MapGrid
from swe_sphere.pictures.plot import default_field
from swe_sphere.ranks.terminal import screen

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

WIDEST, LINES_BESIDE = 160, 3
"""Largest number of columns; lines of the terminal left for the caption and the prompt."""


class LivePicture:
    """Draws a field over the picture before; a map of longitude by latitude, two rows a line.

    field: its name, or "auto" for what suits the scene.  own: names of user-defined fields.
    Raises ConfigError for an unknown field.
    """

    def __init__(self, field: str, own: Iterable[str] = ()) -> None:
        from rich.console import Console

        self._field = field if field == "auto" else check_field(field, own)
        self._console = Console(file=screen("stderr"), highlight=False)
        self._drawing: Drawing | None = None
        self._ends: tuple[float, float] | None = None

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
            look = Look(contours=False)
            self._drawing = Drawing(frame, name, look, _grid(_rows(self._console)))
        self._drawing.source = frame
        values = self._drawing.values(time)
        low, high = limits(values, self._drawing.kind)
        if self._ends:  # one scale of colours, which widens where it must
            low, high = min(low, self._ends[0]), max(high, self._ends[1])
        self._ends = low, high
        picture = self._coloured(values)
        kind = self._drawing.kind
        caption += f": {kind.title}, {low:.4g} to {high:.4g} {kind.plain_units}"
        if not first:
            self._console.file.write(f"\x1b[{len(values) // 2 + 1}F")
        self._console.print(picture, soft_wrap=True)
        self._console.print(caption[: self._console.width - 1].ljust(self._console.width - 1))

    def _coloured(self, values: Array) -> Text:
        """Return the picture; each character is the upper half of a block on the lower colour."""
        from rich.text import Text

        assert self._drawing is not None and self._ends is not None
        low, high = self._ends
        colours = self._drawing.colours((values[::-1] - low) / (high - low), bytes=True)[..., :3]
        names = np.apply_along_axis(lambda c: "#{:02x}{:02x}{:02x}".format(*c), -1, colours)
        text = Text(no_wrap=True, end="")
        for upper, lower in zip(names[::2], names[1::2], strict=True):
            for above, below in zip(upper, lower, strict=True):
                text.append("▀", f"{above} on {below}")
            text.append("\n")
        return text


def _grid(rows: int) -> MapGrid:
    """Points of a map of longitude by latitude."""
    angles = np.linspace(-np.pi, np.pi, 2 * rows - 1), np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
    lon, lat = np.meshgrid(*angles)
    return MapGrid(lon, lat, lon, lat)


def _rows(console: Console) -> int:
    """Return an even number of latitudes: there are twice as many longitudes, less one."""
    most = min((min(console.width, WIDEST) + 1) // 2, 2 * (console.height - LINES_BESIDE))
    return max(2 * (most // 2), 4)
