"""A field on a map with its colour scale, title and caption, without contours that show noise."""

import math
from dataclasses import replace

import numpy as np
from cartopy.crs import Stereographic
from cartopy.mpl.geoaxes import GeoAxes
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.layout import TRACER
from swe_sphere.io.reference_solution import Exact
from swe_sphere.io.runfile import Nodal, Source
from swe_sphere.io.scalar_fields import FIELDS, FieldStyle, describe, evaluate
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import MapGrid, draw_graticule, draw_mesh, draw_winds
from swe_sphere.planet import DAY

SIGNED = 1e-3
"""A custom field counts as signed if positive and negative values exceed this part of its range."""
FLAT = 1e-9
"""Relative variation of a field below which it is round-off."""
SUBTITLE, TITLE, CAPTION = 6.0, 20.0, 20.0
"""Distances of the subtitle from the map, of the title from the subtitle, and of the caption from
the map, which leaves room for the labels of the meridians [points]."""
PALE = 0.7
"""Opacity of small print in the text colour of matplotlib's style (black or white)."""
LABELS = 14.0
"""Height of the labels above a polar map [points]; cartopy moves the title above them itself."""


def limits(values: Array, kind: FieldStyle) -> tuple[float, float]:
    """Return both ends of the colour scale: symmetric for a diverging field, and never equal."""
    found = values[np.isfinite(values)]
    low, high = (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)
    if kind.diverging:
        low, high = -max(-low, high), max(-low, high)
    spread = max(high - low, FLAT * max(abs(low), abs(high)), np.finfo(float).tiny * 1e10)
    middle = 0.5 * (low + high)
    return middle - 0.5 * spread, middle + 0.5 * spread


def contours(
    values: Array, kind: FieldStyle, ends: tuple[float, float], count: int | None = None
) -> tuple[Array, float]:
    """Return the contour levels to draw and their interval; count: their approximate number."""
    most = MaxNLocator(count or (8 if kind.diverging else 14))
    levels = np.asarray(most.tick_values(*ends), dtype=np.float64)
    interval = float(levels[1] - levels[0])
    found = values[np.isfinite(values)]
    if not found.size or np.ptp(found) <= 2.0 * FLAT * np.abs(found).max():
        return levels[:0], interval
    kept = drawable(levels, found)
    return kept[np.abs(kept) > 1e-6 * interval] if kind.diverging else kept, interval


def drawable(levels: Array, values: Array) -> Array:
    """Return those of the evenly spaced levels whose contours do not follow ripples of a plateau.

    A level is dropped if 40 % of the values lie within a tenth of an interval from it. For evenly
    distributed values and ten levels the share is 2 %.
    """
    near = 0.1 * (levels[1] - levels[0])
    inside = levels[(levels > values.min()) & (levels < values.max())]
    return np.array([x for x in inside if np.mean(np.abs(values - x) < near) < 0.4])


