"""States between two steps, and the numbers that describe them: integrals, errors, diagnostics.

`@diagnostic` registers a user-defined function of the simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.user_file import call_custom, file_of, load_file
from swe_sphere.io import integrals
from swe_sphere.io.integrals import Fields, Norms, by_name, norms
from swe_sphere.io.layout import MESH_ATTRIBUTES, TOPOLOGY, VARIABLES
from swe_sphere.io.scalar_fields import at_depth
from swe_sphere.planet import DAY
from swe_sphere.settings.registry import first_line
from swe_sphere.settings.values import read_toml

if TYPE_CHECKING:
    import warp as wp

    from swe_sphere.equations.model import Model
    from swe_sphere.io.reference_solution import Reference

Numbers = dict[str, float]
F = TypeVar("F", bound=Callable[[Any], Any])
T = TypeVar("T")


class Snapshot:
    """A state between two steps, whose fields and numbers are computed when first requested.

    state: flat array of the model, on its device.  time [s], steps: since the start.  sim: the
    simulation, needed for numbers and diagnostics.  live: True if its steps overwrite the state.
    """

    def __init__(
        self, model: Model, state: wp.array, time: float, steps: int = 0, sim: Any = None,
        live: bool = False,
    ) -> None:  # fmt: skip
        self.model, self.state, self.time, self.steps, self.sim = model, state, time, steps, sim
        self._is_live = live
        self._user_values: dict[Diagnostic, Array] = {}
        self._is_evaluating = False
        self._seen: Array | None = None  # the state of which the fields are

    @cached_property
    def fields(self) -> Fields:
        """u, v [m s-1] and h [m], and of each tracer hq_NAME [m] and q_NAME, each (N,)."""
        if self._is_live and self.sim.steps not in (0, self.steps):  # 0 after a reset
            when = f"is of step {self.steps}, the simulation is at step {self.sim.steps}"
            raise RunFailed(f"the snapshot {when}: read its fields before the next step")
        self._seen = self.state.numpy().copy()
        return _read_only(self.model.fields(self.state, self.time))

    def is_current(self) -> bool:
        """Return whether the state has not changed since its fields were computed."""
        return self._seen is None or np.array_equal(self._seen, self.state.numpy(), True)

    @cached_property
    def all_fields(self) -> Fields:
        """The fields with vorticity, divergence, bottom b [m], Coriolis parameter f and area."""
        from swe_sphere.operators.diagnose import divergence, vorticity  # imports Warp

        mesh, u, v = self.model.mesh, self.fields["u"], self.fields["v"]
        return self.fields | _read_only({
            "vorticity": vorticity(mesh, u, v), "divergence": divergence(mesh, u, v),
            "b": self.model.bottom, "f": self.model.coriolis, "area": mesh.area,
        })  # fmt: skip

    @cached_property
    def _numbers(self) -> Numbers:
        """Integrals, drifts, Courant numbers, numbers of tracers and exact errors."""
        model, fields, (start, masses) = self.model, self.all_fields, self.sim.initial_numbers
        scene, mesh, dt = model.scene, model.mesh, self.sim.present_dt
        now = state_integrals(model, fields)
        found = now | integrals.drifts(start, now) | integrals.tracer_numbers(mesh, fields, masses)
        if dt is not None:
            found |= integrals.courant_numbers(mesh, dt, now)
        if scene.exact is not None:
            found |= by_name(flow_errors(model, fields, exact_fields(model, self.time)))
        if scene.exact_tracers is not None:
            exact = scene.exact_tracers(mesh.lon, mesh.lat, self.time)
            errors = {f"q_{x}": norms(mesh.area, fields[f"q_{x}"], exact[x]) for x in exact}
            found |= by_name(errors)
        left_out = () if scene.wind is None else NAMES["of_free_winds"]
        return {name: value for name, value in found.items() if name not in left_out}

    @property
    def diagnostics(self) -> Numbers:
        """Return all numbers: integrals, drifts, Courant numbers, errors, user-defined diagnostics.

        Raises RunFailed if a user-defined diagnostic fails.
        """
        return self._numbers | {k: float(x) for k, x in self.user_values.items() if x.ndim == 0}

    @property
    def user_values(self) -> Fields:
        """Values of user-defined diagnostics by name (`Diagnostic.value`); RunFailed if one fails.

        It is empty while a diagnostic is evaluated, so that one may read the whole state.
        """
        if self._is_evaluating:
            return {}
        self._is_evaluating = True
        try:
            for one in DIAGNOSTICS.values():
                if one not in self._user_values:
                    self._user_values[one] = one.value(self.sim)
        finally:
            self._is_evaluating = False
        return {name: self._user_values[one] for name, one in DIAGNOSTICS.items()}

    @property
    def user_fields(self) -> Fields:
        """Fields (N,) and profiles of user-defined diagnostics; raises RunFailed if one fails."""
        return {name: value for name, value in self.user_values.items() if value.ndim}

    @property
    def about(self) -> dict[str, dict[str, str]]:
        """Attributes in files of the variables of user-defined diagnostics, by name."""
        given = {name: DIAGNOSTICS[name] for name in self.user_values}
        return {k: {"long_name": one.long_name, "units": one.units} for k, one in given.items()}


def _read_only(fields: Fields) -> Fields:
    """Return views of the fields that no diagnostic can change."""
    return {name: np.broadcast_to(values, values.shape) for name, values in fields.items()}


def state_integrals(model: Model, fields: Fields) -> Numbers:
    """Return global integrals and extremes of a state; fields: as `Snapshot.all_fields`."""
    values = {x: fields[x] for x in ("u", "v", "h", "b", "f", "vorticity", "divergence")}
    return integrals.flow_integrals(model.mesh, model.scene.planet, **values)


def exact_fields(model: Model, time: float) -> Fields:
    """Return u, v, h (N,) of the exact solution of the scene, which has one, at a time [s]."""
    assert model.scene.exact is not None
    return dict(zip("uvh", model.scene.exact(model.mesh.lon, model.mesh.lat, time), strict=True))


def flow_errors(model: Model, ours: Fields, theirs: Fields) -> Norms:
    """Return errors at the nodes of height, wind and, where both have it, vorticity.

    ours, theirs: fields (N,).  A prescribed wind has no error, nor has its vorticity; the height is
    the scene's `error_field`, depth or surface.
    """
    bottom = model.bottom if model.scene.error_field == "surface" else 0.0
    right = theirs if model.scene.wind is None else {"h": theirs["h"]}
    return integrals.field_errors(model.mesh.area, ours, right, bottom)


def slow_errors(model: Model, ours: Fields, theirs: Fields) -> Norms:
    """Return errors at the nodes of potential vorticity, under the name "vorticity".

    Gravity waves carry no potential vorticity: waves that a long step damps or shifts do not count.
    """
    if model.scene.wind is not None:
        return {}
    area, f = model.mesh.area, model.coriolis
    mean = integrals.area_mean(area, theirs["h"])
    slow = (at_depth(state | {"f": f}, mean) for state in (ours, theirs))
    return {"vorticity": norms(area, *slow)}


def reference_errors(reference: Reference, snapshot: Snapshot) -> Numbers:
    """Return l1_h, l2_h, linf_h and, where the reference has a wind, l1_v, l2_v, linf_v."""
    from swe_sphere.io.reference_solution import OnGrid  # imports Warp

    model = snapshot.model
    found = OnGrid(reference, model.mesh).errors(snapshot.all_fields, model.scene.error_field)
    return by_name({name: errors for name, errors in found.items() if name != "vorticity"})


def call_in_run(what: str, function: Callable[..., T], *arguments: Any) -> T:
    """Return the result of a user-defined function; RunFailed states what failed, and where."""
    try:
        return call_custom(what, function, *arguments)
    except ConfigError as error:
        raise RunFailed(str(error)) from error


NAMES = read_toml(Path(__file__).with_name("names.toml"))
"""Names of values in files and summaries, which no diagnostic may have."""
TAKEN = frozenset({
    *NAMES["keys"], *NAMES["costs"], *NAMES["others"], *MESH_ATTRIBUTES, *TOPOLOGY,
    *(name for kind, names in VARIABLES.items() if kind != "derived" for name in names),
})  # fmt: skip


@dataclass(frozen=True, eq=False)
class Diagnostic:
    """A user-defined function that returns a number, a field or a profile of a simulation."""

    name: str
    function: Callable[[Any], Any]
    units: str
    long_name: str

    def value(self, sim: Any) -> Any:
        """Return the present number (), field (N,), or profile, a data array, of a simulation.

        Raises RunFailed if it is none of them, or its kind, size or coordinate has changed.
        """
        what, size = f"the diagnostic {self.name}", sim.mesh.size
        value = call_in_run(what, lambda: self._as_numbers(self.function(sim)))
        is_profile = hasattr(value, "dims")
        if not is_profile and value.shape not in ((), (size,)):
            raise RunFailed(
                f"{what} returned an array of shape {value.shape}: return one number, a field of"
                f" {size} values, one a node, or a profile, an xarray.DataArray with one dimension"
            )
        axis = [(n, *x.values.tolist()) for n, x in value.coords.items()] if is_profile else []
        if sim.user_axes.setdefault(self, (value.ndim, axis)) != (value.ndim, axis):
            raise RunFailed(
                f"{what} has changed its kind, size or coordinate since its first value: return the"
                " same kind"
            )
        if self not in sim.not_finite and not np.isfinite(value).all():
            sim.not_finite.add(self)
            sim.warn(f"{what} is NaN or infinite at day {sim.time / DAY:.4g}")
        return value

    def _as_numbers(self, found: Any) -> Any:
        if found is None:
            raise TypeError("it returned nothing")  # numpy would convert None to NaN
        if np.iscomplexobj(found):
            raise TypeError("it returned complex numbers")
        dims = getattr(found, "dims", ())
        if not isinstance(dims, tuple) or len(dims) != 1 or dims == ("node",):
            return np.asarray(found, dtype=np.float64)
        axis, name = found[dims[0]], f"{self.name}_{dims[0]}"  # a name of no other variable
        if not found.size or axis.dtype.kind not in "fiu" or not np.isfinite(axis.values).all():
            raise ValueError("a profile needs values, and finite numbers as its coordinate")
        if not name.isidentifier() or _is_taken(name) or name in DIAGNOSTICS:
            raise ValueError(f"the dimension {dims[0]!r} needs another name")
        kept = {k: x for k, x in axis.attrs.items() if isinstance(x, str) and k != "bounds"}
        about = {k: x for k, x in found.attrs.items() if isinstance(x, str)}
        coordinate = {name: (name, axis.values.astype(np.float64), kept)}
        return type(found)(np.asarray(found, dtype=np.float64), coordinate, [name], attrs=about)


DIAGNOSTICS: dict[str, Diagnostic] = {}
"""All registered diagnostics by name."""


@overload
def diagnostic(function: F) -> F: ...
@overload
def diagnostic(
    *, name: str | None = None, units: str = "1", long_name: str | None = None
) -> Callable[[F], F]: ...
def diagnostic(
    function: Any = None, *, name: str | None = None, units: str = "1", long_name: str | None = None
) -> Any:
    """Register a function `f(sim)` that returns a number, a field (N,) on the nodes, or a profile.

    A number appears in the series of files, in summaries and in sweeps; a field in every frame, and
    so does a profile, an `xarray.DataArray` with one dimension, in files NAME(NAME_DIMENSION).
    A function replaces the earlier one of its name, unless they are in two different files. Those
    in the file of a scene are computed in all later runs of the process.

    Args:
        name: by default that of the function.
        units: as CF spells them.
        long_name: by default the first line of the function's docstring.

    Examples:
        >>> from swe_sphere import Simulation, diagnostic
        >>> from swe_sphere.simulation.diagnostics import DIAGNOSTICS
        >>> @diagnostic(units="m s-1")
        ... def jet(sim):
        ...     "largest eastward wind"
        ...     return sim.state.u.max()
        >>> sim = Simulation("williamson2", ne=2, np=4)
        >>> round(sim.run(days=0.1)["jet"])
        39
        >>> del DIAGNOSTICS["jet"]

    Raises ConfigError if `function` cannot be called, if the name is no identifier or that of
    another value, or if another file has a diagnostic of this name.
    """
    if function is None:
        return partial(diagnostic, name=name, units=units, long_name=long_name)
    if not callable(function):
        raise ConfigError(f"a diagnostic must be a function of the simulation, got {function!r}")
    called = name or str(getattr(function, "__name__", ""))
    if not called.isidentifier():
        raise ConfigError(f"the diagnostic {called!r} needs a name= of letters, digits and _")
    if called in NAMES["options"] or _is_taken(called):
        raise ConfigError(f"the diagnostic {called!r} needs another name: files use this one")
    before = DIAGNOSTICS.get(called)
    theirs, ours = file_of(before and before.function), file_of(function)
    if theirs and ours and theirs != ours:
        raise ConfigError(f"another file has a diagnostic {called!r}, {theirs}: rename one of them")
    words = long_name or first_line(function) or called
    DIAGNOSTICS[called] = Diagnostic(called, function, units, words)
    return function


def _is_taken(name: str) -> bool:
    return name in TAKEN or name.startswith(tuple(NAMES["beginnings"]))


def load_diagnostics(path: Path) -> None:
    """Register the diagnostics that a Python file defines.

    Raises ConfigError if the file has none, or one with the name of one of another file.
    """
    before = dict(DIAGNOSTICS)
    load_file(path, "diagnostic")
    if before == DIAGNOSTICS:
        raise ConfigError(f"{path} defines no diagnostic: put @diagnostic above a function in it")


def check_options(stepper: str, options: Iterable[str]) -> None:
    """Raise ConfigError if an option of a stepper has the name of another value of files."""
    for name in options:
        if name in DIAGNOSTICS:
            raise ConfigError(
                f"the diagnostic {name!r} needs another name: an option of {stepper} has this one"
            )
        if _is_taken(name):
            raise ConfigError(
                f"stepper {stepper}: its option {name!r} needs another name: files use this one"
            )
