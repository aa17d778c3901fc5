"""The state between two steps, and the numbers that tell how a run is doing."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import (
    courant_numbers,
    drifts,
    integrals,
    tracer_errors,
    tracer_masses,
    tracer_numbers,
)
from swe_sphere.io.norms import Norms, area_mean, by_name, field_errors, norms
from swe_sphere.planet import DAY

if TYPE_CHECKING:
    import warp as wp

    from swe_sphere.equations.model import Model


Fields = dict[str, Array]


class Snapshot:
    """A state with its fields, each fetched from the device when first asked for."""

    def __init__(self, model: Model, state: wp.array, time: float, steps: int = 0) -> None:
        self._model, self._state = model, state
        self.time = time
        """[s] since the start."""
        self.steps = steps
        """Steps since the start."""

    @cached_property
    def fields(self) -> Fields:
        """u, v [m s-1] and h [m], of tracers hq_NAME [m] and q_NAME, each (N,)."""
        return self._model.fields(self._state, self.time)

    @cached_property
    def all_fields(self) -> Fields:
        """The fields with vorticity and divergence [s-1], each (N,)."""
        from swe_sphere.operators.diagnose import divergence, vorticity  # imports Warp

        mesh, u, v = self._model.mesh, self.fields["u"], self.fields["v"]
        return self.fields | {
            "vorticity": vorticity(mesh, u, v), "divergence": divergence(mesh, u, v),
        }  # fmt: skip

    @cached_property
    def with_constants(self) -> Fields:
        """All fields with bottom b [m] and Coriolis parameter f [s-1], each (N,)."""
        return self.all_fields | {"b": self._model.bottom, "f": self._model.coriolis}


def state_integrals(model: Model, fields: Fields) -> dict[str, float]:
    """Global integrals and extremes of a state; fields: u, v, h, vorticity, divergence (N,)."""
    names = ("u", "v", "h", "vorticity", "divergence")
    values = {name: fields[name] for name in names}
    return integrals(model.mesh, model.scene.planet, b=model.bottom, f=model.coriolis, **values)


def exact_fields(model: Model, time: float) -> Fields:
    """u, v, h (N,) of a scene that has an exact solution, at a time [s]."""
    assert model.scene.exact is not None
    exact = model.scene.exact(model.mesh.lon, model.mesh.lat, time)
    return dict(zip("uvh", exact, strict=True))


def flow_errors(model: Model, ours: Fields, theirs: Fields) -> Norms:
    """Errors at the nodes of height, wind and, where both have it, vorticity; fields (N,).

    A prescribed wind has no error, nor has its vorticity; heights are those of the scene's
    `error_field`.
    """
    bottom = model.bottom if model.scene.error_field == "surface" else 0.0
    right = theirs if model.scene.wind is None else {"h": theirs["h"]}
    return field_errors(model.mesh.area, ours, right, bottom)


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


def exact_errors(model: Model, fields: Fields, time: float) -> dict[str, float]:
    """Errors at time [s] against what is known exactly of the scene; NaN where it is not known."""
    scene, mesh = model.scene, model.mesh
    found: dict[str, float] = {}
    if scene.exact is not None:
        found = by_name(flow_errors(model, fields, exact_fields(model, time)))
    if scene.exact_tracers is not None:
        found |= tracer_errors(mesh, fields, scene.exact_tracers(mesh.lon, mesh.lat, time))
    return found


OF_FREE_WINDS = (
    "energy", "potential_enstrophy", "energy_drift", "enstrophy_drift", "courant_gravity",
)  # fmt: skip
"""Numbers that say nothing where the wind is prescribed: what changes it is the scene, no wave."""


class Evaluator:
    """All numbers of a state; drifts are relative to the scene's own start.

    start: all fields at the very start, each (N,).  dt: tells the length of the present step [s].
    """

    def __init__(self, model: Model, start: Fields, dt: Callable[[], float]) -> None:
        self._model, self._dt = model, dt
        self.start = state_integrals(model, start)
        """Integrals at the start."""
        self._masses = tracer_masses(model.mesh, start, model.scene.tracers or ())

    def __call__(self, snapshot: Snapshot) -> dict[str, float]:
        """Integrals, drifts, Courant numbers, numbers of tracers and exact errors of a state."""
        mesh, fields = self._model.mesh, snapshot.all_fields
        now = state_integrals(self._model, fields)
        left_out = OF_FREE_WINDS if self._model.scene.wind is not None else ()
        numbers = {
            **now,
            **drifts(self.start, now),
            **tracer_numbers(mesh, fields, self._masses),
            **courant_numbers(mesh, self._dt(), now),
            **exact_errors(self._model, fields, snapshot.time),
        }
        return {name: value for name, value in numbers.items() if name not in left_out}


class ReferenceErrors:
    """Errors of the last state against a reference on a latitude-longitude grid.

    Raises ConfigError if the reference cannot be read.
    """

    def __init__(self, path: Path, field: str) -> None:
        from swe_sphere.io.reference_solution import Reference  # needs scipy's splines

        self._reference, self._height = Reference(path), field

    def check(self, days: float) -> None:
        """ConfigError if the reference is known to be of another time than the end [days]."""
        time = self._reference.time
        if time is not None and abs(time - days * DAY) > 1.0:
            raise ConfigError(
                f"{self._reference.path} is of day {time / DAY:g}, the run ends at day {days:g}:"
                f" take days={time / DAY:g} or another reference"
            )

    def __call__(self, model: Model, snapshot: Snapshot) -> dict[str, float]:
        """l1_h, l2_h, linf_h and, where the reference has a wind, l1_v, l2_v, linf_v."""
        from swe_sphere.io.reference_solution import OnGrid

        found = OnGrid(self._reference, model.mesh).errors(snapshot.with_constants, self._height)
        return by_name({name: of for name, of in found.items() if name != "vorticity"})
