"""`run --live FIELD`: a field drawn in the terminal while the run goes on."""

from __future__ import annotations

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
from swe_sphere.planet import DAY
from swe_sphere.ranks.communicator import Communicator
from swe_sphere.ranks.terminal import screen
from swe_sphere.simulation.diagnostics import DIAGNOSTICS
from swe_sphere.simulation.running import Running

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

PICTURES = 100
"""In a run, evenly spaced in simulated time."""
WIDEST, LINES_BESIDE = 160, 3
"""Columns at most; lines of the terminal that are left for the caption and the prompt."""


class LivePicture:
    """Draws a field over the picture before; a map of longitude by latitude, two rows a line.

    field: its name, or "auto" for what suits the scene.  Raises ConfigError for a field that there
    is not, and where no terminal with colours is there to be drawn on.  Of several ranks the first
    draws what all of them have.
    """

    def __init__(self, field: str, comm: Communicator) -> None:
        from rich.console import Console

        self._field = field if field == "auto" else check_field(field, DIAGNOSTICS)
        self._console = Console(file=screen("stderr"), highlight=False)
        comm.on_root(self._check)
        self._drawing: Drawing | None = None
        self._ends: tuple[float, float] | None = None

    def _check(self) -> None:
        if not self._console.is_terminal or self._console.color_system is None:
            raise ConfigError(
                "live: pictures need a terminal with colours; leave it out, or draw with --plot"
            )

    def __call__(self, sim: Running) -> None:
        """Draw the state."""
        fields = sim.snapshot.with_constants | sim.own_fields
        frame = Frame(sim.mesh, fields, sim.time, {}, sim.own_attributes())
        sim.comm.on_root(lambda: self._draw(sim, frame))

    def _draw(self, sim: Running, frame: Frame) -> None:
        first = self._drawing is None
        if self._drawing is None:
            name = default_field(frame) if self._field == "auto" else self._field
            look = Look(contours=False)
            self._drawing = Drawing(frame, name, look, _grid(_rows(self._console)))
        self._drawing.source = frame
        values = self._drawing.values(sim.time)
        low, high = limits(values, self._drawing.kind)
        if self._ends:  # one scale of colours, which widens where it must
            low, high = min(low, self._ends[0]), max(high, self._ends[1])
        self._ends = low, high
        picture = self._coloured(values)
        days = sim.plan.time(sim.plan.steps) / DAY
        kind = self._drawing.kind
        caption = (
            f"day {sim.time / DAY:.2f} of {days:g}, {sim.scene.name}: {kind.title},"
            f" {low:.4g} to {high:.4g} {kind.plain_units}"
        )
        if not first:
            self._console.file.write(f"\x1b[{len(values) // 2 + 1}F")
        self._console.print(picture, soft_wrap=True)
        self._console.print(caption[: self._console.width - 1].ljust(self._console.width - 1))

    def _coloured(self, values: Array) -> Text:
        """Each character is the upper half of a block, above the colour behind it."""
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
    """An even number of latitudes: there are twice as many longitudes, less one."""
    most = min((min(console.width, WIDEST) + 1) // 2, 2 * (console.height - LINES_BESIDE))
    return max(2 * (most // 2), 4)
