"""Pictures of a run: a field on the globe, its errors and the drift of what it should conserve."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import clear_errors
from swe_sphere.io.compare import Source, open_source
from swe_sphere.io.runfile import Frame, Nodal, RunFile
from swe_sphere.io.scalar_fields import check_field
from swe_sphere.mesh import Mesh
from swe_sphere.pictures.drawing import Drawing
from swe_sphere.pictures.exact import Exact
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import aspect, grid_of, new_map
from swe_sphere.pictures.panels import draw_panel, panels
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    from cartopy.mpl.geoaxes import GeoAxes

ROWS = 361
"""Latitudes of the grid a field is evaluated on: every half degree."""

DOTS_PER_INCH = 160


def plot_file(
    path: str | os.PathLike[str],
    field: str | None = None,
    time: float | None = None,
    out: str | os.PathLike[str] | None = None,
    look: Look | None = None,
    against: Source | Exact | None = None,
) -> Path:
    """Draw a field of a file on the globe, with its series of errors and drifts underneath.

    field: a name in `scalar_fields.FIELDS` or the file; None: what the file's attribute
    `plot_field` names, else the free surface over orography (and of a reference), and the depth
    elsewhere.
    time [s]: the frame, None for the last.
    out: the picture (its ending says the format); None: beside the file, named after it and the
    field, and the day if one is asked for, as in jet_vorticity_day4.png.
    look: projection, colours, overlays.  against: draw the difference from this.
    Returns the path of the picture.  Raises ConfigError if the file cannot be read or lacks the
    field or frame, or if the picture cannot be written.
    """
    look, source = look or Look(), open_source(path)
    field = check_field(field or default_field(source), source.about)
    day = "" if time is None else f"_day{time / DAY:g}"
    beside = source.path.with_name(f"{source.path.stem}_{field}{day}.png")
    out = beside if out is None else Path(out)
    if out.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise ConfigError(f"cannot draw {out}: give a name ending in .png, .pdf or .svg")
    curves = panels(source) if look.panel and isinstance(source, RunFile) else []
    figure = new_figure()
    parts = figure.subfigures(2 if curves else 1, 1, height_ratios=[2.3, 1.0][: 1 + bool(curves)])
    globe, *rest = np.ravel(np.array(parts, dtype=object))
    axes, time = new_map(globe, look), source.nearest(time)
    figure.set_size_inches(*size(axes, bool(curves)))
    Drawing(source, field, look, grid_of(axes, ROWS), against).draw(axes, time)
    for part in rest:
        for below, panel in zip(np.ravel(part.subplots(1, len(curves))), curves, strict=True):
            draw_panel(below, panel, time)
    with clear_errors(f"cannot write {out}"):
        png = out.suffix.lower() == ".png"
        smaller: dict[str, Any] = {"pil_kwargs": {"optimize": True}} if png else {}
        figure.savefig(out, dpi=DOTS_PER_INCH, **smaller)
    return out


def new_figure() -> Figure:
    """An empty figure whose parts make room for each other."""
    return Figure(layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1))


def default_field(source: Source | Nodal) -> str:
    """What a source shows unless it is told."""
    flat = isinstance(source, Nodal) and not source.bottom.any()
    return str(source.attributes.get("plot_field", "h" if flat else "surface"))


def size(axes: GeoAxes, panel: bool = False) -> tuple[float, float]:
    """Width and height of a figure with a map [inches]; panel: with curves underneath."""
    return 9.6, 2.3 + 9.0 * min(aspect(axes), 0.75) + (2.9 if panel else 0.0)


def draw_state(
    mesh: Mesh,
    fields: Mapping[str, Array],
    time: float,
    attributes: Mapping[str, Any],
    field: str | None = None,
    ax: GeoAxes | None = None,
    look: Look | None = None,
    about: Mapping[str, Mapping[str, Any]] | None = None,
) -> GeoAxes:
    """Draw a state in memory on a map; return the map.

    fields: (N,) at the nodes, at time [s].  ax: axes of cartopy, whose projection and extent
    replace those of the look; None: a new figure.  about: long_name and units of user-defined
    fields.

    Raises ConfigError for a field that is missing, and for axes that are not of cartopy.
    """
    from cartopy.mpl.geoaxes import GeoAxes

    look, source = look or Look(), Frame(mesh, fields, time, attributes, about)
    field = check_field(field or default_field(source), fields)
    if ax is None:
        from matplotlib import pyplot

        figure = pyplot.figure(layout="constrained")
        ax = new_map(figure, look)
        figure.set_size_inches(*size(ax))
    elif not isinstance(ax, GeoAxes):
        raise ConfigError(
            "ax must be axes of cartopy: figure.add_subplot(projection=cartopy.crs.Robinson())"
        )
    elif ax.get_autoscale_on():
        ax.set_global()
    Drawing(source, field, look, grid_of(ax, ROWS)).draw(ax, time)
    return ax
