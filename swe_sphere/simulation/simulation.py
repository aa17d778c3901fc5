"""One simulation: a scene on a mesh with a stepper, from its start to wherever it is taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.simulation.callbacks import Callback, intervals, scheduled
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, OwnDiagnostics
from swe_sphere.simulation.evaluator import Evaluator, ReferenceErrors
from swe_sphere.simulation.execution import execute, numbers_of
from swe_sphere.simulation.output import check_out
from swe_sphere.simulation.plan import TimePlan, continued_plan, time_plan
from swe_sphere.simulation.progress import Notebook, Watcher
from swe_sphere.simulation.restart import (
    adopt,
    attributes_of,
    carried_counts,
    check_identity,
    check_step,
    code_warnings,
    configured,
    read_restart,
    save,
)
from swe_sphere.simulation.setup import check_paths, identity, make_mesh, make_model
from swe_sphere.simulation.snapshot import Fields, Snapshot
from swe_sphere.simulation.stepping import (
    StepChoice,
    accurate_step,
    choose_step,
    longest_step,
    stepper_options,
)
from swe_sphere.simulation.summary import Outcome, Summary, html_table
from swe_sphere.simulation.supplied import Supplied, supply
from swe_sphere.user_file import users_code

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from swe_sphere.equations.effects import Effect
    from swe_sphere.equations.model import Model
    from swe_sphere.steppers import Stepper

__all__ = ["Simulation"]

PER_RUN = ("out", "plot", "overwrite")
"""Fields of a configuration that are those of one run of a simulation."""


class Simulation:
    """A scene, a mesh and a stepper, set up and stepped.

    Args:
        scene: the name of a scene, the path of a .py or .toml file with one, or a `Scene`.
        stepper: the name of a stepper, the path of a .py file with one, a class, or an instance
            on a model of its own (which then is the model of the simulation).
        mesh: in the place of ne, np, stretch, centre_lon, centre_lat and spin.
        preconditioner: of an implicit stepper, by name, path or class.
        effects: parameters {"viscosity.nu": 1e5}, or effects to add.
        parameters: of the scene, {"alpha": 0.8}.
        options: of the stepper, {"tolerance": 1e-6}.
        settings: further fields of `RunConfig`: ne, np, dt [s], days, every [h], device,
            precision, tolerance, adaptive, ...

    Examples:
        >>> from swe_sphere import Simulation
        >>> sim = Simulation("williamson2", ne=3, np=4, stepper="rk4", dt=1800)
        >>> summary = sim.run(days=1)
        >>> summary.status, summary["steps"], summary["l2_h"] < 1e-3
        ('completed', 48, True)
        >>> sim.step()
        >>> sim.time
        88200.0

    Raises:
        ConfigError: whatever cannot be done as asked for, in one line.
    """

    def __init__(
        self,
        scene: str | Path | Scene,
        *,
        stepper: Any = "rk4",
        mesh: Mesh | None = None,
        preconditioner: Any = None,
        effects: Mapping[str, object] | Iterable[Effect] = (),
        parameters: Mapping[str, object] | None = None,
        options: Mapping[str, object] | None = None,
        **settings: Any,
    ) -> None:
        for name in (*PER_RUN, "restart", "as_json", "quiet"):
            if name in settings:
                raise ConfigError(f"{name} is no setting of a simulation: see run()")
        names, supplied = supply(scene, stepper, mesh, preconditioner, effects, parameters, options)
        self._set_up(_merged(names, settings), supplied)

    @classmethod
    def from_config(cls, config: RunConfig, supplied: Supplied | None = None) -> Self:
        """The simulation that a configuration asks for, also one that goes on from a restart.

        supplied: objects that stand behind its names.
        """
        sim = cls.__new__(cls)
        sim._set_up(config, supplied or Supplied())
        return sim

    @classmethod
    def from_checkpoint(cls, path: str | Path, scene: Any = None, **settings: Any) -> Self:
        """Go on from a checkpoint, or from the last frame of a run's file, bit for bit.

        scene: needed if it was given as an object.  settings: as for the class; a run that goes on
        has the stepper, the mesh and the effects it had.

        Raises:
            ConfigError: the file is missing or damaged, or of another run than what is asked for.
        """
        objects = {name: settings.pop(name, None) for name in ("mesh", "preconditioner")}
        names, supplied = supply(
            scene or str(configured(Path(path))["scene"]), settings.pop("stepper", None),
            **objects, effects=settings.pop("effects", ()),
            parameters=settings.pop("parameters", None), options=settings.pop("options", None),
        )  # fmt: skip
        return cls.from_config(_merged(names, {**settings, "restart": Path(path)}), supplied)

    def _set_up(self, config: RunConfig, supplied: Supplied) -> None:
        """Everything that needs no step; cheap checks come first."""
        from swe_sphere.steppers import get_stepper

        checkpoint = None if config.restart is None else read_restart(config)
        config = config if checkpoint is None else adopt(config, checkpoint)
        self.config, self._supplied, self._checkpoint = config, supplied, checkpoint
        self.scene: Scene = supplied.scene_of(config)
        self._kind = supplied.kind or get_stepper(config.stepper)
        self.mesh: Mesh = supplied.mesh or make_mesh(config, self.scene)
        check_paths(config)
        check_out(config)
        if checkpoint is not None:
            check_identity(config, checkpoint, identity(config, self.scene, self.mesh))
        self._reference = self._read_reference()
        self.options = {} if supplied.instance else stepper_options(self._kind, config)
        """What the stepper is built with, by names."""
        self.model: Model = (
            supplied.instance.model
            if supplied.instance
            else make_model(config, self.scene, self.mesh)
        )
        self.warnings = code_warnings(config, checkpoint)
        """What the user should know before the run."""
        self.wall_seconds = self.cpu_seconds = 0.0
        """Time spent stepping [s], without compiling, observing and writing; that of processors,
        all threads and compiling included."""
        self.outcome = Outcome("not begun")
        self.dt_rule = ""
        """How the step was chosen, in words."""
        self._stepper: Stepper | None = None
        self._plan: TimePlan | None = None
        self._carried: dict[str, float] = {}
        self._before: dict[str, int] = {}
        self._watcher = Watcher()
        self._own = OwnDiagnostics(lambda text: self._watcher.warn(text))
        self._seen: _Seen | None = None

    def _read_reference(self) -> ReferenceErrors | None:
        if self.config.reference is None:
            return None
        return ReferenceErrors(self.config.reference, self.scene.error_field, self.days)

    # --- where it stands

    @property
    def days(self) -> float:
        """Length of the whole run [days], as configured or as the scene recommends."""
        return self.scene.days if self.config.days is None else self.config.days

    @property
    def stepper(self) -> Stepper:
        """The stepper, which stands at the start of the scene or of the restart at first."""
        if self._stepper is None and self._checkpoint is not None:
            dt, done = check_step(self.config, self._checkpoint), self._checkpoint.steps
            self.begin(TimePlan(dt, done, done, dt))
        elif self._stepper is None:
            self.begin()
        assert self._stepper is not None
        return self._stepper

    @property
    def plan(self) -> TimePlan:
        """The steps up to the end of the run."""
        _ = self.stepper  # which is planned for first
        assert self._plan is not None
        return self._plan

    @property
    def steps(self) -> int:
        """Steps since the very start."""
        return self.stepper.steps

    @property
    def time(self) -> float:
        """Simulated time since the very start [s]."""
        return self.plan.time(self.stepper.steps)

    @property
    def snapshot(self) -> Snapshot:
        """The state as it stands, with its fields as arrays (N,)."""
        return self._now.snapshot

    @property
    def _now(self) -> _Seen:
        """What is known of the state as it stands."""
        if self._seen is None or self._seen.snapshot.steps != self.steps:
            snapshot = Snapshot(self.model, self.stepper.state, self.time, self.steps)
            self._seen = _Seen(snapshot)
        return self._seen

    @cached_property
    def start(self) -> Fields:
        """All fields at the scene's own start, also where the run begins later; each (N,)."""
        return Snapshot(self.model, self.model.initial_state(), 0.0).with_constants

    @cached_property
    def stable_dt(self) -> float:
        """Largest stable step at the start [s], about; infinite if there is none."""
        counted = dict(self.model.counters)
        spectrum = self._kind.spectrum(self.model, self.model.initial_state())
        self.model.counters.update(counted)  # whenever it is asked for, it is no part of the run
        return self._kind.stable_dt(spectrum.wave, spectrum.dissipation)

    @cached_property
    def _evaluator(self) -> Evaluator:
        return Evaluator(self.model, self.start, self._step_length)

    def _step_length(self) -> float:
        """The present step [s], which follows its error in an adaptive run."""
        return float(getattr(self.stepper, "next_dt", self.plan.dt))

    @property
    def diagnostics(self) -> dict[str, float]:
        """All numbers of the state: integrals, drifts, Courant numbers, errors, the user's own.

        Raises RunFailed where a diagnostic of the user's own fails.
        """
        seen = self._now
        if seen.numbers is None:
            seen.numbers = self._evaluator(seen.snapshot) | self._own_now()[0]
        return seen.numbers

    @property
    def own_fields(self) -> Fields:
        """Fields (N,) that diagnostics of the user's own make of the state."""
        return self._own_now()[1]

    def _own_now(self) -> tuple[dict[str, float], Fields]:
        seen = self._now
        if seen.own is None:
            seen.own = {}, {}  # for those that ask for the whole state
            seen.own = self._own(self)
        return seen.own

    def reference_errors(self) -> dict[str, float]:
        """Errors of the state against the reference of the configuration, if it has one."""
        return {} if self._reference is None else self._reference(self.model, self.snapshot)

    def counts(self) -> dict[str, float]:
        """Counters and seconds of the run, with those before a restart."""
        counts: dict[str, float] = {
            name: n - self._before.get(name, 0) for name, n in self.model.counters.items()
        }
        counts |= self.stepper.costs() | {"wall_seconds": self.wall_seconds}
        return {name: n + self._carried.get(name, 0) for name, n in counts.items()}

    @property
    def summary(self) -> Summary:
        """The numbers of the state, and how the last run ended."""
        return Summary(numbers_of(self, self.outcome), self.outcome)

    # --- stepping

    def begin(self, plan: TimePlan | None = None, callbacks: Sequence[Callback] = ()) -> None:
        """Plan the steps up to the end; what has been stepped already keeps its length of steps.

        plan: the steps to take, in the place of those that the configuration asks for.

        Raises:
            ConfigError: step, length, frames and calls do not go together.
        """
        self._plan = plan or self._planned(intervals(callbacks))
        if self._stepper is None or self._stepper.steps == 0:
            self._make_stepper(self._plan.dt)

    def _planned(self, also: list[Fraction]) -> TimePlan:
        days, every = self.days, self.config.every
        stepper = self._stepper or self._supplied.instance
        if stepper is not None and (stepper.steps or self._supplied.instance):
            return continued_plan(days, every, stepper.dt, stepper.steps, also)
        if self._checkpoint is not None:
            dt, done = check_step(self.config, self._checkpoint), self._checkpoint.steps
            self.dt_rule = "that of the restart file"
            return continued_plan(days, every, dt, done, also)
        choice = self._choice()
        self.dt_rule = choice.rule
        return time_plan(days, every, choice.dt, also)

    def _choice(self) -> StepChoice:
        config, days = self.config, self.days
        asked = None if config.dt == "auto" else config.dt
        if config.adaptive is not None and asked is None:
            return longest_step(config, days)
        accurate = accurate_step(self.mesh, self.start)
        return choose_step(asked, days, self.stable_dt, self._kind.safety, accurate)

    def _make_stepper(self, dt: float) -> None:
        """Build the stepper, and put it at the start or where the restart stands."""
        supplied, checkpoint = self._supplied, self._checkpoint
        state = self.model.initial_state()
        self._before, self._seen = dict(self.model.counters), None
        with users_code():
            self._stepper = stepper = supplied.instance or self._new_stepper(dt)
            if checkpoint is not None:
                self._carried = carried_counts(checkpoint)
                stepper.load_state_dict(checkpoint.memory, checkpoint.steps)
            elif stepper.steps == 0:
                stepper.start(state)

    def _new_stepper(self, dt: float) -> Stepper:
        """The stepper of the configuration, with steps that follow their error if it says so."""
        from swe_sphere.steppers.adaptive import AdaptiveStepper

        config, made = self.config, self._supplied.preconditioner
        options = self.options if made is None else {**self.options, "preconditioner": made}
        stepper = self._kind(self.model, dt, **options)
        if config.adaptive is None:
            return stepper
        return AdaptiveStepper(stepper, config.adaptive, config.adaptive_by)

    def step(self) -> None:
        """Take one step.

        Raises:
            RunFailed: it cannot be taken.
        """
        self.stepper.step()

    def run(
        self,
        days: float | None = None,
        *,
        out: str | Path | None = None,
        every: float | None = None,
        callbacks: Sequence[Any] = (),
        time_limit: float | None = None,
        overwrite: bool = False,
        progress: bool | None = None,
        watcher: Watcher | None = None,
    ) -> Summary:
        """Step to the end of the run, or until something comes in the way.

        Args:
            days: length of the run from its very start [days].
            out: a file to write frames, series of diagnostics and checkpoints to.
            every: time between frames [h].
            callbacks: functions of the simulation: called after every step, or when
                `callbacks.every` says.
            time_limit: wall time that the steps may take [s].
            overwrite: replace the file `out` if it is there already.
            progress: whether to show a bar; None: in a notebook or on a terminal.

        Returns:
            How it went, also where it stopped early: see `Summary.status` and `reason`.

        Raises:
            ConfigError: it cannot be run as asked for; nothing was stepped.
        """
        asked = {"days": days, "every": every, "time_limit": time_limit}
        asked["overwrite"] = overwrite or None
        kept = {k: v for k, v in self.config.given().items() if k not in PER_RUN}
        kept |= {name: value for name, value in asked.items() if value is not None}
        self.config = make_config(kept if out is None else {**kept, "out": Path(out)})
        check_paths(self.config)
        check_out(self.config)
        calls = scheduled(callbacks)
        self.begin(callbacks=calls)
        self._watcher = watcher or Notebook(progress)
        self.outcome = execute(self, calls, self._watcher)
        return self.summary

    # --- looking at it

    @property
    def state(self) -> xr.Dataset:
        """Depth, wind, vorticity, divergence and tracers on the nodes (N,), with their units."""
        return self.to_xarray().isel(time=0)

    def to_xarray(self) -> xr.Dataset:
        """The state as a frame of a run's file: fields on (time, node), points, areas, bottom."""
        from swe_sphere.io.frame import frame_dataset

        fields = self.snapshot.with_constants | self.own_fields
        own = self.own_attributes()
        return frame_dataset(self.mesh, fields, self.time, attributes_of(self), own)

    def plot(self, field: str | None = None, ax: Axes | None = None) -> Axes:
        """Draw a field of the state on the globe; into `ax`, else into a figure of its own.

        field: h, surface, vorticity, speed, q_NAME, ...; None: what suits the scene.
        Raises ConfigError for a field that is not there.
        """
        from swe_sphere.io.plot import draw_state

        fields = self.snapshot.with_constants | self.own_fields
        return draw_state(self.mesh, fields, self.time, attributes_of(self), field, ax)

    def checkpoint(self, path: str | Path) -> Path:
        """Write all that is needed to go on from here bit for bit, with `from_checkpoint`.

        Raises RunFailed where the disk refuses.
        """
        return save(self, Path(path))

    def own_attributes(self) -> dict[str, dict[str, str]]:
        """Attributes of the variables that diagnostics of the user's own make, in files."""
        numbers, fields = self._own_now()
        return {name: DIAGNOSTICS[name].attributes for name in (*numbers, *fields)}

    def __repr__(self) -> str:
        where = f"day {self.time / DAY:.4g}" if self._stepper is not None else "not begun"
        return (
            f"Simulation({self.scene.name!r}, ne={self.mesh.ne}, np={self.mesh.np},"
            f" stepper={self.config.stepper!r}: {where} of {self.days:g} days)"
        )

    def _repr_html_(self) -> str:
        return html_table(repr(self), list(self.summary.rows()))


@dataclass
class _Seen:
    """A state, and the numbers taken of it so far."""

    snapshot: Snapshot
    numbers: dict[str, float] | None = None
    own: tuple[dict[str, float], Fields] | None = None


def _merged(names: dict[str, Any], settings: dict[str, Any]) -> RunConfig:
    """The configuration of what was given by name and as settings."""
    both = (*names.pop("settings"), *settings.pop("settings", ()))
    return make_config({**names, **({"settings": both} if both else {}), **settings})
