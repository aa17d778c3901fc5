"""Picture of error against CPU time, one panel per scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter

from swe_sphere.pictures.panels import COLOURS

MARKERS = "osD^v"


def draw(tables: Mapping[str, Sequence[Sequence[str]]], path: Path) -> None:
    """Draw tables of rows as on the page: model, ..., numbers (4), l2 (6), CPU time [s] (7)."""
    figure, axes = plt.subplots(
        1, len(tables), figsize=(4.2 * len(tables), 4.0), layout="constrained", squeeze=False
    )
    models = list(dict.fromkeys(line[0] for rows in tables.values() for line in rows))
    for axis, (scene, rows) in zip(axes[0], tables.items(), strict=True):
        for model, colour, marker in zip(models, COLOURS, MARKERS, strict=False):
            for numbers in ("float64", "float32"):
                _points(axis, rows, model, numbers, (colour, marker))
        axis.set(title=scene, xscale="log", yscale="log", xlabel="CPU time [s]")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("l2 of the free surface")
    handles = {line.get_label(): line for axis in axes[0] for line in axis.lines}
    shown = [line for label, line in handles.items() if not label.startswith("_")]
    figure.legend(handles=shown, loc="outside lower center", ncols=2 * len(tables))
    plt.rcParams["svg.hashsalt"] = "peers"
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _points(
    axis: plt.Axes, rows: Sequence[Sequence[str]], model: str, numbers: str, look: tuple[str, str]
) -> None:
    """Draw points, filled for double precision, open for single; a line joins the best."""
    mine = [line for line in rows if (line[0], line[4]) == (model, numbers) and line[7]]
    found = [(float(line[7]), float(line[6])) for line in mine]
    if not found:
        return
    (colour, marker), double = look, numbers == "float64"
    axis.plot(*zip(*_front(found), strict=True), "-" if double else ":", color=colour)
    label, face = (model, colour) if double else (f"{model}, {numbers}", "none")
    style = {"color": colour, "markerfacecolor": face, "label": label}
    axis.plot(*zip(*found, strict=True), marker, **style)


def _front(found: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points for which no other point has both less time and a smaller error."""
    kept: list[tuple[float, float]] = []
    for time, error in sorted(found):
        if not kept or error < kept[-1][1]:
            kept.append((time, error))
    return kept
