"""Films of a run: MP4 and GIF."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import matplotlib as mpl
from matplotlib.animation import FFMpegWriter, PillowWriter

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import clear_errors
from swe_sphere.io.runfile import RunFile
from swe_sphere.io.scalar_fields import check_field
from swe_sphere.pictures.drawing import Drawing, limits
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import grid_of, new_map
from swe_sphere.pictures.plot import default_field, new_figure, size

ROWS = 181
"""Latitudes of the grid a field is evaluated on: every degree."""
DOTS_PER_INCH = 100


def animate_file(
    path: str | os.PathLike[str],
    field: str | None = None,
    out: str | os.PathLike[str] | None = None,
    look: Look | None = None,
    rate: float = 8.0,
) -> Path:
    """Draw all frames of a run as a film, with one scale of colours.

    field, look: as for `plot_file`.  out: ends in .mp4, which needs the package imageio-ffmpeg, or
    in .gif; None: beside the file.  rate: frames a second.
    Returns out, which gets its name when it is whole.  Raises ConfigError if the file cannot be
    read or has less than two frames, or if the film cannot be written.
    """
    source, look = RunFile(path), look or Look()
    field = check_field(field or default_field(source), source.about)
    out = source.path.with_name(f"{source.path.stem}_{field}.mp4") if out is None else Path(out)
    _check(source, out, rate)
    figure = new_figure()
    axes = new_map(figure, look)
    figure.set_size_inches(*size(axes))
    drawing = Drawing(source, field, look, grid_of(axes, ROWS))
    lows, highs = zip(*(limits(drawing.values(t), drawing.kind) for t in source.times), strict=True)
    part = out.with_name(f"{out.stem}.part{out.suffix}")
    with clear_errors(f"cannot write {out}"), mpl.rc_context(_settings(out)):
        try:
            writer = _writer(out, rate)
            with writer.saving(figure, str(part), DOTS_PER_INCH):
                for time in source.times:
                    figure.clear()
                    drawing.draw(new_map(figure, look), float(time), (min(lows), max(highs)))
                    writer.grab_frame()
            part.replace(out)
        except CalledProcessError as error:
            raise ConfigError(f"cannot write {out}: the encoder failed: {error.stderr}") from None
        finally:
            part.unlink(missing_ok=True)
    return out


def _writer(out: Path, rate: Any) -> PillowWriter | FFMpegWriter:
    if out.suffix == ".gif":
        return PillowWriter(fps=rate)
    return FFMpegWriter(fps=rate, extra_args=["-crf", "18"])


def _settings(out: Path) -> Any:
    """Return the settings of matplotlib for a film."""
    if out.suffix == ".gif":
        return {}
    import imageio_ffmpeg

    return {"animation.ffmpeg_path": imageio_ffmpeg.get_ffmpeg_exe(), "animation.codec": "h264"}


def _check(source: RunFile, out: Path, rate: float) -> None:
    if out.suffix not in (".mp4", ".gif"):
        raise ConfigError(f"cannot draw {out}: give a name ending in .mp4 or .gif")
    if out.suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise ConfigError(
            f"{out} needs the package imageio-ffmpeg: pip install imageio-ffmpeg, or make a .gif"
        )
    if not 0.1 <= rate <= 120.0:
        raise ConfigError(f"rate={rate:g}: 0.1 to 120 frames a second can be shown")
    if source.times.size < 2:
        raise ConfigError(f"{source.path} holds less than two frames: run with a smaller --every")
