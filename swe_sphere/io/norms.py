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
from swe_sphere.mesh import Mesh


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


def errors(
    mesh: Mesh,
    numeric: Mapping[str, ArrayLike],
    exact: Mapping[str, ArrayLike],
    bottom: Array | None = None,
) -> dict[str, float]:
    """Errors of depth and wind on the nodes of a mesh.

    numeric, exact: "h" [m] and, for errors of the wind, "u" and "v" [m s-1], each (N,).
    With bottom (N,) [m] the heights compared are those of the free surface, h + bottom.
    Returns l1_h, l2_h, linf_h and, where both have a wind, l1_v, l2_v, linf_v.
    """
    offset = 0.0 if bottom is None else bottom
    pairs = {"h": (np.asarray(numeric["h"]) + offset, np.asarray(exact["h"]) + offset)}
    if all(name in side for name in "uv" for side in (numeric, exact)):
        pairs["v"] = (_wind(numeric), _wind(exact))
    return {
        f"{norm}_{name}": value
        for name, (ours, theirs) in pairs.items()
        for norm, value in norms(mesh.area, ours, theirs).items()
    }


def _wind(fields: Mapping[str, ArrayLike]) -> Array:
    return np.stack([np.asarray(fields["u"]), np.asarray(fields["v"])])
