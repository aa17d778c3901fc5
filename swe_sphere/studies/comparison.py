"""What runs of studies are compared with and how, beyond what every run tells of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swe_sphere.arrays import Array
from swe_sphere.io.norms import Norms, area_mean, norms
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.simulation.snapshot import Fields

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model


def at_nodes(fine: Mesh, fields: Fields, mesh: Mesh) -> Fields:
    """u, v, h and, where it is there, vorticity of a finer mesh at the nodes of another."""
    interpolator = Interpolator(fine, mesh.lon, mesh.lat)
    u, v = evaluate(interpolator, fields, "wind")
    scalars = fields.keys() & {"h", "vorticity"}
    return {"u": u, "v": v} | {name: interpolator(fields[name]) for name in scalars}


def slow_errors(model: Model, ours: Fields, theirs: Fields) -> Norms:
    """Errors at the nodes of potential vorticity, in the place of those of vorticity.

    Gravity waves carry none, so that waves which a long step has damped or dephased do not count.
    """
    if model.scene.wind is not None:
        return {}
    area, coriolis = model.mesh.area, model.coriolis
    mean = area_mean(area, theirs["h"])
    slow = (_stretched(state, coriolis, mean) for state in (ours, theirs))
    return {"vorticity": norms(area, *slow)}


def _stretched(state: Fields, coriolis: Array, mean: float) -> Array:
    """H q - f (N,) [s-1]: the vorticity of columns that are brought to the mean depth H [m]."""
    return (state["vorticity"] + coriolis) * mean / state["h"] - coriolis
