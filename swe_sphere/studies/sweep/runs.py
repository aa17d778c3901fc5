"""The runs of a sweep: a scene on its meshes, steppers on these, steps; settings and keys.

A `SweepPlan` (the request) becomes a `Study`. This has a `Discretisation` for each mesh and
precision, a `Setup` for each stepper on it, and a `RunSpec` for each step of the setup.
`Sweep` (engine.py) decides which of these runs are needed; `Runner` (runner.py) performs them and
stores a `RunRecord` (record.py) of each; `Evaluator` computes their errors.
"""

import inspect
import math
import sys
import uuid
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, reduce
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swe_sphere.equations.scene import RETURNS, Scene
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError, in_one_line
from swe_sphere.files import fingerprints
from swe_sphere.files.user_file import is_custom, is_user_file
from swe_sphere.io.integrals import Fields
from swe_sphere.io.reference_solution import Reference
from swe_sphere.operators import find_device
from swe_sphere.planet import DAY
from swe_sphere.simulation import build, planning
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import DIAGNOSTICS
from swe_sphere.simulation.restart import identity, run_sources
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.solvers.preconditioners import PRECONDITIONERS
from swe_sphere.steppers import STEPPERS, Stepper, get_stepper
from swe_sphere.studies.sweep.sweep_plan import SweepPlan

RATIO = math.sqrt(2.0)
"""Ratio of successive steps of an explicit stepper, whose useful range is short."""
LONGEST_IMPLICIT = 64.0
"""Longest step of a stepper that gravity waves do not limit, in gravity limits."""
SHORTEST_IMPLICIT = 2.0
"""Shortest implicit step, in gravity limits; for shorter steps explicit steppers cost less."""

TRIAL_STEPS, TRIAL_DAYS = 100, 5.0
"""Least number of steps and of days of a trial of stability; a sweep with more days extends it."""


def dt_sequence(
    usable: float, explicit: bool, gravity: float, longest: float, levels: int
) -> list[float]:
    """Return steps [s] for a stepper, the longest first, if the user names none.

    usable: safe fraction of the stability limit [s], infinite if there is none; explicit: True if
    gravity waves set it; gravity: limit [s] of leapfrog; longest: longest step [s]; levels: count.
    """
    top = min(usable, LONGEST_IMPLICIT * gravity, longest)
    bottom = min(gravity if math.isfinite(usable) else SHORTEST_IMPLICIT * gravity, top)
    if explicit:
        ratio = RATIO
    elif levels == 1 or top <= bottom * (1.0 + 1e-9):
        return [top]
    else:
        ratio = float((top / bottom) ** (1.0 / (levels - 1)))
    return [top / ratio**n for n in range(levels)]


History = dict[float, Fields]
"""Fields by report day."""
Role = Literal["grid", "target", "stability", "converged"]
"""Purpose of a run: a grid, a search for an error or the longest stable step, or a reference."""
SAMPLED = (0.0, 0.3, 1.0)
"""Times at which functions of a custom scene are compared, as shares of a run."""
SESSION = uuid.uuid4().hex
"""Stands for the fingerprint of code without a file, which cannot be compared later."""
DIAGNOSTIC = "the diagnostic "
"""Beginning of the names of diagnostics among the sources of a run."""


