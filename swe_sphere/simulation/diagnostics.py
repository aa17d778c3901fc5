"""Diagnostics of the user's own: a function of the simulation, named and registered."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError, RunFailed, SweError
from swe_sphere.files.user_file import guarded, load_file
from swe_sphere.planet import DAY
from swe_sphere.simulation.snapshot import Fields

Function = Callable[[Any], Any]
F = TypeVar("F", bound=Function)

TAKEN = frozenset({
    "scene", "title", "stepper", "scheme", "ne", "np", "dt", "steps", "days", "completed", "reason",
    "status", "stretch", "device", "precision", "launch", "out", "dt_rule", "dt_wanted",
    "days_planned", "stable_dt", "steps_at_once", "accepted_steps", "rejected_steps", "cuts",
    "wall_seconds", "compile_seconds", "setup_seconds", "setups", "rhs_evaluations",
    "tangent_evaluations", "preconditioner_applications", "newton_iterations", "krylov_iterations",
    "krylov_steps", "fast_steps", "tracer_stages", "preconditioner", "tolerance", "diffusion",
    "strength", "share", "substeps", "krylov_block",
    "radius", "centre", "spin", "planet", "scene_parameters", "effects", "tracer_steps", "sources",
    "stepper_options", "configuration", "identity", "code", "start_step", "references",
    "plot_field", "run_id", "summary", "source", "history", "Conventions",
    "surface", "speed", "wind",
    "run", "kind", "field", "norm", "report_day", "repeat", "error", "wall", "cpu", "cpu_seconds",
    "total_seconds", "spread", "role",
    "gravity_limit", "advective_limit", "peak_memory", "jobs", "settings", "key", "record",
    "time", "node", "lat", "lon", "lat_bnds", "lon_bnds", "area", "mesh", "sphere", "face_nodes",
    "face", "corner", "b", "f", "coriolis", "h", "u", "v", "vorticity", "divergence", "mass",
    "energy", "potential_enstrophy", "total_vorticity", "total_divergence", "max_wind",
    "min_depth", "max_wave", "max_signal", "mass_drift", "energy_drift", "enstrophy_drift",
    "courant_advective", "courant_gravity", "diagnostic_time",
    *(f"{norm}_{name}" for norm in ("l1", "l2", "linf") for name in "hv"),
})  # fmt: skip
"""Names that files and summaries of runs have already."""
TAKEN_BEGINNINGS = (
    "counter_", "q_", "hq_", "l1_q_", "l2_q_", "linf_q_", "min_q_", "max_q_", "mass_drift_q_",
)  # fmt: skip
"""What more of such names begin with: counters, and all that is said of tracers."""


@dataclass(frozen=True, eq=False)
class Diagnostic:
    """A number or a field that a function makes of a simulation."""

    name: str
    function: Function
    units: str
    long_name: str

    @property
    def label(self) -> str:
        """What it is called in a table."""
        return self.name if self.units == "1" else f"{self.name} [{self.units}]"

    @property
    def attributes(self) -> dict[str, str]:
        """Those of its variable in a file."""
        return {"long_name": self.long_name, "units": self.units}


DIAGNOSTICS: dict[str, Diagnostic] = {}
"""All that are registered, by name."""


@overload
def diagnostic(function: F) -> F: ...
@overload
def diagnostic(
    *, name: str | None = None, units: str = "1", long_name: str | None = None
) -> Callable[[F], F]: ...
def diagnostic(
    function: Any = None,
    *,
    name: str | None = None,
    units: str = "1",
    long_name: str | None = None,
) -> Any:
    """Register a function `f(sim)` that returns a number, or a field (N,) on the nodes.

    A number appears in the series of the runs' files, in their summaries and in sweeps; a field in
    every frame.  name: that of the function; units: of CF; long_name: the first line of its text.
    To register the function of a name again replaces it, as when a cell of a notebook runs again.

    Examples:
        >>> from swe_sphere import Simulation
        >>> from swe_sphere.simulation.diagnostics import diagnostic, forget
        >>> @diagnostic(units="m s-1")
        ... def jet(sim):
        ...     "largest eastward wind"
        ...     return sim.state.u.max()
        >>> sim = Simulation("williamson2", ne=2, np=4)
        >>> round(sim.run(days=0.1)["jet"])
        39
        >>> forget("jet")

    Raises:
        ConfigError: a name that files have already, or that is none; what cannot be called.
    """
    if function is None:
        return partial(diagnostic, name=name, units=units, long_name=long_name)
    if not callable(function):
        raise ConfigError(f"a diagnostic is a function of the simulation, not {function!r}")
    called = name or function.__name__
    if not called.isidentifier():
        raise ConfigError(f"the diagnostic {called!r} needs a name= of letters, digits and _")
    if called in TAKEN or called.startswith(TAKEN_BEGINNINGS):
        raise ConfigError(f"the diagnostic {called!r} needs another name: files have one of it")
    words = (function.__doc__ or called).strip().splitlines()[0]
    DIAGNOSTICS[called] = Diagnostic(called, function, units, long_name or words)
    return function


def load_diagnostics(path: Path) -> None:
    """Register the diagnostics that a Python file defines.

    Raises:
        ConfigError: no such file, a file that fails, or one without a diagnostic.
    """
    before = dict(DIAGNOSTICS)
    load_file(path, "diagnostic")
    if before == DIAGNOSTICS:
        raise ConfigError(f"{path} defines no diagnostic: put @diagnostic above a function in it")


def forget(name: str) -> None:
    """Take a diagnostic off the register; nothing happens where there is none of that name."""
    DIAGNOSTICS.pop(name, None)


@dataclass
class OwnDiagnostics:
    """The registered diagnostics in one run: which are numbers, which are fields."""

    warn: Callable[[str], None]
    _told: set[str] = field(default_factory=set)
    _shapes: dict[Diagnostic, tuple[int, ...]] = field(default_factory=dict)
    """Of what each returned at first: files have variables for that."""

    def __call__(self, sim: Any) -> tuple[dict[str, float], Fields]:
        """Numbers and fields (N,) of the state.

        Raises:
            RunFailed: a function fails, or returns what is neither, or not what it was at first.
        """
        numbers: dict[str, float] = {}
        fields: Fields = {}
        for name, own in DIAGNOSTICS.items():
            value = self._value(own, sim)
            if value.ndim == 0:
                numbers[name] = float(value)
            else:
                fields[name] = value
        return numbers, fields

    def _value(self, own: Diagnostic, sim: Any) -> Array:
        what = f"the diagnostic {own.name}"
        try:
            value = guarded(what, lambda: _as_numbers(own.function(sim)))
        except SweError as error:
            raise RunFailed(str(error)) from error
        size = sim.mesh.size
        if value.shape not in ((), (size,)):
            raise RunFailed(
                f"{what} returned an array of shape {value.shape}: return one number, or a field of"
                f" {size} values, one a node"
            )
        if self._shapes.setdefault(own, value.shape) != value.shape:
            first = "field" if value.ndim == 0 else "number"
            raise RunFailed(f"{what} was a {first} at first and is none now: return the same kind")
        if own.name not in self._told and not np.isfinite(value).all():
            self._told.add(own.name)
            self.warn(f"{what} is NaN or infinite at day {sim.time / DAY:.4g}")
        return value


def _as_numbers(found: object) -> Array:
    if found is None:
        raise TypeError("it returned nothing")  # which numpy takes for NaN
    return np.asarray(found, dtype=np.float64)
