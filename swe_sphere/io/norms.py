"""Normalised area-weighted error norms of Williamson et al. (1992), eqs. 82-87.

With I the area mean and |.| the length of the value (a number or a two-component vector),

    l1 = I(|x - y|) / I(|y|),  l2 = sqrt(I(|x - y|^2) / I(|y|^2)),  linf = max|x - y| / max|y|.

Where the exact field y vanishes everywhere there is nothing to divide by, and the norms are the
absolute ones, in the units of the field.  doi:10.1016/S0021-9991(05)80016-6
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array


def area_mean(area: Array, values: Array) -> float:
    """Mean of values (N,) weighted with area (N,) [m2, or any common unit]."""
    return float(np.sum(area * values) / np.sum(area))


def norms(area: Array, numeric: ArrayLike, exact: ArrayLike) -> dict[str, float]:
    """The mean, the root-mean-square and the largest error, normalised: "l1", "l2" and "linf".

    numeric, exact: scalars (N,) or vectors (2, N).
    """
    ours, theirs = (np.asarray(x, dtype=float).reshape(-1, area.size) for x in (numeric, exact))
    error, size = np.linalg.norm(ours - theirs, axis=0), np.linalg.norm(theirs, axis=0)
    square = area_mean(area, error**2) / (area_mean(area, size**2) or 1.0)
    return {
        "l1": area_mean(area, error) / (area_mean(area, size) or 1.0),
        "l2": float(np.sqrt(square)),
        "linf": float(np.max(error) / (np.max(size) or 1.0)),
    }


Norms = dict[str, dict[str, float]]
"""l1, l2 and linf by field."""


def field_errors(
    area: Array,
    numeric: Mapping[str, Array],
    exact: Mapping[str, Array],
    bottom: Array | float = 0.0,
) -> Norms:
    """Errors of depth "h" and, where both have them, of wind "v" and vorticity at the same points.

    numeric, exact: h [m] and perhaps u, v [m s-1] and vorticity [s-1], each (N,).  With bottom (N,)
    [m] the heights compared are those of the free surface, h + bottom.
    """
    pairs = {"h": (numeric["h"] + bottom, exact["h"] + bottom)}
    both = numeric.keys() & exact.keys()
    if {"u", "v"} <= both:
        pairs["v"] = (_wind(numeric), _wind(exact))
    if "vorticity" in both:
        pairs["vorticity"] = (numeric["vorticity"], exact["vorticity"])
    return {name: norms(area, *pair) for name, pair in pairs.items()}


def by_name(errors: Norms) -> dict[str, float]:
    """As l1_h, l2_h, linf_h, l1_v and so on."""
    return {f"{norm}_{name}": x for name, of in errors.items() for norm, x in of.items()}


def _wind(fields: Mapping[str, Array]) -> Array:
    return np.stack([fields["u"], fields["v"]])
