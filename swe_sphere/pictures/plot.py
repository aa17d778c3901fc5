"""Pictures of a run: a field on the globe, its errors and the drift of what it should conserve."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.durable import clear_errors
from swe_sphere.errors import ConfigError
from swe_sphere.io.compare import Source, open_source
from swe_sphere.io.frame import Frame
from swe_sphere.io.runfile import Nodal, RunFile
from swe_sphere.io.scalar_fields import Field, check_field, describe
from swe_sphere.mesh import Mesh
from swe_sphere.pictures.globe import draw_graticule, equal_earth, globe_grid
from swe_sphere.pictures.panels import draw_panel, panels
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

__all__ = ["draw_state", "plot_file"]

Array = NDArray[np.float64]

ROWS = 361
"""Latitudes of the grid a field is evaluated on: every half degree."""

LEVELS, DIVERGING_LEVELS = 14, 8
"""At most about so many contour lines."""

DOTS_PER_INCH = 160


def plot_file(
    path: str | os.PathLike[str],
    field: str | None = None,
    time: float | None = None,
    out: str | os.PathLike[str] | None = None,
) -> Path:
    """Draw a field of a file on the globe, with its series of errors and drifts underneath.

    field: a name in `fields.FIELDS`; None: what the file's attribute `plot_field` names, else the
    free surface over orography (and of a reference), and the depth elsewhere.
    time [s]: the frame, None for the last.
    out: the picture (its ending says the format); None: beside the file, named after it and the
    field, and the day if one is asked for, as in jet_vorticity_day4.png.
    Returns the path of the picture.  Raises ConfigError if the file cannot be read or lacks the
    field or frame, or if the picture cannot be written.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    source = open_source(path)
    field = check_field(field or _default_field(source))
    day = "" if time is None else f"_day{time / DAY:g}"
    beside = source.path.with_name(f"{source.path.stem}_{field}{day}.png")
    out = beside if out is None else Path(out)
    if out.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise ConfigError(f"cannot draw {out}: give a name ending in .png, .pdf or .svg")
    figure = Figure(layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1))
    _compose(figure, source, field, source.nearest(time))
    with clear_errors(f"cannot write {out}"):
        figure.savefig(out, dpi=DOTS_PER_INCH)
    return out


def _default_field(source: Source | Nodal) -> str:
    flat = isinstance(source, Nodal) and not source.bottom.any()
    return str(source.attributes.get("plot_field", "h" if flat else "surface"))


def _compose(figure: Figure, source: Source, field: str, time: float | None) -> None:
    curves = panels(source) if isinstance(source, RunFile) else []
    figure.set_size_inches(9.6, 9.0 if curves else 6.1)
    parts = figure.subfigures(2 if curves else 1, 1, height_ratios=[2.1, 1.0][: 1 + bool(curves)])
    globe, *rest = np.ravel(np.array(parts, dtype=object))
    _draw_globe(globe.subplots(), source, field, time)
    for part in rest:
        for axes, panel in zip(np.atleast_1d(part.subplots(1, len(curves))), curves, strict=True):
            draw_panel(axes, panel, time)