class Discretisation:
    """A scene on a mesh: its initial state, limits, and fresh simulations.

    config: configuration of any run on the mesh; its stepper is ignored. own: a scene that replaces
    the named one. Raises ConfigError if scene or mesh cannot be built.
    """

    def __init__(self, config: RunConfig, own: Scene | None = None) -> None:
        self.config, self._own = config, own
        self.scene = build.make_scene(config, own)
        self.mesh = build.make_mesh(config, self.scene)
        self._radii: dict[tuple[type[Stepper], bool], list[SpectralRadii]] = {}

    @cached_property
    def identity(self) -> str:
        """Text that is the same for all discretisations of the same settings, files and code."""
        same = identity(self.config, self.scene, self.mesh) | {
            "device": self.config.device, "launch": self.config.launch, "stepper": None,
            "code": fingerprints.code_fingerprint(),
        }  # fmt: skip
        if self._own is not None:  # its functions may depend on more than its parameters
            same |= {name: str(x.tobytes()) for name, x in self.sim.initial_fields.items()}
            same |= self._samples(self._own)
        return fingerprints.fingerprint(same)

    def _samples(self, scene: Scene) -> dict[str, str]:
        """Return values at the nodes of functions other than the initial fields, and their code."""
        found, end = {}, scene.days if self.config.days is None else self.config.days
        for effect in (effect for effect in scene.effects if is_custom(type(effect))):
            code = [_code(getattr(effect, name)) for name in vars(type(effect))]
            given = {k: np.asarray(x).tobytes() for k, x in effect.coefficients(self.mesh).items()}
            found[effect.name] = str((code, given))
        for name in ("base", "equilibrium", "wind", "forcing", "exact", "exact_tracers"):
            if (function := getattr(scene, name)) is not None:
                unsteady, found[name] = name not in ("base", "equilibrium"), _code(function)
                for time in [(share * end * DAY,) for share in SAMPLED] if unsteady else [()]:
                    values = function(self.mesh.lon, self.mesh.lat, *time)
                    values = [*values.values()] if isinstance(values, dict) else values
                    found[f"{name}{time}"] = str(np.asarray(values).tobytes())
        return found

    def simulation(self, config: RunConfig) -> Simulation:
        """Return a simulation on the common mesh; ConfigError if stepper or options do not fit."""
        return Simulation(self._own or config.scene, config=config, mesh=self.mesh)

    @cached_property
    def sim(self) -> Simulation:
        """A simulation in its initial state that belongs to no run."""
        plain = {"settings": self.config.scene_settings}
        return self.simulation(self.config.model_copy(update=plain))

    @cached_property
    def limits(self) -> dict[str, float]:
        """Return the steps [s] that the initial state permits.

        gravity_limit: of leapfrog, 1 over the spectral radius; advective_limit: of the wind.
        """
        gravity = self.sim.gravity_limit
        at_start, _ = self.sim.initial_numbers
        wind, wave = at_start["max_wind"], at_start["max_wave"]
        if self.scene.effect("pressure-gradient") is None:
            wave = 0.0
        advective = gravity * ((wind + wave) / wind) if wind > 0.0 else np.inf
        return {"gravity_limit": gravity, "advective_limit": advective}

    def stable_dt(self, kind: type[Stepper]) -> float:
        """Return the approximate stability limit [s] of a stepper in a run, or infinity."""
        own = kind.spectral_radii.__func__ is not Stepper.spectral_radii.__func__  # type: ignore[attr-defined]
        of = kind if own else Stepper, kind.splits_diffusion
        if of not in self._radii:
            self._radii[of] = planning.run_radii(kind, self.sim.model, self.sim.limiting_times())
        return planning.stability_limit(kind, self._radii[of])


