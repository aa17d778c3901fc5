"""A field of a run on the globe: pictures of files and states, films, pictures in the terminal."""

import os
from collections.abc import Iterable
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any, Self

import matplotlib as mpl
import numpy as np
from cartopy.mpl.geoaxes import GeoAxes
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from rich.console import Console
from rich.text import Text

from swe_sphere.errors import ConfigError, shown
from swe_sphere.files.durable import building, translate_errors
from swe_sphere.io.growing import check_free
from swe_sphere.io.reference_solution import Exact, open_source
from swe_sphere.io.runfile import Nodal, RunFile, Source
from swe_sphere.io.scalar_fields import check_field
from swe_sphere.pictures.drawing import Drawing, limits
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import MapGrid, aspect, grid_of, new_map
from swe_sphere.pictures.panels import draw_panel, panels
from swe_sphere.planet import DAY

ROWS, FILM_ROWS = 361, 181
"""Number of rows of the grid on which fields are drawn, in pictures and in films."""
DOTS_PER_INCH, FILM_DOTS_PER_INCH = 160, 100


def plot_file(
    path: str | os.PathLike[str], field: str | None = None, time: float | None = None,
    out: str | os.PathLike[str] | None = None, look: Look | None = None,
    against: Source | Exact | None = None, overwrite: bool = False,
) -> Path:  # fmt: skip
    """Draw a field of a file on the globe, with its series of errors and drifts below.

    field: a name in `scalar_fields.FIELDS` or in the file; None: the attribute `plot_field` of the
    file, otherwise the free surface for references and runs with orography, and the depth for other
    runs. time: the frame [s]; None for the last. out: the picture (.png, .pdf or .svg); None: a
    name beside the file, such as jet_vorticity_day4.png. look: projection, colours, overlays.
    against: source whose field is subtracted. overwrite: replace an existing picture.

    Returns the path of the picture. Raises ConfigError if the file cannot be read or lacks the
    field or frame, or if the picture cannot be written.
    """
    look, source = look or Look(), open_source(path)
    field = check_field(field or default_field(source), source.about)
    day = "" if time is None else f"_day{time / DAY:.7g}"
    beside = source.path.with_name(f"{source.path.stem}_{field}{day}.png")
    out = beside if out is None else Path(out)
    if out.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise ConfigError(f"cannot draw {out}: give a name ending in .png, .pdf or .svg")
    check_free(out, overwrite)
    curves = panels(source) if look.panel and isinstance(source, RunFile) else []
    figure, rows = new_figure(), 1 + bool(curves)
    globe, *rest = figure.subfigures(rows, 1, squeeze=False, height_ratios=[2.3, 1.0][:rows]).flat
    axes, time = new_map(globe, look), source.frame_time(time)
    figure.set_size_inches(*size(axes, bool(curves)))
    Drawing(source, field, look, grid_of(axes, ROWS), against).draw(axes, time)
    for part in rest:
        for pair in zip(part.subplots(1, len(curves), squeeze=False).flat, curves, strict=True):
            draw_panel(*pair, time)
    png = out.suffix.lower() == ".png"
    smaller: dict[str, Any] = {"pil_kwargs": {"optimize": True}} if png else {}
    with translate_errors(f"cannot write {out}"), building(out) as part:
        figure.savefig(part, dpi=DOTS_PER_INCH, **smaller)
    return out


def new_figure() -> Figure:
    """Return an empty figure whose layout keeps its parts from overlapping."""
    return Figure(layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1))


def default_field(source: Source) -> str:
    """Return the field that a source shows by default."""
    flat = isinstance(source, Nodal) and not source.bottom.any()
    return str(source.attributes.get("plot_field", "h" if flat else "surface"))


def size(axes: GeoAxes, panel: bool = False) -> tuple[float, float]:
    """Return width and height of a figure [inches]; panel: whether curves are below the map."""
    return 9.6, 2.3 + 9.0 * min(aspect(axes), 0.75) + (2.9 if panel else 0.0)


def draw_state(
    state: Nodal, field: str | None = None, ax: GeoAxes | None = None, look: Look | None = None,
    time: float | None = None,
) -> GeoAxes:  # fmt: skip
    """Draw a state in memory on a map; return the map.

    field, look: as for `plot_file`. time: the frame [s]; None for the last. ax: axes of cartopy,
    which keep projection, extent and title; None for a new figure with titles and a caption.

    Raises ConfigError for a missing field, axes of another library, or a projection beside axes.
    """
    look, field = look or Look(), check_field(field or default_field(state), state.about)
    if not (within := ax is not None):
        from matplotlib import pyplot

        figure = pyplot.figure(layout="constrained")
        ax = new_map(figure, look)
        figure.set_size_inches(*size(ax))
    elif not isinstance(ax, GeoAxes):
        raise ConfigError(
            "ax must be axes of cartopy: figure.add_subplot(projection=cartopy.crs.Robinson())"
        )
    elif given := look.model_fields_set & {"projection", "centre", "region"}:
        names = ", ".join(sorted(given))
        raise ConfigError(f"ax keeps its projection and extent: leave out {names}")
    elif ax.get_autoscale_on():
        ax.set_global()
    Drawing(state, field, look, grid_of(ax, ROWS)).draw(ax, state.frame_time(time), within=within)
    return ax