class Drawing:
    """Drawing of a field of a source, or of its difference from `against`, on the grid of a map."""

    def __init__(
        self, source: Source, field: str, look: Look, grid: MapGrid,
        against: Source | Exact | None = None,
    ) -> None:  # fmt: skip
        self.source, self.field, self.look, self.against = source, field, look, against
        self.grid, kind = grid, describe(field, source.about.get(field))
        if field in source.about and field not in FIELDS and not field.startswith(TRACER):
            values = source.values(field)
            if min(values.max(), -values.min()) > SIGNED * np.ptp(values):
                kind = replace(kind, colours="vik", diverging=True)
        if against is not None:
            what = "error" if isinstance(against, Exact) else "difference"
            kind = replace(kind, title=f"{what} of {kind.title}", colours="vik", diverging=True)
        drawn = kind.contours or look.levels is not None
        drawn = drawn if look.contours is None else look.contours
        self.kind = replace(kind, contours=drawn)
        self.colours = look.colour_map(self.kind)
        self._points = grid.lon.ravel(), grid.lat.ravel()
        self._sampler = source.sampler(*self._points)
        if (look.mesh or look.winds) and not isinstance(source, Nodal):
            raise ConfigError("mesh and winds need the file of a run: a reference has neither")

    def values(self, time: float | None) -> Array:
        """Return the field on the grid at a time [s]."""
        found = self._evaluated(self.field, time)
        if self.against is not None:
            found = found - self.against.at(self.field, *self._points, time)
        return found.reshape(self.grid.x.shape)

    def _evaluated(self, field: str, time: float | None) -> Array:
        return evaluate(self._sampler, self.source.state(time), field)

    def draw(
        self, axes: GeoAxes, time: float | None, ends: tuple[float, float] | None = None,
        within: bool = False,
    ) -> None:  # fmt: skip
        """Draw the field at a time [s] on the map to which the grid belongs.

        ends: ends of the colour scale, unless the look sets limits. within: the map belongs to a
        figure of the caller; it then gets a title only if it has none, and no caption.
        """
        values, (_, _, x, y) = self.values(time), self.grid
        low, high = self.look.limits or ends or limits(values, self.kind)
        dx, dy = 0.5 * (x[0, 1] - x[0, 0]), 0.5 * (y[1, 0] - y[0, 0])
        # matplotlib's method, because cartopy would resample an image beyond the edge of the globe
        image = Axes.imshow(
            axes, values, cmap=self.colours, vmin=low, vmax=high, interpolation="bilinear",
            extent=(x[0, 0] - dx, x[0, -1] + dx, y[0, 0] - dy, y[-1, 0] + dy), origin="lower",
        )  # fmt: skip
        notes = [self._contoured(axes, values, (low, high)), *self._overlaid(axes, time)]
        draw_graticule(axes, self.grid)
        _draw_scale(axes, image, self.kind)
        when = [] if time is None else [f"day {time / DAY:.7g}"]
        if within:
            axes.set_title(axes.get_title() or ", ".join([self.kind.title, *when]))
            return
        _write_titles(axes, self.source, [self.kind.title, *when])
        axes.annotate(
            "  ".join(filter(None, notes)), (0.5, 0.0), xycoords="axes fraction", va="top",
            xytext=(0.0, -CAPTION), textcoords="offset points", ha="center", fontsize=8.5,
            alpha=PALE, parse_math=False,
        )  # fmt: skip

    def _contoured(self, axes: GeoAxes, values: Array, ends: tuple[float, float]) -> str:
        """Draw contours of the field; return their caption."""
        if not self.kind.contours:
            return ""
        levels, interval = contours(values, self.kind, ends, self.look.levels)
        if levels.size == 0:
            return ""
        axes.contour(
            self.grid.x, self.grid.y, values, levels=levels, colors="0.1", linewidths=0.45,
            alpha=0.55, zorder=2,
        )  # fmt: skip
        return f"Contours every {interval:.4g} {self.kind.plain_units}".rstrip() + "."

    def _overlaid(self, axes: GeoAxes, time: float | None) -> list[str]:
        """Draw bottom, mesh and winds of a run; return their captions."""
        source = self.source
        notes: list[str] = []
        if not isinstance(source, Nodal):
            return notes
        if self.field != "b" and source.bottom.any():
            notes.append(self._bottom(axes, time))
        if self.look.mesh:
            draw_mesh(axes, source.mesh)
        if how := self.look.winds:
            strongest = draw_winds(axes, source.mesh, source.frame(time), how)
            notes.append(f"{how.capitalize()}: wind, at most {strongest:.3g} m/s.")
        return notes

    def _bottom(self, axes: GeoAxes, time: float | None) -> str:
        """Draw contours of the bottom at about four round heights; return their caption."""
        bottom = self._evaluated("b", time).reshape(self.grid.x.shape)
        low, high = float(bottom.min()), float(bottom.max())
        round_numbers = MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        levels = drawable(np.asarray(round_numbers), bottom)
        levels = levels[levels > low + 4e-3 * (high - low)]
        if levels.size == 0:
            return ""
        for colour, width in (("white", 1.8), ("#5b3a1e", 0.9)):
            axes.contour(
                self.grid.x, self.grid.y, bottom, levels=levels, colors=colour, linewidths=width,
                linestyles="solid", zorder=3,
            )  # fmt: skip
        return f"Brown: bottom at {', '.join(f'{level:.6g}' for level in levels)} m."


def _draw_scale(axes: GeoAxes, image: AxesImage, kind: FieldStyle) -> None:
    ends = np.array(image.get_clim(), dtype=float)
    power = math.floor(math.log10(np.abs(ends).max()))
    power = 0 if -3 <= power < 5 else power
    bar = axes.figure.colorbar(
        image, ax=axes, orientation="horizontal", shrink=0.6, aspect=40, pad=0.07,
        format=lambda value, _: f"{value / 10.0**power:.10g}".replace("-", "−"),
    )  # fmt: skip
    if np.ptp(ends) < 1e-3 * np.abs(ends).max():  # long numbers: only a few fit
        bar.locator = MaxNLocator(4)
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(labelsize=9, width=0.5)
    units = kind.units if power == 0 else f"10$^{{{power}}}$ {kind.units}"
    bar.set_label(f"{kind.title} [{units}]".removesuffix(" []"), fontsize=10)


def _write_titles(axes: GeoAxes, source: Source, parts: list[str]) -> None:
    low = SUBTITLE + LABELS * isinstance(axes.projection, Stereographic)
    name = str(source.attributes.get("scene", ""))
    title = f"{name}: {source.title}" if name and name not in source.title else source.title
    axes.set_title(title, fontsize=14, fontweight="bold", pad=SUBTITLE + TITLE, parse_math=False)
    if isinstance(source, Nodal):
        parts += [f"ne{source.mesh.ne} np{source.mesh.np}"]
        parts += [f"Schmidt {source.mesh.stretch:g}"] if source.mesh.stretch != 1.0 else []
        parts += [str(scheme)] if (scheme := source.attributes.get("scheme")) else []
        if isinstance(dt := source.attributes.get("dt"), (int, float)):
            parts += [f"Δt = {float(f'{dt:.4g}'):g} s"]
    axes.annotate(
        "  ·  ".join(parts), (0.5, 1.0), xycoords="axes fraction", xytext=(0.0, low), alpha=PALE,
        textcoords="offset points", ha="center", va="bottom", fontsize=10, parse_math=False,
    )  # fmt: skip
