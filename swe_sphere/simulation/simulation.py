"""One simulation: a scene on a mesh with a stepper, from its initial state to any later time."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing, nullcontext
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from swe_sphere.compiling import is_watched
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, RunFailed, SweError, in_one_line
from swe_sphere.files.durable import clear_errors
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.files.user_file import cause, users_code
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.settings.values import validated
from swe_sphere.simulation import planning, restart
from swe_sphere.simulation.build import Setup, read_setup
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.diagnostics import (
    Evaluator,
    Fields,
    Numbers,
    Snapshot,
    check_options,
    reference_errors,
)
from swe_sphere.simulation.loop import Clock, Interrupted, Interruption, Loop
from swe_sphere.simulation.observers import (
    Callback,
    HealthCheck,
    LiveView,
    Observer,
    ProgressBar,
    Recorder,
    guard,
    read_callbacks,
)
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.simulation.summary import BREAKDOWNS, Outcome, Summary, html_table, outcome_of

if TYPE_CHECKING:
    import xarray as xr
    from cartopy.mpl.geoaxes import GeoAxes

    from swe_sphere.equations.effects import Effect
    from swe_sphere.steppers import Trajectory

T = TypeVar("T")
Warn = Callable[[str], None]

COSTS = (
    "newton_iterations", "krylov_iterations", "rejected_steps", "tangent_evaluations",
    "preconditioner_applications", "setups", "setup_seconds",
)  # fmt: skip
"""Costs that every summary has, also where they are zero."""

FAR = 1.05
"""A step longer than the stability limit by this factor causes a warning."""


class Simulation:
    """A scene, a mesh and a stepper, set up and stepped.

    Args:
        scene: the name of a scene, the path of a .py or .toml file with one, or a `Scene`; or all
            arguments at once as a `Setup`.
        stepper: the name of a stepper, the path of a .py file with one, or a class.
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
        ConfigError: the simulation cannot be set up as requested, in one line.
    """

    def __init__(
        self,
        scene: str | Path | Scene | Setup,
        *,
        stepper: Any = None,
        mesh: Mesh | None = None,
        preconditioner: Any = None,
        effects: Mapping[str, object] | Iterable[Effect] = (),
        parameters: Mapping[str, object] | None = None,
        options: Mapping[str, object] | None = None,
        **settings: Any,
    ) -> None:
        given: dict[str, Any] = {
            "stepper": stepper, "mesh": mesh, "preconditioner": preconditioner, "effects": effects,
            "parameters": parameters, "options": options, **settings,
        }  # fmt: skip
        if not isinstance(scene, Setup):
            scene = read_setup(scene, **given)
        elif more := [name for name, value in given.items() if value not in (None, ())]:
            raise ConfigError(f"a Setup holds all arguments already: leave out {', '.join(more)}")
        self.setup = setup = scene
        """What stays the same while it is stepped: scene, mesh, model, options, limits, ..."""
        self.config: RunConfig = setup.config
        """The configuration, with what the present run was asked for."""
        self.scene, self.mesh, self.model, self.comm = (
            setup.scene, setup.mesh, setup.model, setup.comm
        )  # fmt: skip
        self.clock = Clock()
        """Time spent stepping."""
        self.outcome = Outcome("not begun")
        self.run_id = ""
        """Identifier of the file of frames that was written last, or that a restart resumes."""
        self._out: Path | None = None  # that file
        self._plan: RunPlan | None = None
        self._stepper: Trajectory | None = None
        self._evaluator = Evaluator(self)
        self._snapshot: Snapshot | None = None
        self._counted: dict[str, int] = {}  # counters of the model before the first step
        self._carried: Numbers = {}  # counts before a restart
        if setup.checkpoint is not None:
            self.run_id = str(setup.checkpoint.attributes.get("run_id", ""))
            if setup.checkpoint.steps:
                dt, done = restart.check_step(self.config, setup.checkpoint), setup.checkpoint.steps
                self.begin(RunPlan(dt, done, done, dt, "that of the restart file"))

    @classmethod
    def from_checkpoint(cls, path: str | Path, scene: Any = None, **settings: Any) -> Self:
        """Resume from a checkpoint, or from the last frame of the file of a run, bit for bit.

        scene: needed if it was given as an object.  settings: as of `Simulation`; the stepper, the
        mesh and the effects are those of the earlier run.

        Raises ConfigError where the file is missing, damaged, or of another run than requested.
        """
        from swe_sphere.io.checkpoint import read_checkpoint  # netCDF4 takes its time to import

        checkpoint = read_checkpoint(path)
        scene = scene or str(restart.stored(path, checkpoint)["scene"])
        return cls(read_setup(scene, **settings, resumed=(Path(path), checkpoint)))

    # --- what it is made of

    @property
    def days(self) -> float:
        """Length of the whole run [days], as configured or as the scene recommends."""
        return self.scene.days if self.config.days is None else self.config.days

    @property
    def start(self) -> Fields:
        """All fields of the initial state of the scene, each (N,)."""
        return self.setup.initial.with_constants

    def stable_dt(self) -> float:
        """Return the stability limit at the initial state [s], about; infinite if there is none."""
        return self.setup.stable_dt()

    # --- stepping

    def begin(self, plan: RunPlan | None = None, also: Sequence[Fraction] = ()) -> None:
        """Plan the steps up to the end, and build the stepper unless it has taken some already.

        Args:
            plan: the steps to take; by default those of the configuration.
            also: further times [s] whose multiples fall on steps.

        Raises:
            ConfigError: step, length, frames and further times do not fit together, or an option of
                the stepper has the name of a diagnostic.
        """
        setup, every = self.setup, self.config.every
        check_options(setup.kind.name, setup.options)
        if plan is not None:
            self._plan = plan
        elif self.steps:
            self._plan = planning.continued_plan(self.plan, self.days, every, self.steps, also)
        else:
            self._plan = planning.plan_run(setup, self.days, every, also)
        if self.steps:
            return
        with users_code():
            stepper = setup.new_stepper(self._plan.dt)
            state = self.model.initial_state()
            self._stepper, self._snapshot = stepper, None
            self._counted = dict(self.model.counters)
            if setup.checkpoint is None:
                stepper.start(state)
            else:
                arrays = setup.checkpoint.state_dict
                self._carried = {
                    name.removeprefix(restart.COUNTER): np.asarray(array).item()
                    for name, array in arrays.items()
                    if name.startswith(restart.COUNTER)
                }
                stepper.load_state_dict(arrays, setup.checkpoint.steps)

    @property
    def stepper(self) -> Trajectory:
        """The stepper; ConfigError before the first of `begin`, `step` and `run`."""
        return _begun(self._stepper)

    @property
    def plan(self) -> RunPlan:
        """The steps up to the end of the run; ConfigError before `begin`, `step` or `run`."""
        return _begun(self._plan)

    @property
    def steps(self) -> int:
        """Steps since the start of the run."""
        return 0 if self._stepper is None else self._stepper.steps

    @property
    def time(self) -> float:
        """Simulated time since the start of the run [s], to the microsecond."""
        return 0.0 if self._stepper is None else round(self.steps * self._stepper.dt, 6)

    def step(self) -> None:
        """Take one step; RunFailed where it cannot be taken."""
        self._begin_once()
        self.stepper.step()

    def _begin_once(self) -> None:
        if self._stepper is None:
            self.begin()
            self.stable_dt()

    def advance(
        self,
        observers: Sequence[Observer] = (),
        time_limit: float | None = None,
        interruption: Interruption | None = None,
    ) -> Outcome:
        """Step to the end of the plan, or until something goes wrong; return how it ended.

        Args:
            observers: see the states when they are due, and always the last one.
            time_limit: wall time that the steps may take [s].
            interruption: notes the signals of several simulations.

        Raises:
            Interrupted: the user asked to stop, and an interruption was given.
        """
        observers = [guard(observer) for observer in observers]
        outcome: Outcome | None = None
        try:
            with ExitStack() as stack:  # each observer ends if it has begun
                try:
                    for observer in observers:
                        observer.begin(self.plan, self.snapshot)
                        stack.callback(observer.end)
                    _ = self.snapshot.own_fields  # one that fails does so before the first step
                    loop = Loop(self, HealthCheck(self), observers, time_limit)
                    with nullcontext(interruption) if interruption else Interruption() as noted:
                        loop.run(noted)
                    _ = self.diagnostics  # one that fails ends the run like other errors
                except (Interrupted, SweError, *BREAKDOWNS) as error:
                    if interruption is not None and isinstance(error, Interrupted):
                        raise
                    # before observers end, which may take all ranks
                    outcome = self._ended_by(error)
        except (SweError, *BREAKDOWNS) as error:  # of the end of an observer
            outcome = outcome or self._ended_by(error)
        return outcome or Outcome()

    def _ended_by(self, error: Exception) -> Outcome:
        outcome = outcome_of(error, self.time)
        self.comm.agree_to_fail(outcome.reason or "")
        return outcome

    # --- running

    def run(
        self,
        days: float | None = None,
        *,
        out: str | Path | None = None,
        every: float | None = None,
        callbacks: Iterable[Any] = (),
        time_limit: float | None = None,
        overwrite: bool = False,
        progress: bool | None = None,
        warn: Warn | None = None,
    ) -> Summary:
        """Step to the end of the run, or until something goes wrong.

        Args:
            days: length of the run from its start [days].
            out: a file for frames, series of diagnostics and checkpoints; the file that this
                simulation wrote last is continued.
            every: time between frames [h].
            callbacks: functions of the simulation, called after every step or when `every` says;
                or observers.
            time_limit: wall time that the steps may take [s].
            overwrite: replace an existing file `out`.
            progress: whether to show a bar; None: in a notebook or on a terminal.
            warn: called with each warning; None: `warnings.warn`.

        Returns:
            The numbers of the run, also where it stopped early: see `Summary.status` and `reason`.

        Raises:
            ConfigError: it cannot be run as requested; no step was taken.
        """
        asked = {"days": days, "every": every, "time_limit": time_limit, "out": out}
        asked["overwrite"] = overwrite or None
        path = None if out is None else Path(out).resolve()
        if path is not None and path == self._out:
            asked["restart"] = out
        of_one = ("out", "overwrite", "plot", "live")
        kept = {k: v for k, v in self.setup.config.given().items() if k not in of_one}
        config = make_config(kept | {k: value for k, value in asked.items() if value is not None})
        calls = read_callbacks(callbacks)
        self.comm.on_root(lambda: restart.check_paths(config))
        self.config = config
        self.setup.check_reference(self.days)
        self.begin(also=[c.seconds for c in calls if isinstance(c, Callback) and c.seconds])
        self._out = path or self._out
        observers = [c.on(self, self.plan) if isinstance(c, Callback) else c for c in calls]
        if self.comm.rank == 0 and (is_watched() if progress is None else progress):
            observers.append(ProgressBar())
        self._evaluator.warn = warn = warn or self._warn
        if self.setup.has_other_code:
            warn(
                f"{self.setup.config.restart} was written by other code of swe_sphere: the run goes"
                " on from it, but is not bit for bit the one that either code would have made alone"
            )
        dt, limit = self.plan.dt, self.stable_dt()
        if dt > FAR * limit:
            warn(
                f"dt = {dt:.6g} s is {dt / limit:.3g} times the stability limit of"
                f" {config.stepper}, {limit:.4g} s: expect the run to blow up"
            )
        if config.out is None:
            self.outcome = self.advance(observers, config.time_limit)
        else:
            self._record(observers)
        return self.summary

    def _warn(self, text: str) -> None:
        if self.comm.rank == 0:
            warnings.warn(text, stacklevel=3)

    def _record(self, observers: Sequence[Observer]) -> None:
        """Advance with a file of frames, the last one of a sound early end too."""
        reason: str | None = None
        try:
            with closing(Recorder(self)) as recorder:
                self.outcome = self.advance([recorder, *observers], self.config.time_limit)
                reason = self.outcome.reason
                if self.outcome.is_sound and not self.outcome.completed:
                    try:
                        HealthCheck(self).observe(self.snapshot)
                        recorder.frame(self.snapshot)
                    except RunFailed as error:
                        reason = f"{reason}; its last state was not kept: {error}"
                        self.outcome = Outcome("failed", reason, self.outcome.exit_status)
                recorder.finish(self.summary.as_dict())
        except RunFailed as error:
            if reason is None:
                self.outcome = self._ended_by(error)

    # --- the state and its numbers

    @property
    def snapshot(self) -> Snapshot:
        """The present state, with its fields as arrays (N,)."""
        if self._snapshot is None or self._snapshot.steps != self.steps:
            state = self.model.initial_state() if self._stepper is None else self._stepper.state
            self._snapshot = Snapshot(self.model, state, self.time, self.steps, self._evaluator)
        return self._snapshot

    @property
    def present_dt(self) -> float | None:
        """Present step [s], which follows its error in an adaptive run; None before `begin`."""
        stepper = self._stepper
        return None if stepper is None else float(getattr(stepper, "next_dt", stepper.dt))

    @property
    def diagnostics(self) -> Numbers:
        """All numbers of the state: integrals, drifts, Courant numbers, errors, user-defined ones.

        Raises RunFailed where a user-defined diagnostic fails.
        """
        return self.snapshot.diagnostics

    def counts(self) -> Numbers:
        """Return counters and seconds of the run, with those before a restart."""
        counted, now = self._counted, self.model.counters
        counts: Numbers = {name: n - counted.get(name, 0) for name, n in now.items()}
        costs = {} if self._stepper is None else self._stepper.costs()
        counts |= costs | {"wall_seconds": self.clock.wall_seconds}
        return {name: n + self._carried.get(name, 0) for name, n in counts.items()}

    @property
    def summary(self) -> Summary:
        """The numbers of the state, and how the last run ended."""
        outcome, cuts = self.outcome, getattr(self._stepper, "cuts", None)
        reference = self.setup.reference if outcome.completed else None
        against = {} if reference is None else reference_errors(reference, self.snapshot)
        numbers = {
            "scene": self.scene.name,
            **self._method(),
            **self.setup.options,
            "ne": self.mesh.ne,
            "np": self.mesh.np,
            "steps": self.steps,
            "days": self.time / DAY,
            "compile_seconds": self.model.compile_seconds,
            **dict.fromkeys(COSTS, 0),
            **self.counts(),
            **(self.diagnostics if outcome.is_sound else {}),
            **against,
            "stretch": self.mesh.stretch,
            "precision": self.config.precision,
            "days_planned": self.days,
            "dt_wanted": self._plan and self._plan.wanted,
            "out": None if self.config.out is None else str(self.config.out),
            **({} if cuts is None else {"cuts": list(cuts)}),
        }
        return Summary(outcome.status, outcome.reason, outcome.exit_status, numbers)

    def _method(self) -> dict[str, object]:
        """Return how the scene is stepped, and on what; values of a plan are None without one."""
        plan = self._plan
        return {
            "title": self.scene.title,
            "stepper": self.config.stepper,
            "scheme": self.setup.kind.name if self._stepper is None else self._stepper.name,
            "dt": plan and plan.dt,
            "dt_rule": plan and plan.rule,
            "stable_dt": self.setup.limit,
            "device": self.model.device,
            "launch": self.model.shape,
        }

    def attributes(self) -> dict[str, object]:
        """Return the resolved configuration, as files have it."""
        method = {name: value for name, value in self._method().items() if value is not None}
        return {
            "references": self.scene.reference,
            **self.setup.identity,
            **method,
            "identity": self.setup.identity,
            "code": code_fingerprint(),
            "configuration": self.config.model_dump(mode="json"),
            "stepper_options": self.setup.options,
            "days": self.days,
            "start_step": self.steps,
            **self._plot_field(),
        }

    def _plot_field(self) -> dict[str, str]:
        """Return what a picture shows by default: the first tracer where the wind is prescribed.

        A file that lacks that field, or else depth, shows the first of its fields.
        """
        carried = None if self.scene.wind is None else self.scene.tracers
        usual = f"q_{next(iter(carried))}" if carried else "h"
        if self.config.fields and usual not in self.config.fields:
            return {"plot_field": self.config.fields[0]}
        return {"plot_field": usual} if carried else {}

    @property
    def state(self) -> xr.Dataset:
        """Depth, wind, vorticity, divergence and tracers on the nodes (N,), with their units."""
        return self.to_xarray().isel(time=0)

    def to_xarray(self) -> xr.Dataset:
        """Return the state as a frame of a file: fields on (time, node), points, areas, bottom."""
        from swe_sphere.analysis import accessor  # noqa: F401 - registers `ds.swe`
        from swe_sphere.io.layout import frame_dataset

        now = self.snapshot
        fields = now.with_constants | now.own_fields
        return frame_dataset(self.mesh, fields, now.time, self.attributes(), now.own_attributes)

    def plot(self, field: str | None = None, ax: GeoAxes | None = None, **look: Any) -> GeoAxes:
        """Draw a field of the state on the globe; into `ax`, else into a new figure.

        field: h, surface, vorticity, speed, q_NAME, ...; None: what suits the scene.
        look: projection="robinson", winds="arrows", mesh=True, ...; see
        `swe_sphere.pictures.look.Look`.
        Raises ConfigError for an unknown field.
        """
        from swe_sphere.io.runfile import Frame
        from swe_sphere.pictures.look import Look
        from swe_sphere.pictures.plot import draw_state

        now = self.snapshot
        fields, about = now.with_constants | now.own_fields, now.own_attributes
        frame = Frame(self.mesh, fields, now.time, self.attributes(), about)
        return draw_state(frame, field, ax, validated(Look, look))

    def checkpoint(self, path: str | Path) -> Path:
        """Write all that `from_checkpoint` needs to resume from here bit for bit.

        An existing checkpoint is replaced, any other file is not.
        Raises RunFailed where the disk refuses, ConfigError for an existing file of another kind.
        """
        from swe_sphere.io.checkpoint import Checkpoint, is_checkpoint, write_checkpoint
        from swe_sphere.io.layout import plain

        self._begin_once()
        path = Path(path)
        arrays = dict(self.restart_arrays())
        time, name = self.stepper.dt * self.steps, self.config.stepper
        checkpoint = Checkpoint(arrays, time, self.steps, name, plain(self.attributes()))

        def write() -> None:
            if path.exists() and not is_checkpoint(path):
                raise ConfigError(
                    f"{path} is there already, and no checkpoint: choose another name"
                )
            with clear_errors(f"cannot write {path}", RunFailed):
                write_checkpoint(path, checkpoint)

        self.comm.on_root(write)
        return path

    def restart_arrays(self) -> Mapping[str, NDArray[np.generic]]:
        """Return the arrays of an exact restart, with the counters, which are carried along."""
        counters = {f"{restart.COUNTER}{name}": np.array(n) for name, n in self.counts().items()}
        return self.stepper.state_dict() | counters

    def __repr__(self) -> str:
        where = "not begun" if self._stepper is None else f"day {self.time / DAY:.4g}"
        return (
            f"Simulation({self.scene.name!r}, ne={self.mesh.ne}, np={self.mesh.np},"
            f" stepper={self.config.stepper!r}: {where} of {self.days:g} days)"
        )

    def _repr_html_(self) -> str:
        rows = [("scene", self.scene.title), ("result", "not begun")]
        if self._stepper is not None:
            try:
                rows = self.summary.rows()
            except RunFailed as error:
                rows[1] = ("why", str(error))
        return html_table(repr(self), rows)


def _begun(value: T | None) -> T:
    if value is None:
        raise ConfigError("the simulation has not begun: call begin(), step() or run() first")
    return value


def run(
    config: RunConfig, observers: Iterable[Observer] = (), warn: Warn = lambda text: None
) -> Summary:
    """Run a scene; the summary states how the run ended, also where it stopped early.

    observers: watch the run.  warn: called with each warning.  Raises ConfigError where the scene
    cannot be run as requested.
    """
    started = time.perf_counter()
    sim = Simulation(Setup(config))
    live = [] if config.live is None else [LiveView(config.live, sim.comm)]
    with ExitStack() as stack:
        out = config.out
        if out is None and config.plot is not None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.nc"
        summary = sim.run(
            out=out, overwrite=config.overwrite, callbacks=[*live, *observers], progress=False,
            warn=warn,
        )  # fmt: skip
        if out is not None and config.plot is not None:
            summary = sim.comm.on_root(partial(_plotted, summary, out, config.plot))
    asked = {"out": None if config.out is None else str(config.out)}
    total = {"total_seconds": time.perf_counter() - started}
    return replace(summary, numbers={**summary.numbers, **asked, **total})


def _plotted(summary: Summary, file: Path, picture: Path) -> Summary:
    """Draw the last frame; a picture that cannot be drawn leaves the file of the run as it is."""
    from swe_sphere.pictures.plot import plot_file  # matplotlib takes its time to import

    try:
        plot_file(file, out=picture)
    except Exception as error:  # also an unexpected error must not lose the numbers of the run
        clear = isinstance(error, SweError)
        why = str(error) if clear else f"cannot draw {picture}: {cause(error)}"
        status = summary.exit_status or RunFailed.exit_status
        return replace(summary, reason=summary.reason or in_one_line(why), exit_status=status)
    return summary