class Study:
    """The request of a plan: a scene, `own` if given, its meshes, and the times of errors."""

    def __init__(self, plan: SweepPlan, own: Scene | None = None) -> None:
        self.plan, self._own = plan, own
        self._known: dict[tuple[int, int, str], Discretisation] = {}
        self.scene = scene = build.make_scene(plan.run_config(), own)
        self.ne, self.np = plan.ne or (scene.ne,), plan.np or (scene.np,)
        self.days = scene.days if plan.days is None else plan.days
        meant = (float(planning.meant_hours(24.0 * day) / 24) for day in plan.report_days)
        self.report_days = tuple(sorted({*(min(day, self.days) for day in meant), self.days}))
        """Times of errors [days]; the last is the end."""
        times = [Fraction(day * DAY).limit_denominator(1000) for day in self.report_days]
        self._every = reduce(planning.common_measure, times)
        self.interval = float(self._every)
        """The longest time [s] of which all report times are multiples."""
        wanted = scene.sheds_waves if plan.slow is None else plan.slow
        self.slow = wanted or plan.target_kind == "slow"
        """True if errors of the slow flow are computed."""

    def searched(self, errors: Iterable[Any]) -> Any:
        """Return the error that a search of the plan is about, among the `Errors` of a run."""
        plan = self.plan
        field = "vorticity" if plan.target_kind == "slow" else plan.target_field
        found = {of.kind: of for of in errors if (of.field, of.day) == (field, self.days)}
        auto = "total" if "total" in found else "time"
        return found.get(auto if plan.target_kind == "auto" else plan.target_kind)

    def at(self, ne: int, np: int, precision: str = "float64") -> Discretisation:
        """Return the scene on the mesh and in the precision, built at the first request."""
        key = (ne, np, precision)
        if key not in self._known:
            mesh = {"ne": ne, "np": np, "precision": precision}
            config = self.plan.run_config(**mesh, days=self.days)
            self._known[key] = Discretisation(config, self._own)
        return self._known[key]

    def spaces(self) -> list[Discretisation]:
        """Return all meshes and precisions of the plan."""
        return [self.at(*of) for of in product(self.ne, self.np, self.plan.precision)]

    def setups(self) -> list["Setup"]:
        """Return the steppers with each preconditioner, mesh by mesh.

        Steppers without a preconditioner appear once; those without a tolerance get none.
        """
        found = []
        for space, stepper in product(self.spaces(), self.plan.steppers):
            takes = inspect.signature(get_stepper(stepper)).parameters
            tolerance = self.plan.tolerance if "tolerance" in takes else None
            names = self.plan.preconditioner if "preconditioner" in takes else ()
            for name in names or (None,):
                found.append(self.setup(space, stepper, tolerance=tolerance, preconditioner=name))
        return [*dict.fromkeys(found)]

    def setup(self, space: Discretisation, stepper: str, **options: object) -> "Setup":
        """Return a stepper on a mesh."""
        return Setup(space.config.model_copy(update={"stepper": stepper, **options}), space, self)

    def plan_steps(self, dt: float, automatic: bool = False) -> planning.RunPlan:
        """Return steps of at most dt [s] that meet all report times; ConfigError if no step does.

        automatic: True for an automatic dt, which may be shortened to a twentieth.
        """
        every = self._every / 3600
        return planning.time_plan(self.days, every, dt, cycle=self.cycle, automatic=automatic)

    @property
    def cycle(self) -> int:
        """Requested number of steps that are taken with one step of the tracers; 1 for auto."""
        return 1 if (asked := self.plan.tracer_steps) == "auto" else asked

    def error_identity(self, role: Role) -> tuple[str, ...]:
        """Return what determines the errors of a run, in words: part of its identity."""
        if role == "stability":
            return (f"noise, {TRIAL_STEPS} steps, {TRIAL_DAYS} days",)
        files = {day: fingerprints.file_fingerprint(path) for day, path in self.files.items()}
        reference = ["reference run"] if role == "converged" else []
        return (*reference, str(files), *(["slow flow"] if self.slow else []))

    @cached_property
    def files(self) -> dict[float, Path]:
        """Files of solutions by report day; without any, the exact solution counts, if known.

        They are the user's, or the package's for scenes without exact solution. Raises ConfigError
        for a file that cannot be read or is of no report day.
        """
        if not self.plan.reference:
            shipped = {day: build.shipped_solution(self.scene, day) for day in self.report_days}
            return {day: path for day, path in shipped.items() if path}
        found: dict[float, Path] = {}
        for path in self.plan.reference:
            time = Reference(path).frame_time(None)
            time = self.days * DAY if time is None else time
            near = [day for day in self.report_days if abs(day * DAY - time) < 1.0]
            if near and near[0] in found:
                raise ConfigError(f"reference: {path} and {found[near[0]]} are of one day")
            if not near:
                days = ", ".join(f"{day:g}" for day in self.report_days)
                raise ConfigError(
                    f"reference: {path} is of day {time / DAY:g}, errors are taken at day {days}:"
                    " add it to report-days"
                )
            found[near[0]] = path
        return found

    @cached_property
    def sources(self) -> dict[str, str]:
        """Fingerprints of all sources of every run except its settings, by name.

        Scenes of one name are distinguished by their origin: the package, a file or functions.
        Times of one processor do not apply to another.
        """
        files = run_sources(self.plan.run_config(), self.scene)
        origin = "a file" if fingerprints.SCENE_FILE in files else "the package"
        if self._own is not None:
            given = [getattr(self._own, name) for name in (*RETURNS, "exact_tracers")]
            given += (self._own.tracers or {}).values()
            origin = fingerprints.fingerprint([_code(function) for function in given])
        build.start_warp()
        return {
            "the code of swe_sphere": fingerprints.code_fingerprint(),
            "the processor": fingerprints.processor(find_device(self.plan.device)),
            "the scene": origin, **files,
            **{f"{DIAGNOSTIC}{name}": users_fingerprint(one.function) + _code(one.function)
               for name, one in DIAGNOSTICS.items()},
            **{f"the reference of day {day:g}": fingerprints.file_fingerprint(path)
               for day, path in self.files.items()},
        }  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """All settings of a run except its step; setups with equal settings are equal."""

    config: RunConfig
    """Mesh, precision, stepper and its options."""
    space: Discretisation = field(compare=False, repr=False)
    study: Study = field(compare=False, repr=False)

    @property
    def stepper_class(self) -> type[Stepper]:
        """Class of the stepper."""
        return get_stepper(self.config.stepper)

    @property
    def label(self) -> str:
        """The stepper and its discretisation in words."""
        config = self.config
        method = " ".join(filter(None, (config.stepper, config.preconditioner)))
        return f"{method}, ne{config.ne} np{config.np} {config.precision}"

    @cached_property
    def refusal(self) -> str | None:
        """Reason why the stepper cannot run this scene, if any."""
        try:
            build.stepper_options(self.stepper_class, self.config)
            _ = self.stable_dt
        except ConfigError as error:
            return in_one_line(error)
        return None

    @cached_property
    def options(self) -> dict[str, object]:
        """Options of the stepper; as requested if it cannot be built."""
        if self.refusal is not None:
            return {"preconditioner": self.config.preconditioner}
        return build.stepper_options(self.stepper_class, self.config)

    @cached_property
    def sources(self) -> dict[str, str]:
        """Fingerprints of the stepper and the preconditioner, if they are user-defined."""
        return users_methods([self.config.stepper], filter(None, [self.config.preconditioner]))

    @property
    def stable_dt(self) -> float:
        """Approximate stability limit [s]; infinite if there is none."""
        return self.space.stable_dt(self.stepper_class)

    @property
    def safe_dt(self) -> float:
        """Safe fraction of the stability limit [s]; infinite without one."""
        return planning.safe_part(self.stepper_class, self.study.days) * self.stable_dt

    def spec(self, dt: float, role: Role = "grid") -> "RunSpec":
        """Return the run with steps of dt [s], or down to half of it if report times require it.

        Trials of stability keep their step: they have no report times.
        """
        try:
            trial = role == "stability"
            days = max(self.study.days, TRIAL_DAYS, TRIAL_STEPS * dt / DAY)
            cycle = self.study.cycle
            steps = planning.free_steps(days, dt, cycle) if trial else self.study.plan_steps(dt)
        except ConfigError as error:
            return RunSpec(self, dt, None, role, str(error))
        return RunSpec(self, steps.dt, steps, role, self.refusal)

    def grid(self) -> list["RunSpec"]:
        """Return the runs of the plan, without duplicates."""
        if (plan := self.study.plan).dt != "auto":
            steps = sorted(plan.dt, reverse=True)
        elif self.refusal is None:
            explicit = math.isfinite(self.safe_dt) and self.stepper_class.family == "explicit"
            gravity, interval = self.space.limits["gravity_limit"], self.study.interval
            steps = dt_sequence(self.safe_dt, explicit, gravity, interval, plan.levels)
        else:
            steps = [self.study.interval]
        return [*dict.fromkeys(map(self.spec, steps))]


