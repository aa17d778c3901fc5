"""Films of a run: MP4 and GIF."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import clear_errors, part_of
from swe_sphere.io.runfile import RunFile
from swe_sphere.io.scalar_fields import check_field
from swe_sphere.pictures.drawing import Drawing, limits
from swe_sphere.pictures.look import Look
from swe_sphere.pictures.maps import grid_of, new_map
from swe_sphere.pictures.plot import default_field, new_figure, size

ROWS = 181
"""Latitudes of the grid a field is evaluated on: every degree."""
DOTS_PER_INCH = 100

Pixels = NDArray[np.uint8]


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
    grid = grid_of(new_map(new_figure(), look), ROWS)
    pictures = _pictures(Drawing(source, field, look, grid), source)
    part = part_of(out)
    with clear_errors(f"cannot write {out}"):
        try:
            (_write_gif if out.suffix == ".gif" else _write_mp4)(part, pictures, rate)
            part.replace(out)
        finally:
            part.unlink(missing_ok=True)
    return out


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


def _pictures(drawing: Drawing, source: RunFile) -> Iterator[Pixels]:
    """Frame after frame (height, width, 3), even numbers of pixels."""
    lows, highs = zip(*(limits(drawing.values(t), drawing.kind) for t in source.times), strict=True)
    for time in source.times:
        figure = new_figure()
        axes = new_map(figure, drawing.look)
        figure.set_size_inches(*size(axes))
        figure.set_dpi(DOTS_PER_INCH)
        canvas: Any = FigureCanvasAgg(figure)
        drawing.draw(axes, float(time), (min(lows), max(highs)))
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
        height, width = (n - n % 2 for n in pixels.shape[:2])
        yield np.ascontiguousarray(pixels[:height, :width])


def _write_mp4(path: Path, pictures: Iterator[Pixels], rate: float) -> None:
    import imageio_ffmpeg

    first = next(pictures)
    writer: Any = imageio_ffmpeg.write_frames(
        str(path), (first.shape[1], first.shape[0]), fps=rate, macro_block_size=2, quality=7,
        output_params=["-f", "mp4"],
    )  # fmt: skip
    with closing(writer):
        writer.send(None)
        writer.send(first)
        for picture in pictures:
            writer.send(picture)


def _write_gif(path: Path, pictures: Iterator[Pixels], rate: float) -> None:
    from PIL import Image

    def paletted(pixels: Pixels) -> Any:
        return Image.fromarray(pixels).quantize(256, dither=Image.Dither.FLOYDSTEINBERG)

    first, *rest = map(paletted, pictures)
    first.save(
        path, "GIF", save_all=True, append_images=rest, duration=round(1000.0 / rate), loop=0
    )
