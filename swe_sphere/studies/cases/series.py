"""A run as a series of samples, and what is made of it: extremes, growth, loss of symmetries."""

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

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A quarter turn about the axis of the planet."""
MIRROR = np.diag([1.0, 1.0, -1.0])
"""South for north."""
CLOSE = 1e-9

SAMPLES = 120
"""About how many samples of a run are taken."""
BROKEN = 1e-2
"""Part of v² off the symmetry that counts as its loss."""
DRIFTS = ("mass_drift", "energy_drift", "enstrophy_drift", "total_vorticity")
ERRORS = ("l2_h", "l2_v", "linf_h")
GROWING = ("l2_h", "l2_v")


class Series(Observer):
    """An observer that samples diagnostics and symmetries about `SAMPLES` times."""

    def __init__(self, plan: RunPlan, symmetries: Sequence[Symmetry] = ()) -> None:
        self._watched = symmetries
        self._every = max(1, plan.steps // SAMPLES)
        self._days: list[float] = []
        self._rows: list[dict[str, float]] = []

    def due(self, step: int) -> bool:
        """Every so many steps."""
        return step % self._every == 0

    def observe(self, snapshot: Snapshot) -> None:
        """Take a sample."""
        row = dict(snapshot.diagnostics)
        for symmetry in self._watched:
            row |= symmetry(snapshot)
        self._days.append(snapshot.time / DAY)
        self._rows.append(row)

    def numbers(self) -> dict[str, float]:
        """What the series comes to; nothing of a run that had no sample.

        Drifts are the largest of either sign over the run; max_wind [m s-1] is the largest,
        min_depth [m] the least; wind_growth is max_wind over that of the start, froude the largest
        max_wind over the speed of gravity waves, energy_gain the largest rise of energy.  Errors
        are those at the end; growth_v and growth_h say how errors went with time, see `_growth`.
        symmetry_day: see `_lost`.
        """
        if not self._rows:
            return {}
        found = {name: float(np.abs(self._of(name)).max()) for name in DRIFTS}
        winds, gains = self._of("max_wind"), self._of("energy_drift")
        found |= {
            "max_wind": float(winds.max()),
            "wind_growth": float(winds.max() / winds[0]) if winds[0] > 0.0 else math.nan,
            "froude": float((winds / self._of("max_wave")).max()),
            "min_depth": float(self._of("min_depth").min()),
            "energy_gain": float(gains.max()),
            "last_day": self._days[-1],
        }
        return found | self._error_numbers() | self._symmetries() | self._tracers()

    def _of(self, name: str) -> np.ndarray:
        return np.array([row.get(name, math.nan) for row in self._rows])

    def _error_numbers(self) -> dict[str, float]:
        last = self._rows[-1]
        if "l2_h" not in last:
            return {}
        ends = {name: last[name] for name in ERRORS if name in last}
        growth = {f"growth_{name[-1]}": self._growth(name) for name in GROWING if name in last}
        return ends | growth

    def _growth(self, name: str) -> float:
        """Largest error of the last third over three times that of the first third.

        It is 1 for an error that grows linearly, 3 for a quadratic one, 1/3 for a constant one.
        """
        errors, third = self._of(name), len(self._rows) // 3
        early, late = errors[: third + 1].max(), errors[-third - 1 :].max()
        return float(late / (3.0 * early)) if early > 0.0 else math.nan

    def _symmetries(self) -> dict[str, float]:
        last = self._rows[-1]
        found = {name: last[name] for name in ("off_wave", "off_mirror") if name in last}
        return found | ({"symmetry_day": self._lost()} if "off_wave" in last else {})

    def _lost(self) -> float:
        """The first day on which `BROKEN` of v² is off the symmetry; infinite if there is none."""
        broken = self._of("off_wave") > BROKEN
        return self._days[int(np.argmax(broken))] if broken.any() else math.inf

    def _tracers(self) -> dict[str, float]:
        """Least and largest mixing ratios over the run, and the largest drift of a mass."""
        last = self._rows[-1]
        low = {n: float(self._of(n).min()) for n in last if n.startswith("min_q_")}
        high = {n: float(self._of(n).max()) for n in last if n.startswith("max_q_")}
        masses = [np.abs(self._of(n)).max() for n in last if n.startswith("mass_drift_q_")]
        return low | high | ({"tracer_mass_drift": float(max(masses))} if masses else {})


def fourfold(mesh: Mesh) -> Symmetry:
    """How much of the northward wind has a zonal wavenumber that is no multiple of four.

    off_wave: part of the mean of v² that is lost when v is averaged over quarter turns, which take
    nodes to nodes on an unturned, unstretched mesh.
    """
    once = _images(mesh, QUARTER)
    turns = [np.arange(mesh.size), once, once[once], once[once[once]]]

    def off_wave(snapshot: Snapshot) -> dict[str, float]:
        v = snapshot.fields["v"]
        rest = v - sum(v[turn] for turn in turns) / 4.0
        return {"off_wave": area_mean(mesh.area, rest**2) / (area_mean(mesh.area, v**2) or 1.0)}

    return off_wave


def mirrored(mesh: Mesh) -> Symmetry:
    """How far the depth is from being the same on both sides of the equator.

    off_mirror: rms of h less its mirror image, over the rms of its deviation from the mean.
    """
    other = _images(mesh, MIRROR)

    def off_mirror(snapshot: Snapshot) -> dict[str, float]:
        h = snapshot.fields["h"]
        spread = area_mean(mesh.area, (h - area_mean(mesh.area, h)) ** 2) or 1.0
        return {"off_mirror": np.sqrt(area_mean(mesh.area, (h - h[other]) ** 2) / spread)}

    return off_mirror


SYMMETRIES: dict[str, Callable[[Mesh], Symmetry]] = {"fourfold": fourfold, "mirror": mirrored}
"""All of them by name; each is made for a mesh."""


def _images(mesh: Mesh, map_: Array) -> NDArray[np.intp]:
    """For each node the one that it is mapped to; ValueError where there is none."""
    apart, found = KDTree(mesh.xyz).query(mesh.xyz @ map_.T)
    if apart.max() > CLOSE:
        raise ValueError("the mesh does not have this symmetry: leave out stretch, centre and spin")
    return np.asarray(found)
