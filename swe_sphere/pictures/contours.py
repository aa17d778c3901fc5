"""Ends of colour scales, and levels of contours that draw no noise."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator

from swe_sphere.arrays import Array
from swe_sphere.io.scalar_fields import Field

LEVELS, DIVERGING_LEVELS = 14, 8
"""At most about so many contour lines."""

FLAT = 1e-9
"""A field that varies by less than this part of its values is round-off."""
NEAR, PLATEAU = 0.1, 0.4
"""A level is not drawn where this share of the map lies nearer to it than so many intervals: its
contours would follow the ripples of a plateau.  (Of a field spread evenly it is a fiftieth.)"""


def limits(values: Array, kind: Field) -> tuple[float, float]:
    """Ends of the colour scale; symmetric about zero for a diverging field, never equal."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if kind.diverging:
        low, high = -max(-low, high), max(-low, high)
    spread = max(high - low, FLAT * max(abs(low), abs(high)), np.finfo(float).tiny * 1e10)
    middle = 0.5 * (low + high)
    return middle - 0.5 * spread, middle + 0.5 * spread


def contours(
    values: Array, kind: Field, ends: tuple[float, float], count: int | None = None
) -> tuple[Array, float]:
    """Levels to draw, and the interval between them; about `count` of them where that is given."""
    most = count or (DIVERGING_LEVELS if kind.diverging else LEVELS)
    levels = np.asarray(MaxNLocator(most).tick_values(*ends), dtype=np.float64)
    interval = float(levels[1] - levels[0])
    found = values[np.isfinite(values)]
    if np.ptp(found) <= 2.0 * FLAT * np.abs(found).max():
        return levels[:0], interval
    return drawable(levels, found, interval, kind.diverging), interval


def drawable(levels: Array, values: Array, interval: float, diverging: bool) -> Array:
    """The levels that cut through the field, but for plateaus and the zero of a diverging one."""
    inside = levels[(levels > values.min()) & (levels < values.max())]
    keep = [
        np.mean(np.abs(values - level) < NEAR * interval) < PLATEAU
        and not (diverging and abs(level) < 1e-6 * interval)
        for level in inside
    ]
    kept: Array = inside[np.array(keep, dtype=bool)]
    return kept