def draw_state(
    mesh: Mesh,
    fields: Mapping[str, Array],
    time: float,
    attributes: Mapping[str, Any],
    field: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a state in memory: fields (N,) at the nodes at time [s]; into ax, or a new figure.

    Raises ConfigError for a field that is not there.
    """
    source = Frame(mesh, fields, time, attributes)
    field = field or _default_field(source)
    if field not in fields:
        field = check_field(field)
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.figure(figsize=(9.6, 6.1), layout="constrained").subplots()
    _draw_globe(ax, source, field, time)
    return ax


def _draw_globe(axes: Axes, source: Source | Nodal, field: str, time: float | None) -> None:
    from matplotlib.ticker import ScalarFormatter

    kind = describe(field)
    lon, lat = globe_grid(ROWS)
    values = source.at(field, lon.ravel(), lat.ravel(), time).reshape(lon.shape)
    x, y = equal_earth(lon, lat)
    low, high = _limits(values, kind)
    image = axes.pcolormesh(
        x, y, values, cmap=_colours(kind), vmin=low, vmax=high, shading="gouraud", rasterized=True
    )
    if kind.contours:
        _draw_contours(axes, x, y, values, kind, (low, high))
    if field != "b" and isinstance(source, Nodal) and source.bottom.any():
        bottom = source.at("b", lon.ravel(), lat.ravel(), time).reshape(lon.shape)
        _draw_orography(axes, x, y, bottom)
    draw_graticule(axes)
    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-3, 5))
    bar = axes.figure.colorbar(
        image, ax=axes, orientation="horizontal", shrink=0.6, aspect=40, pad=0.03, format=numbers
    )
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(labelsize=9, width=0.5)
    bar.set_label(f"{kind.title} [{kind.units}]", fontsize=10)
    _write_titles(axes, source, kind, time)


def _limits(values: Array, kind: Field) -> tuple[float, float]:
    """Ends of the colour scale; symmetric about zero for a diverging field, never equal."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if kind.diverging:
        low, high = -max(-low, high), max(-low, high)
    spread = max(high - low, 1e-9 * max(abs(low), abs(high)), np.finfo(float).tiny * 1e10)
    middle = 0.5 * (low + high)
    return middle - 0.5 * spread, middle + 0.5 * spread


def _colours(kind: Field) -> Colormap:
    import cmocean

    colours: Colormap = getattr(cmocean.cm, kind.colours)
    # the darkest end hides the contour lines
    return colours if kind.diverging else cmocean.tools.crop_by_percent(colours, 28, which="max")


def _draw_contours(
    axes: Axes, x: Array, y: Array, values: Array, kind: Field, limits: tuple[float, float]
) -> None:
    from matplotlib.ticker import MaxNLocator

    levels = MaxNLocator(DIVERGING_LEVELS if kind.diverging else LEVELS).tick_values(*limits)
    levels = levels[(levels > values.min()) & (levels < values.max())]
    if kind.diverging:
        levels = levels[levels != 0.0]  # the zero line of a nearly still region is all noise
    if levels.size:
        axes.contour(
            x, y, values, levels=levels, colors="0.1", linewidths=0.45, alpha=0.55, zorder=2
        )


def _draw_orography(axes: Axes, x: Array, y: Array, bottom: Array) -> None:
    levels = bottom.min() + np.ptp(bottom) * np.array([0.04, 0.25, 0.5, 0.75])
    for colour, width in (("white", 2.2), ("#5b3a1e", 1.0)):
        axes.contour(
            x, y, bottom, levels=levels, colors=colour, linewidths=width, linestyles="solid",
            zorder=3,
        )  # fmt: skip


def _write_titles(axes: Axes, source: Source | Nodal, kind: Field, time: float | None) -> None:
    name = str(source.attributes.get("scene", ""))
    title = f"{name}: {source.title}" if name and name not in source.title else source.title
    axes.set_title(title, fontsize=14, fontweight="bold", pad=26, parse_math=False)
    parts = [kind.title] + ([] if time is None else [f"day {time / DAY:.4g}"])
    if isinstance(source, Nodal):
        parts += [f"ne{source.mesh.ne} np{source.mesh.np}"]
        parts += [f"Schmidt {source.mesh.stretch:g}"] if source.mesh.stretch != 1.0 else []
        parts += [str(scheme)] if (scheme := source.attributes.get("scheme")) else []
        if isinstance(dt := source.attributes.get("dt"), (int, float)):
            parts += [f"Δt = {dt:g} s"]
    axes.text(
        0.5, 1.015, "  ·  ".join(parts), transform=axes.transAxes, ha="center", va="bottom",
        fontsize=10, color="0.3", parse_math=False,
    )  # fmt: skip
