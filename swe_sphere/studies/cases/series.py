"""A run as a series of samples: extremes, growth of errors, loss of symmetries."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from swe_sphere.arrays import Array
from swe_sphere.io.norms import area_mean
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.diagnostics import Snapshot
from swe_sphere.simulation.observers import Observer
from swe_sphere.simulation.planning import RunPlan

Symmetry = Callable[[Snapshot], dict[str, float]]

SAMPLES = 120
"""About how many samples of a run are taken."""
BROKEN = 1e-2
"""Fraction of v² off the symmetry that counts as its loss."""
DRIFTS = ("mass_drift", "energy_drift", "enstrophy_drift", "total_vorticity")
EXTREMES = ("max_wind", "max_wave", "min_depth")
ENDS = ("l2_h", "l2_v", "linf_h", "off_wave", "off_mirror")
"""Numbers of which the last sample counts."""


class Series(Observer):
    """An observer that samples diagnostics and symmetries about `SAMPLES` times."""

    def __init__(self, plan: RunPlan, symmetries: Sequence[Symmetry] = ()) -> None:
        self._symmetries = symmetries
        self._every = max(1, plan.steps // SAMPLES)
        self._rows: list[dict[str, float]] = []

    def due(self, step: int) -> bool:
        """Whether the step is sampled."""
        return step % self._every == 0

    def observe(self, snapshot: Snapshot) -> None:
        """Take a sample."""
        row = {"day": snapshot.time / DAY, **snapshot.diagnostics}
        for symmetry in self._symmetries:
            row |= symmetry(snapshot)
        self._rows.append(row)

    def numbers(self) -> dict[str, float]:
        """Return the numbers of the series; none of a run that had no sample.

        Drifts are the largest of either sign over the run; max_wind [m s-1] is the largest,
        min_depth [m] the least; wind_growth is max_wind over that of the start, froude the largest
        max_wind over the speed of gravity waves, energy_gain the largest rise of energy.  Errors
        are those at the end; growth_v and growth_h say how errors went with time, see `_growth`.
        symmetry_day is the first day on which `BROKEN` of v² is off the symmetry, infinite if there
        is none.  Of tracers: extremes of mixing ratios, and the largest drift of a mass.
        """
        if not self._rows:
            return {}
        names = dict.fromkeys((*DRIFTS, *EXTREMES, *self._rows[-1]))
        of = {name: np.array([row.get(name, math.nan) for row in self._rows]) for name in names}
        days, winds = of["day"], of["max_wind"]
        found = {name: np.abs(of[name]).max() for name in DRIFTS} | {
            "max_wind": winds.max(),
            "wind_growth": winds.max() / winds[0] if winds[0] > 0.0 else math.nan,
            "froude": (winds / of["max_wave"]).max(),
            "min_depth": of["min_depth"].min(),
            "energy_gain": of["energy_drift"].max(),
            "last_day": days[-1],
        }
        found |= {name: of[name][-1] for name in ENDS if name in of}
        found |= {f"growth_{x}": _growth(of[f"l2_{x}"]) for x in "hv" if f"l2_{x}" in of}
        if "off_wave" in of:
            found["symmetry_day"] = min(days[of["off_wave"] > BROKEN], default=math.inf)
        found |= {name: x.min() for name, x in of.items() if name.startswith("min_q_")}
        found |= {name: x.max() for name, x in of.items() if name.startswith("max_q_")}
        masses = [np.abs(x).max() for name, x in of.items() if name.startswith("mass_drift_q_")]
        if masses:
            found["tracer_mass_drift"] = max(masses)
        return {name: float(x) for name, x in found.items()}


def _growth(errors: Array) -> float:
    """Return the largest error of the last third over three times that of the first third.

    It is 1 for an error that grows linearly, 3 for a quadratic one, 1/3 for a constant one.
    """
    third = len(errors) // 3
    early, late = errors[: third + 1].max(), errors[-third - 1 :].max()
    return float(late / (3.0 * early)) if early > 0.0 else math.nan


def fourfold(mesh: Mesh) -> Symmetry:
    """Measure off_wave: the northward wind whose zonal wavenumber is no multiple of four.

    It is the fraction of the mean of v² that is lost when v is averaged over quarter turns, which
    take nodes to nodes on an unturned, unstretched mesh.
    """
    once = _images(mesh, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turns = [np.arange(mesh.size), once, once[once], once[once[once]]]

    def off_wave(snapshot: Snapshot) -> dict[str, float]:
        v = snapshot.fields["v"]
        rest = v - sum(v[turn] for turn in turns) / 4.0
        return {"off_wave": area_mean(mesh.area, rest**2) / (area_mean(mesh.area, v**2) or 1.0)}

    return off_wave


def mirrored(mesh: Mesh) -> Symmetry:
    """Measure off_mirror: how far the depth differs between both sides of the equator.

    It is the rms of h less its mirror image, over the rms of its deviation from the mean.
    """
    other = _images(mesh, np.diag([1.0, 1.0, -1.0]))

    def off_mirror(snapshot: Snapshot) -> dict[str, float]:
        h = snapshot.fields["h"]
        spread = area_mean(mesh.area, (h - area_mean(mesh.area, h)) ** 2) or 1.0
        return {"off_mirror": np.sqrt(area_mean(mesh.area, (h - h[other]) ** 2) / spread)}

    return off_mirror


SYMMETRIES: dict[str, Callable[[Mesh], Symmetry]] = {"fourfold": fourfold, "mirror": mirrored}
"""All of them by name; each is made for a mesh."""


def _images(mesh: Mesh, matrix: object) -> NDArray[np.intp]:
    """Return for each node the one that it is mapped to; ValueError where there is none."""
    apart, found = KDTree(mesh.xyz).query(mesh.xyz @ np.array(matrix).T)
    if apart.max() > 1e-9:
        raise ValueError("the mesh does not have this symmetry: leave out stretch, centre and spin")
    return np.asarray(found)