@dataclass(frozen=True)
class RunSpec:
    """One run; runs with equal settings are equal."""

    setup: Setup
    dt: float
    """The step [s]."""
    plan: planning.RunPlan | None = field(compare=False)
    """None if no step near the requested one is possible."""
    role: Role = "grid"
    refusal: str | None = field(default=None, compare=False)
    """Why the run is impossible, if known beforehand."""

    @property
    def label(self) -> str:
        """The setting in words."""
        return f"{self.setup.label}, dt {self.dt:.5g} s"

    @cached_property
    def config(self) -> RunConfig:
        """The configuration, complete: with the step and the length."""
        return self.setup.config.model_copy(update={"dt": self.dt, "days": self.setup.study.days})

    @property
    def report_days(self) -> tuple[float, ...]:
        """Times of errors [days]; none in a trial of stability."""
        return () if self.role == "stability" else self.setup.study.report_days

    @cached_property
    def key(self) -> str:
        """Hash of all settings, files and code that affect the result."""
        of, study = self.setup, self.setup.study
        return fingerprints.fingerprint([
            of.space.identity, of.config.stepper, of.options, repr(self.dt), study.days,
            self.report_days, study.error_identity(self.role), of.sources,
        ])  # fmt: skip

    @property
    def resolved(self) -> RunConfig:
        """The configuration with the stepper of a file by name, and with its preconditioner."""
        stepper, kind = self.config.stepper, self.setup.stepper_class
        chosen = self.setup.options.get("preconditioner") or self.config.preconditioner
        named = kind.name if is_user_file(stepper) else stepper
        return self.config.model_copy(update={"stepper": named, "preconditioner": chosen})


def users_methods(steppers: Iterable[str], preconditioners: Iterable[str]) -> dict[str, str]:
    """Return fingerprints of methods outside the package, by name.

    steppers, preconditioners: names, or files. Raises ConfigError for an unknown name.
    """
    kinds: dict[str, type] = {f"the stepper {name}": STEPPERS.find(name) for name in steppers}
    kinds |= {f"the preconditioner {name}": PRECONDITIONERS.find(name) for name in preconditioners}
    return {what: users_fingerprint(kind) for what, kind in kinds.items() if is_custom(kind)}


def _code(function: Any) -> str:
    """Return the fingerprint of the code of a callable, with its constants and names."""
    function = getattr(function, "function", function)  # of a scene

    def parts(code: Any) -> Any:
        names = getattr(code, "co_names", None)
        if isinstance(code, frozenset):
            return sorted(map(repr, code))
        return code if names is None else [code.co_code, names, *map(parts, code.co_consts)]

    code, cells = (getattr(function, f"__{name}__", None) for name in ("code", "closure"))
    around = [cell.cell_contents for cell in cells or () if cell != type(cell)()]
    plain = [x for x in around if isinstance(x, float | int | str)]
    return fingerprints.fingerprint([parts(code), plain])


def users_fingerprint(item: object) -> str:
    """Return the fingerprint of the file of a function or class; without a file, `SESSION`."""
    file = getattr(sys.modules.get(item.__module__), "__file__", None)
    return SESSION if file is None else fingerprints.file_fingerprint(Path(file))