def animate_file(
    path: str | os.PathLike[str], field: str | None = None,
    out: str | os.PathLike[str] | None = None, look: Look | None = None, rate: float = 8.0,
    overwrite: bool = False,
) -> Path:  # fmt: skip
    """Draw all frames of a run as a film, with one colour scale.

    field, look: as for `plot_file`. out: a name ending in .gif, or in .mp4, which needs the package
    imageio-ffmpeg; None: an .mp4 beside the file. rate: frames per second. overwrite: replace an
    existing film. Returns out; the file gets its name when it is complete. Raises ConfigError if
    the run cannot be read or has fewer than two frames, or if the film cannot be written.
    """
    source = RunFile(path)
    field = check_field(field or default_field(source), source.about)
    out = source.path.with_name(f"{source.path.stem}_{field}.mp4") if out is None else Path(out)
    check_free(out, overwrite)
    with translate_errors(f"cannot write {out}"), mpl.rc_context():
        writer, film = _film_writer(out, rate), Film.of(source, field, look or Look(), rate)
        try:
            with building(out) as part:
                film.save(part.absolute(), writer, dpi=FILM_DOTS_PER_INCH)
        except CalledProcessError as error:
            raise ConfigError(f"cannot write {out}: the encoder failed: {error.stderr}") from None
    return out


class Film(FuncAnimation):
    """An animation of matplotlib, which a notebook shows; `save` writes it to a file."""

    @classmethod
    def of(cls, source: Nodal, field: str, look: Look, rate: Any) -> Self:
        """Return the film of all frames of a source with one colour scale; rate: per second."""
        _check_rate(rate, 120.0)
        if source.times.size < 2:
            raise ConfigError(f"{source.path} has fewer than two frames: run with a smaller every")
        figure = new_figure()
        axes = new_map(figure, look)
        figure.set_size_inches(*size(axes))
        drawing = Drawing(source, field, look, grid_of(axes, FILM_ROWS))
        frames = (drawing.values(time) for time in source.times)
        ends = [limits(x, drawing.kind) for x in frames if np.isfinite(x).any()] or [(0.0, 1.0)]

        def draw(time: float) -> None:
            figure.clear()
            drawing.draw(new_map(figure, look), time, (np.min(ends), np.max(ends)))

        return cls(figure, draw, source.times, interval=1e3 / rate, cache_frame_data=False)

    def _repr_html_(self) -> str:
        return str(self.to_jshtml(default_mode="loop"))


def _check_rate(rate: Any, most: float) -> None:
    if not (isinstance(rate, (int, float, np.number)) and 0.1 <= rate <= most):
        raise ConfigError(f"rate must be 0.1 to {most:g} frames a second, got {shown(rate)}")


def _film_writer(out: Path, rate: Any) -> PillowWriter | FFMpegWriter:
    """Return the writer of a film; for .mp4 it sets the path of the encoder in matplotlib."""
    if out.suffix.lower() not in (".mp4", ".gif"):
        raise ConfigError(f"cannot draw {out}: give a name ending in .mp4 or .gif")
    if out.suffix.lower() == ".gif":
        _check_rate(rate, 50.0)
        hundredths = round(100.0 / rate)  # of a second a frame; the writer truncates milliseconds
        return PillowWriter(fps=1e3 / (10.0 * hundredths + 0.5))
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ConfigError(
            f"{out} needs the package imageio-ffmpeg: pip install imageio-ffmpeg, or make a .gif"
        ) from None
    mpl.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()
    return FFMpegWriter(fps=rate, codec="h264", extra_args=["-crf", "18"])


class LivePicture:
    """Map in the terminal that each `draw` replaces: longitude by latitude, two rows per line.

    field: name of the field, or "auto" for the default of the scene. own: names of custom fields.
    Raises ConfigError for an unknown field.
    """

    def __init__(self, field: str, own: Iterable[str] = ()) -> None:
        self._field = field if field == "auto" else check_field(field, own)
        self._console = Console(stderr=True, highlight=False)
        self._drawing: Drawing | None = None
        self._low, self._high = np.inf, -np.inf

    def check_terminal(self) -> None:
        """Raise ConfigError if there is no terminal with colours to draw on."""
        if not self._console.is_terminal or self._console.color_system is None:
            raise ConfigError(
                "live: pictures need a terminal with colours; leave it out, or draw with --plot"
            )

    def draw(self, frame: Nodal, time: float, caption: str) -> None:
        """Draw a frame at a time [s]; field and ends of the colour scale follow the caption."""
        first = self._drawing is None
        if self._drawing is None:
            name = default_field(frame) if self._field == "auto" else self._field
            self._drawing = Drawing(frame, name, Look(contours=False), self._grid())
        self._drawing.source = frame
        values, kind = self._drawing.values(time), self._drawing.kind
        low, high = limits(values, kind)  # one colour scale, which widens if necessary
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
        """Return a grid of longitude by latitude with an even number of rows."""
        # three lines remain for the caption and the prompt
        width, height = min(self._console.width, 160), self._console.height - 3
        rows = max(2 * (min((width + 1) // 2, 2 * height) // 2), 4)
        lat = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
        lon, lat = np.meshgrid(np.linspace(-np.pi, np.pi, 2 * rows - 1), lat)
        return MapGrid(lon, lat, lon, lat)
