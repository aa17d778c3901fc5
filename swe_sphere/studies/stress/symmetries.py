"""Diagnostics of a trial besides integrals and errors: symmetries of the flow."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swe_sphere.io.norms import area_mean
from swe_sphere.simulation.snapshot import Snapshot

if TYPE_CHECKING:
    from swe_sphere.mesh import Mesh

__all__ = ["SYMMETRIES", "Symmetry"]

Array = NDArray[np.float64]
Symmetry = Callable[[Snapshot], dict[str, float]]

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A quarter turn about the axis of the planet."""
MIRROR = np.diag([1.0, 1.0, -1.0])
"""South for north."""
CLOSE = 1e-9


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
    from scipy.spatial import KDTree

    apart, found = KDTree(mesh.xyz).query(mesh.xyz @ map_.T)
    if apart.max() > CLOSE:
        raise ValueError("the mesh does not have this symmetry: leave out stretch, centre and spin")
    return np.asarray(found)
