"""One simulation: a scene on a mesh with a stepper, from its initial state to any later time."""

from __future__ import annotations

import gc
import math
import signal
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from functools import cache, cached_property, partial, wraps
from itertools import pairwise
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Self, TypeVar, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from swe_sphere import errors
from swe_sphere.arrays import Array
from swe_sphere.compiling import is_watched
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, Interrupted, RunFailed, SolverFailed, SweError, Unstable
from swe_sphere.files.durable import translate_errors
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.files.user_file import cause, check_trusted, users_code
from swe_sphere.io.integrals import Fields, tracer_masses
from swe_sphere.logs import LOGGER
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, HOUR
from swe_sphere.ranks.communicator import world
from swe_sphere.ranks.limits import command_began
from swe_sphere.simulation import build, diagnostics, planning, restart
from swe_sphere.simulation import observers as watchers
from swe_sphere.simulation.config import Keywords, Output, RunConfig, make_config
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, Diagnostic, Numbers, Snapshot
from swe_sphere.simulation.loop import Interruption, Loop
from swe_sphere.simulation.observers import Callback, Observer
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.simulation.restart import OF_ONE_RUN, Restart, lacks_end
from swe_sphere.simulation.summary import BREAKDOWNS, Summary, html_table, summary_of

if TYPE_CHECKING:
    import xarray as xr
    from cartopy.mpl.geoaxes import GeoAxes

    from swe_sphere.equations.effects import Effect
    from swe_sphere.io.reference_solution import Reference
    from swe_sphere.pictures.plot import Film
    from swe_sphere.steppers import Trajectory

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])
Warn = Callable[[str], None]

FAR = 1.05
"""A step longer than the stability limit by this factor causes a warning."""

_LOCK = RLock()
"""Lock of all simulations, because threads share what Warp records and compiles."""


def exclusive(method: F) -> F:
    """Let one thread at a time run the method; convert errors in user files to ConfigError."""

    @wraps(method)
    def locked(*args: Any, **kwargs: Any) -> Any:
        with _LOCK, users_code():
            return method(*args, **kwargs)

    return cast("F", locked)


class Simulation(errors.NotCopyable):
    """A scene, a mesh and a stepper, set up and stepped.

    Simulations in several threads of a process work one after the other, a whole run each.  A
    simulation cannot be copied or pickled: write and read a checkpoint.

    Args:
        scene: the name of a scene, the path of a .py or .toml file with one, or a `Scene`.
        config: all settings at once; only a `Scene` and a mesh may be given beside it.
        stepper: the name of a stepper, the path of a .py file with one, or a class.
        mesh: in the place of ne, np, stretch, centre_lon, centre_lat and spin.
        preconditioner: of an implicit stepper, by name, path or class.
        effects: parameters {"viscosity.nu": 1e5}, or effects to add.
        parameters: of the scene, {"alpha": 0.8}.
        options: of the stepper, {"tolerance": 1e-6}.
        resumed: the checkpoint to resume from, see `from_checkpoint`.
        initial: replaces the initial state of the scene: the file of a run or its dataset, on any
            mesh, of which initial_time [days] chooses the frame, or a function as `Scene.initial`.
        settings: further fields of `RunConfig`: ne, np, dt [s], days, every [h], precision, ...

    Examples:
        >>> from swe_sphere import Simulation
        >>> sim = Simulation("williamson2", ne=3, np=4, stepper="rk4", dt=1800)
        >>> summary = sim.run(days=1)
        >>> summary.status, summary["steps"], summary["l2_h"] < 1e-3
        ('completed', 48, True)
        >>> sim.step()
        >>> sim.time
        88200.0

    Raises ConfigError if the simulation cannot be set up as requested, in one line.
    """

    @exclusive
    def __init__(
        self, scene: str | Path | Scene, *, config: RunConfig | None = None, stepper: Any = None,
        mesh: Mesh | None = None, preconditioner: Any = None,
        effects: Mapping[str, object] | Iterable[Effect] | None = None,
        parameters: Mapping[str, object] | None = None, options: Mapping[str, object] | None = None,
        resumed: Restart | None = None, initial: Any = None, **settings: Unpack[Keywords],
    ) -> None:  # fmt: skip
        from swe_sphere.steppers import get_stepper

        given: dict[str, Any] = {
            "stepper": stepper, "preconditioner": preconditioner, "effects": effects,
            "parameters": parameters, "options": options, "initial": initial, **settings,
        }  # fmt: skip
        objects: dict[str, Any] = {}
        if config is None:
            config, objects = build.read_arguments(scene, mesh, **given)
        elif more := [name for name, value in given.items() if value is not None]:
            raise ConfigError(f"config holds all settings already: leave out {', '.join(more)}")
        elif isinstance(scene, str | Path) and str(scene) != config.scene:
            raise ConfigError(f"config is for the scene {config.scene}, not {scene}: change one")
        self._restart = resumed or restart.read_restart(config)
        config = config if self._restart is None else self._restart.adopt(config)
        self.config = self._configured = config
        """The configuration, with the arguments of the present run."""
        added = objects.pop("effects", ())
        self.stepper_class = get_stepper(objects.pop("stepper", config.stepper))
        self.scene = build.make_scene(config, scene if isinstance(scene, Scene) else None, added)
        self.initial: build.Initial | None = None
        """Replacement of the initial state of the scene, or None."""
        begun = objects.pop("initial", config.initial)
        if begun is not None or config.initial_time is not None:
            self.initial = build.Initial(begun, config.initial_time)
            self.scene = self.initial.begin(self.scene)
        self._objects = objects
        self.mesh = build.make_mesh(config, self.scene, mesh)
        begun = None if self.initial is None else self.initial.identity
        self.identity = {"initial": begun} | restart.identity(config, self.scene, self.mesh)
        """Settings that a run must share with this one to resume it."""
        self.sources = [*map(Path.resolve, restart.source_files(config, self.scene).values())]
        """Files of the scene, its data, diagnostics and custom methods."""
        if self._restart is not None:
            self._restart.check(self.identity)
        self.reference = _read_reference(config.reference)
        """The solution at the end of the run."""
        if config.days is not None:
            self._check_reference()
        for path in config.diagnostics:
            diagnostics.load_diagnostics(path)
        self.options = build.stepper_options(self.stepper_class, config)
        build.start_warp()
        from swe_sphere.equations.model import Model

        for known in (self.scene.exact, self.scene.exact_tracers):
            if known is not None:  # fails now, if at all, and not at the first error norms
                known(self.mesh.lon, self.mesh.lat, 0.0)
        launch, self.comm = (config.device, config.precision, config.launch), world()
        self.model = Model(self.mesh, self.scene, *launch, comm=self.comm)
        """The compiled right-hand side."""
        _ = self.model.limiter  # refused, if at all, before a file is written
        self._times = cache(partial(planning.limiting_times, self.model))  # by the length [days]
        self._limits: dict[float, float] = {}  # by the last of these times [s]
        self.warn: Warn = lambda text: None
        """Called with each warning of a run."""
        self.user_axes: dict[Diagnostic, tuple[int, list[tuple[Any, ...]]]] = {}
        """Number of axes of the first value of each custom diagnostic, and profile coordinates."""
        self.not_finite: set[Diagnostic] = set()
        """User-defined diagnostics that were not finite, of which there is one warning each."""
        self.signal_number: int | None = None  # number of the signal that came during the last run
        self.reset()

    @exclusive
    def reset(self) -> None:
        """Return to the initial state, or to the state of the checkpoint that was resumed."""
        earlier, self.config = self._restart, self._configured
        self._continues = self.config.restart  # the file, or checkpoint, that a run may continue
        self.run_id = "" if earlier is None else str(earlier.attributes.get("run_id", ""))
        """Identifier of the file of frames that was written last, or that a restart resumes."""
        self.outcome = Summary("not begun")
        """How the last run ended, without numbers."""
        self.wall_seconds = self.cpu_seconds = 0.0
        """Wall time, and CPU time of all threads, of steps without compiling and observing [s]."""
        self._plan: RunPlan | None = None
        self._stepper: Trajectory | None = None
        self._keeper: watchers.Keeper | None = None
        self.known_state: Array | None = None
        """The state (n,) at the end of the last run, or before a callback."""
        self._snapshot: Snapshot | None = None
        self._lengths: list[tuple[int, float, float]] = []
        """Lengths of steps so far [s], each with the number of steps and the time before it [s]."""
        self._counts_at_build = dict(self.model.counters)  # at the time when the stepper was built
        self._earlier_counts: Numbers = {}  # of earlier steppers and the run before a restart
        if earlier is not None and earlier.steps:
            self._plan = earlier.plan(self.config.dt)
            if self._plan.cycle > planning.tracer_cycle(self, self._plan.dt):
                raise ConfigError(f"{earlier.path} is damaged: steps_at_once={self._plan.cycle}")
            self._start_stepper()

    @classmethod
    def from_checkpoint(
        cls, path: str | Path, scene: Any = None, **settings: Unpack[Keywords]
    ) -> Self:
        """Resume from a checkpoint, or from the one beside the file of a run, bit for bit.

        scene: needed if it was given as an object.  settings: as of `Simulation`; stepper, mesh and
        effects are those of the earlier run. trust: a list of the files that the checkpoint may
        name as scene (.py or .toml), stepper, preconditioner or diagnostics; others are not run.

        Raises ConfigError if the file is missing, damaged, or of another run than requested.
        """
        resumed = Restart(Path(path))
        if scene is None:
            scene = str(resumed.table().get("scene"))
            trust = make_config({"scene": scene, "trust": settings.get("trust", ())}).trust
            check_trusted(scene, resumed.path, trust)
        return cls(scene, resumed=resumed, **settings)

    @property
    def days(self) -> float:
        """Length of the whole run [days], as configured or as the scene recommends."""
        return self.scene.days if self.config.days is None else self.config.days

    def _check_reference(self) -> None:
        """Raise ConfigError if the reference is of another time than the end of the run."""
        if self.reference is not None and not self.reference.is_at(self.days * DAY):
            day = f"{self.reference.times[-1] / DAY:g}"
            raise ConfigError(
                f"{self.config.reference} is of day {day}, the run ends at day {self.days:g}: take"
                f" days={day} or another reference"
            )

    @property
    @exclusive
    def initial_fields(self) -> Fields:
        """Return all fields of the initial state of the scene, each (N,)."""
        return Snapshot(self.model, self.model.initial_state(), 0.0).all_fields

    @exclusive
    def stable_dt(self) -> float:
        """Return the approximate stability limit at the initial state [s]; infinite without one.

        An unsteady wind counts at its strongest in the run. ConfigError if it is not a number.
        """
        strongest = (times := self.limiting_times())[-1]
        if strongest not in self._limits:
            counted = dict(self.model.counters)
            radii = planning.run_radii(self.stepper_class, self.model, times)
            self.model.counters.update(counted)  # the run does not count these evaluations
            self._limits[strongest] = planning.stability_limit(self.stepper_class, radii)
        return self._limits[strongest]

    def limiting_times(self) -> list[float]:
        """Return the times [s] that limit the steps of the run; see `planning.limiting_times`."""
        return self._times(self.days)

    @cached_property
    @exclusive
    def gravity_limit(self) -> float:
        """Stability limit of leapfrog [s]: 1 over the initial spectral radius of waves and wind."""
        radius = self.model.spectral_radii(self.model.initial_state()).wave
        return 1.0 / radius if radius > 0.0 else math.inf

    @exclusive
    def begin(self, plan: RunPlan | None = None, also: Sequence[float] = ()) -> None:
        """Plan the steps up to the end, and build the stepper unless it has taken some already.

        plan: the steps to take; by default those of the configuration.  also: further times [s]
        whose multiples fall on steps.  Raises ConfigError if step, length, frames and further
        times do not fit together, or an option of the stepper has the name of a diagnostic.
        """
        diagnostics.check_options(self.stepper_class.name, self.options)
        if plan is None and abs(self.days * DAY - self.time) <= 1e-6 and lacks_end(self.config):
            plan = replace(self.equal_steps, steps=self.steps)
        self._plan = planning.with_cycle(self, plan) if plan else planning.plan_run(self, also)
        if self._stepper is None or not self.steps:
            self._start_stepper()

    def _start_stepper(self) -> None:
        """Build the stepper of the plan, at the state of the checkpoint or the initial state."""
        earlier, plan = self._restart, self.plan
        lengths = [(0, 0.0, plan.dt)] if earlier is None else earlier.lengths(plan.dt)
        stepper, self._lengths = self._make_stepper(lengths[-1][-1], plan.cycle), lengths
        if earlier is None:
            stepper.start(self.model.initial_state())
        else:
            self._earlier_counts = earlier.counts
            earlier.load_into(stepper, self._earlier_steps)

    def _make_stepper(self, dt: float, cycle: int) -> Trajectory:
        """Build the present stepper with steps of dt [s], of which `cycle` are taken together."""
        from swe_sphere.steppers.adaptive import AdaptiveSteps
        from swe_sphere.steppers.tracer_steps import CarriedTracers, CarriedWithDepth

        model, make, options = self.model, self.stepper_class, self.options | self._objects
        stepper: Trajectory
        if cycle == 1:
            stepper = single = make(model, dt, **options)
            if self.config.adaptive is not None:
                stepper = AdaptiveSteps(single, self.config.adaptive)
        elif self.scene.wind is None:
            stepper = CarriedTracers(model, make(model.flux_model, dt, **options), cycle)
        else:
            stepper = CarriedWithDepth(model, make, dt, cycle)
        self._stepper, self._snapshot = stepper, None
        self._counts_at_build = dict(model.counters)
        return stepper

    def fit_step(self) -> None:
        """Build a new stepper if the plan states another length for the next step."""
        old, dt, cycle = self.stepper, self.plan.length(self.steps), self.plan.cycle
        if (old.dt, old.cycle) == (dt, cycle):
            return
        steps, now, spent = self.steps, self.time, self.counts()
        spent["wall_seconds"] -= self.wall_seconds
        self.model.launch.forget()  # recorded commands reference the arrays of the old stepper
        gc.collect()  # steppers before this one, whose parts reference each other
        self._make_stepper(dt, cycle).follow(old, now)
        self._earlier_counts = spent
        self._lengths.append((steps, now, dt))

    def accept_since(self) -> None:
        """Accept changes of the state since `known_state` was stored, if it is."""
        self.release()
        if self.known_state is not None:
            self.accept_changes(self.known_state)
            self.known_state = self.stepper.state.numpy().copy()

    def accept_changes(self, before: Array | None = None) -> None:
        """Accept changes of the stepper's state: a stepper with more memory starts again from it.

        Needed before or after a `step`, not between runs. before: state (n,) before any change.
        """
        stepper, now = self.stepper, self.time
        self.release()  # its fields may be those before a change
        remembers = {*stepper.restart_arrays(), *stepper.numbers()} != {"state", "origin"}
        same = before is not None and np.array_equal(before, stepper.state.numpy())
        if not any(self.comm.allgather_number(not same)):
            return
        if remembers:
            self._lengths.append((self.steps, now, stepper.dt))
            stepper.start(stepper.state, now)
        else:  # as a restart does
            stepper.load_numbers(stepper.numbers(), stepper.steps)

    @property
    def _earlier_steps(self) -> int:
        """Number of steps before the stepper was built or last started."""
        return self._lengths[-1][0]

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
        return 0 if self._stepper is None else self._earlier_steps + self._stepper.steps

    @property
    def equal_steps(self) -> RunPlan:
        """The plan with equal steps: those of the stepper, or prescribed ones if these differ."""
        stepper, plan = self.stepper, replace(self.plan, lead_dt=0.0, tail_steps=0)
        if self.config.dt != "auto" and stepper.dt != plan.dt:
            return replace(plan, lead_steps=self.steps, origin=self.time)
        plan = replace(plan, dt=stepper.dt, cycle=stepper.cycle)
        return replace(plan, lead_steps=self._earlier_steps, origin=stepper.origin)

    @property
    def time(self) -> float:
        """Simulated time since the start of the run [s], to the microsecond."""
        return 0.0 if self._stepper is None else round(self._stepper.time, 6)

    @exclusive
    def step(self) -> None:
        """Take one step, or the steps of one tracer step; RunFailed if they cannot be taken."""
        self._begin_once()
        self.known_state = None
        self.release()
        self.fit_step()
        self.take(1)

    def take(self, most: int) -> None:
        """Take a step, those of one tracer step, or up to `most` that are faster together."""
        try:
            self.stepper.take(most)
        except (SolverFailed, *BREAKDOWNS) as error:
            if isinstance(error, SolverFailed) or self.comm.size == 1:  # all ranks are here
                watchers.check_finite(self)
            raise

    def _begin_once(self) -> None:
        if self._stepper is None:
            self.begin()
            self.stable_dt()

    @exclusive
    def run_plan(
        self, observers: Sequence[Observer] = (), time_limit: float | None = None,
        interruption: Interruption | None = None, since: float | None = None,
    ) -> Summary:  # fmt: skip
        """Step to the end of the plan, or until a failure; return how it ended, without numbers.

        observers: see states when due; those with `sees_end` also the last one. time_limit: wall
        time [s] since a time of time.monotonic; if since is None, that of steps without compiling.
        interruption: that of several simulations, entered; a signal raises Interrupted.
        """
        self.outcome, noted = Summary("running"), interruption or Interruption()
        with ExitStack() as stack:  # each observer ends if it has begun
            try:
                self.accept_since()
                self.known_state, before = None, self.stepper.state.numpy().copy()
                for observer in observers:
                    watchers.notify(observer, "begin", self.plan, self.snapshot)
                    stack.callback(self._end, observer)
                self.accept_changes(before)
                _ = self.snapshot.user_values  # custom diagnostics fail here, if at all
                with users_code(), nullcontext() if interruption else noted:
                    Loop(self, observers, time_limit, noted, since).step_to_end()
                _ = self.diagnostics  # one that fails ends the run like other errors
                self.outcome = Summary()
            except (Interrupted, SweError, *BREAKDOWNS) as error:
                if interruption is not None and isinstance(error, Interrupted):
                    raise
                # before the observers end, for which all ranks may be needed
                self._ended_by(error)
        self.signal_number, stepper = noted.number, self._stepper
        self.known_state = None if stepper is None else stepper.state.numpy().copy()
        return self.outcome

    def _end(self, observer: Observer) -> None:
        try:
            watchers.notify(observer, "end")
        except (SweError, *BREAKDOWNS) as error:
            if (ended := self.outcome).completed:
                self._ended_by(error)
            else:
                status = "failed" if ended.is_sound else ended.status
                reason = f"{ended.reason}; {errors.in_one_line(error)}"
                self.outcome = replace(ended, status=status, reason=reason, exit_status=1)

    def _ended_by(self, error: Exception) -> None:
        self.outcome = summary_of(error, self.time)
        self.comm.agree_to_fail(self.outcome.reason or "")

    @exclusive
    def run(
        self, days: float | None = None, *, out: str | Path | None = None,
        every: float | None = None, outputs: Sequence[Output] | None = None,
        callbacks: Iterable[Any] = (), time_limit: float | None = None, overwrite: bool = False,
        keep: bool = False, progress: bool | None = None, warn: Warn | None = None,
        raises: bool = True,
    ) -> Summary:  # fmt: skip
        """Step to the end of the run, or until it fails or is stopped.

        Args:
            days: length of the run from its start [days].
            out: a file for frames, series of diagnostics and checkpoints; the file that this
                simulation wrote last is continued.
            every: time between frames [h].
            outputs: further files, by default those of the last run, which they continue.
            callbacks: functions of the simulation, called after every step or when `every` says;
                or observers.
            time_limit: wall time from this call [s], compiling and writing included; within the
                command, from the start of the process.
            overwrite: replace existing files; a run that has reached its end begins again.
            keep: keep the frames in memory, as `frames`.
            progress: whether to show a bar; None: in a notebook or on a terminal.
            warn: called with each warning; None: `warnings.warn`.
            raises: whether a signal that ended the run takes effect after it.

        Returns:
            The numbers of the run, also where it stopped early: see `Summary.status` and `reason`.

        Raises:
            ConfigError: the run is impossible as requested; no step was taken.
            KeyboardInterrupt: Ctrl-C; the last frame is written. Other signals take effect, too.
        """
        since = command_began.get(time.monotonic())
        asked: dict[str, Any] = {"days": days, "every": every, "time_limit": time_limit, "out": out}
        continues = self._continues if self._continues and self._continues.exists() else None
        asked |= {"overwrite": overwrite or None, "restart": continues, "outputs": outputs}
        asked = {name: value for name, value in asked.items() if value is not None}
        kept = {k: v for k, v in self._configured.given().items() if k not in OF_ONE_RUN}
        kept["outputs"] = self.config.outputs
        config = make_config(kept | asked)
        if not isinstance(callbacks, Iterable):
            raise ConfigError(f"callbacks: give a list of functions, got {callbacks!r}")
        observers = [each if isinstance(each, Observer) else Callback(each) for each in callbacks]
        self.comm.on_root(lambda: restart.check_paths(config, self.sources))
        days = self.scene.days if config.days is None else config.days
        if overwrite and self.steps and days * DAY <= self.time + 1e-6:
            self.reset()
        calls = [each for each in observers if isinstance(each, Callback)]
        times = [output.every * HOUR for output in config.outputs if output.every]
        with ExitStack() as refused:  # a refused run leaves the configuration as it was
            refused.callback(setattr, self, "config", self.config)
            self.config = config
            self._check_reference()
            self.begin(also=[*times, *(call.seconds for call in calls if call.seconds)])
            for call in calls:
                call.check(self.plan)
            if self.comm.rank == 0 and (is_watched() if progress is None else progress):
                observers.append(watchers.ProgressBar())
            self.warn = warn or self._warn
            self._warn_of_run()
            steps = self.plan.steps - self.steps
            LOGGER.debug("%r begins: %d steps of %.6g s", self, steps, self.plan.dt)
            self.release()  # the state may have been changed since
            self._keeper = watchers.Keeper() if keep else None
            if self._keeper is not None:
                observers.append(self._keeper)
            try:
                files = self._open_files()
            except (RunFailed, *BREAKDOWNS) as error:
                files = None
                self._ended_by(error)
            refused.pop_all()
        if files is not None:
            self.run_plan([*files, *observers], config.time_limit, since=since)
            LOGGER.debug("%r ends: %s", self, self.outcome.reason or self.outcome.status)
            if self.signal_number is not None and raises:
                signal.raise_signal(self.signal_number)
        return self.summary

    def _open_files(self) -> list[watchers.Recorder]:
        """Open the files of the run and write their first frames; close all if one of them fails.

        Raises the errors of `Recorder`, and Unstable for a state that must not be written.
        """
        config, out, files = self.config, self.config.out, list[watchers.Recorder]()
        wanted: list[Output | None] = [*([None] if out else []), *config.outputs]
        if self.steps and wanted:
            # no spoilt state replaces the last good one
            watchers.HealthCheck(self).observe(self.snapshot)
        if out and config.overwrite and self.steps and self._continues == out.resolve():
            self.warn(
                f"out: {out} is replaced and begins at day {self.time / DAY:.4g}: leave overwrite"
                " out to continue the file, or call reset() before run()"
            )
        with ExitStack() as opened:
            for output in wanted:
                files.append(watchers.Recorder(self, output))
                opened.callback(files[-1].close)
            for file in files:
                file.write_first()
            opened.pop_all()
        if out:
            self._continues = out.resolve()
        return files

    def _warn(self, text: str) -> None:
        if self.comm.rank == 0:
            LOGGER.warning(text)
            warnings.warn(text, stacklevel=5)

    def _warn_of_run(self) -> None:
        """Warn of a restart by other code or without diagnostics, long steps, and modes."""
        resumed, dt, limit = self._restart, self.plan.dt, self.stable_dt()
        if resumed is not None and resumed.attributes.get("code") != code_fingerprint():
            self.warn(
                f"{resumed.path} was written by other code of swe_sphere: the run resumes"
                " from it, but its last bits are not those of a run by either code alone"
            )
        if resumed is not None and (lost := sorted(resumed.diagnostics - DIAGNOSTICS.keys())):
            self.warn(
                f"the run in {resumed.path} has diagnostics that are not computed any more:"
                f" {', '.join(lost)}; give the files of all diagnostics (--diagnostics)"
            )
        if dt > FAR * limit:
            self.warn(
                f"dt = {dt:.6g} s is {dt / limit:.3g} times the stability limit of"
                f" {self.config.stepper}, {limit:.4g} s: expect the run to become unstable"
            )
        if self.days * DAY > (growth := self.model.growth_time):
            self.warn(
                f"{self.scene.name} has no dissipation: computational modes grow tenfold in about"
                f" {growth / DAY:.2g} days; damp them by --set edge-penalty.c=default"
            )

    @property
    @exclusive
    def snapshot(self) -> Snapshot:
        """The present state, with its fields as arrays (N,)."""
        known, alone = self._snapshot, not self.comm.shared
        if known is None or known.steps != self.steps or (alone and not known.is_current()):
            state = self.model.initial_state() if self._stepper is None else self._stepper.state
            live = self._stepper is not None
            known = self._snapshot = Snapshot(self.model, state, self.time, self.steps, self, live)
        return known

    def release(self) -> None:
        """Drop the snapshot, whose fields occupy memory while steps are taken."""
        self._snapshot = None

    @property
    def present_dt(self) -> float | None:
        """Present step [s], which follows its error in an adaptive run; None before `begin`."""
        stepper = self._stepper
        return None if stepper is None else float(getattr(stepper, "next_dt", stepper.dt))

    @cached_property
    @exclusive
    def initial_numbers(self) -> tuple[Numbers, Numbers]:
        """Integrals, and masses of tracers, of the initial state: drifts are relative to them."""
        start = self.initial_fields
        masses = tracer_masses(self.mesh, start, self.scene.tracers or ())
        return diagnostics.state_integrals(self.model, start), masses

    @property
    @exclusive
    def diagnostics(self) -> Numbers:
        """Return all numbers of the state: integrals, drifts, Courant numbers, errors, and others.

        Raises RunFailed if a user-defined diagnostic fails.
        """
        return self.snapshot.diagnostics

    def counts(self) -> Numbers:
        """Return counters and seconds of the run, with those before a restart."""
        counted, now = self._counts_at_build, self.model.counters
        counts: Numbers = {name: n - counted.get(name, 0) for name, n in now.items()}
        counts["wall_seconds"] = self.wall_seconds
        return {name: n + self._earlier_counts.get(name, 0) for name, n in counts.items()}

    @property
    @exclusive
    def summary(self) -> Summary:
        """The numbers of the state, and how the last run ended."""
        outcome, names = self.outcome, ("scene", "ne", "np", "stretch", "precision", "effects")
        numbers = {name: self.identity[name] for name in names} | self._method() | self.options
        numbers |= {
            "steps": self.steps, "days": self.time / DAY, "days_planned": self.days,
            "dt_wanted": self._plan and self._plan.wanted_dt,
            "out": None if self.config.out is None else str(self.config.out),
            "outputs": [str(output.path) for output in self.config.outputs] or None,
            "compile_seconds": self.model.launch.compile_seconds, "ranks": self.comm.size,
            "earlier_seconds": self._earlier_counts.get("wall_seconds", 0.0),
        }  # fmt: skip
        numbers |= {**dict.fromkeys(diagnostics.NAMES["costs"], 0), **self.counts()}
        if outcome.is_sound:
            numbers |= self.diagnostics
        if outcome.completed:
            shipped = None if self.initial else build.shipped_solution(self.scene, self.time / DAY)
            reference = self.reference or _read_reference(shipped)
            if reference is not None and reference.is_at(self.time):
                numbers |= diagnostics.reference_errors(reference, self.snapshot)
                numbers["reference"] = reference.path.name
        if (cuts := getattr(self._stepper, "cuts", None)) is not None:
            numbers["cuts"] = list(cuts)
        if changes := [(dt, t) for (*_, old), (_, t, dt) in pairwise(self._lengths) if dt != old]:
            numbers["step_changes"] = [f"{dt:.6g} s from day {t / DAY:.6g} on" for dt, t in changes]
        return replace(outcome, numbers=numbers)

    def _method(self) -> dict[str, object]:
        """Return how the scene is stepped, and on what; values of a plan are None without one."""
        plan = self._plan
        return {
            "title": self.scene.title, "stepper": self.config.stepper,
            "scheme": self.stepper_class.name if self._stepper is None else self._stepper.name,
            "dt": plan and plan.dt, "steps_at_once": plan and plan.cycle,
            "dt_rule": plan and plan.rule, "stable_dt": plan and self.stable_dt(),
            "device": self.model.device, "launch": self.model.shape,
        }  # fmt: skip

    def attributes(self, fields: Sequence[str] = ()) -> dict[str, object]:
        """Return the resolved configuration: the attributes of a file with some or all fields."""
        begun, known = self.initial, self.identity | self._method()
        if begun is not None:
            known |= {name: getattr(begun, name) for name in ("origin", "history", "time_offset")}
        return {
            "references": self.scene.reference,
            **{name: value for name, value in known.items() if value is not None},
            "identity": self.identity, "code": code_fingerprint(),
            "configuration": self.config.model_dump(mode="json"), "stepper_options": self.options,
            "days": self.days, "start_step": self.steps,
            "user_diagnostics": {name: one.long_name for name, one in DIAGNOSTICS.items()},
            **self._plot_field(fields),
        }  # fmt: skip

    def _plot_field(self, fields: Sequence[str]) -> dict[str, str]:
        """Return what a picture shows by default: the first tracer where the wind is prescribed.

        A file that lacks that field, or else depth, shows the first of its fields.
        """
        carried = None if self.scene.wind is None else self.scene.tracers
        usual = f"q_{next(iter(carried))}" if carried else "h"
        if fields and usual not in fields:
            return {"plot_field": fields[0]}
        return {"plot_field": usual} if carried else {}

    @property
    def state(self) -> xr.Dataset:
        """Depth, wind, vorticity, divergence and tracers on the nodes (N,), with their units."""
        return self.to_xarray().isel(time=0)

    @exclusive
    def to_xarray(self) -> xr.Dataset:
        """Return the state as a frame of a file: fields on (time, node), points, areas, bottom."""
        from swe_sphere.analysis import accessor  # noqa: F401 - registers `ds.swe`
        from swe_sphere.io.layout import frame_dataset, frame_fields

        now = self.snapshot
        known = frame_fields(self.scene.tracers or ())
        known |= {name: now.about[name] for name in now.user_fields}
        fields = now.all_fields | now.user_fields
        return frame_dataset(self.mesh, fields, now.time, self.attributes(), known)

    @property
    def frames(self) -> xr.Dataset:
        """Frames of the last run, as `run(keep=True)` kept them, or else from its file.

        Raises ConfigError where the last run has neither.
        """
        import xarray as xr

        from swe_sphere.analysis.accessor import open_run

        if self._keeper is not None and self._keeper.frames:
            same: Any = {"data_vars": "minimal", "coords": "minimal", "compat": "override"}
            kept = [*self._keeper.frames.values()]
            return cast(xr.Dataset, xr.concat(kept, "time", combine_attrs="override", **same))
        if self.config.out is None:
            raise ConfigError("the last run kept no frames: call run(keep=True) or run(out=...)")
        return open_run(self.config.out)

    def animate(self, field: str | None = None, **options: Any) -> Film:
        """Draw all `frames` as a film, which a notebook shows; options: as in `ds.swe.animate`."""
        return cast("Film", self.frames.swe.animate(field, **options))

    @exclusive
    def plot(self, field: str | None = None, ax: GeoAxes | None = None, **look: Any) -> GeoAxes:
        """Draw a field of the state on the globe; into `ax`, else into a new figure.

        field: h, surface, vorticity, speed, q_NAME, ...; None: the default of the scene.
        look: projection="robinson", winds="arrows", mesh=True, ...; see
        `swe_sphere.pictures.look.Look`.
        Raises ConfigError for an unknown field.
        """
        return self.to_xarray().swe.plot(field, ax=ax, **look)

    @exclusive
    def checkpoint(self, path: str | Path) -> Path:
        """Write all that `from_checkpoint` needs to resume from here bit for bit.

        An existing checkpoint is replaced, any other file is not. Raises RunFailed if the disk
        fails or the state is unstable, ConfigError for an existing file of another kind.
        """
        from swe_sphere.io.checkpoint import Checkpoint, is_checkpoint, write_checkpoint
        from swe_sphere.io.layout import plain

        self._begin_once()
        self.accept_since()
        watchers.HealthCheck(self).observe(self.snapshot)
        path = Path(path)
        attributes = self.attributes() | ({"run_id": self.run_id} if self.run_id else {})
        checkpoint = Checkpoint(dict(self.restart_arrays()), self.steps, plain(attributes))

        def write() -> None:
            with translate_errors(f"cannot write {path}", RunFailed):
                if path.exists() and not is_checkpoint(path):
                    raise ConfigError(f"{path} exists and is not a checkpoint: choose another name")
                write_checkpoint(path, checkpoint)

        self.comm.on_root(write)
        return path

    def restart_arrays(self) -> Mapping[str, NDArray[np.generic]]:
        """Return the arrays of an exact restart, with the counters, which are carried along.

        Raises Unstable if an array of the stepper is not finite: a restart would refuse it.
        """
        arrays = self.stepper.state_dict()
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise Unstable(
                    f"the array {name} of stepper {self.stepper_class.name} is not finite at day"
                    f" {self.time / DAY:.4g} (step {self.steps}): take a smaller dt"
                )
        counters = {f"{restart.COUNTER}{name}": np.array(n) for name, n in self.counts().items()}
        return arrays | counters | {restart.LENGTHS: np.array(self._lengths)}

    def __repr__(self) -> str:
        where = "not begun" if self._stepper is None else f"day {self.time / DAY:.4g}"
        return (
            f"Simulation({self.scene.name!r}, ne={self.mesh.ne}, np={self.mesh.np},"
            f" stepper={self.config.stepper!r}: {where} of"
            f" {max(self.days, self.time / DAY):.4g} days)"
        )

    def _repr_html_(self) -> str:
        rows = [("scene", self.scene.title), ("result", "not begun")]
        if self._stepper is not None:
            try:
                rows = self.summary.all_rows()
            except RunFailed as error:
                rows[1] = ("why", str(error))
        return html_table(repr(self), rows)


def _read_reference(path: Path | None) -> Reference | None:
    if path is None:
        return None
    from swe_sphere.io.reference_solution import Reference  # imports Warp

    reference = Reference(path)
    if not reference.fields.keys() & {"h", "surface"}:
        raise ConfigError(f"reference: {path} holds neither h nor surface: take another file")
    return reference


def _begun(value: T | None) -> T:
    if value is None:
        raise ConfigError("the simulation has not begun: call begin(), step() or run() first")
    return value


def run_scene(
    config: RunConfig, observers: Iterable[Observer] = (), warn: Warn = lambda text: None,
    more: bool = False,
) -> Summary:  # fmt: skip
    """Run a scene; the summary states how the run ended, also where it stopped early.

    observers: watch the run.  warn: called with each warning.  more: True if other runs follow,
    so that a signal in the last step raises Interrupted.  ConfigError if it cannot be run.
    """
    started = time.perf_counter()
    world().on_root(lambda: restart.check_paths(config))
    if config.overwrite and restart.appends(config.model_copy(update={"overwrite": False})):
        raise ConfigError("overwrite: the run resumes in its file: leave overwrite out")
    if config.fields and config.out is None and config.plot is None:
        raise ConfigError("fields: the run writes no file: give out, the name of one")
    sim = Simulation(config.scene, config=config)
    world().on_root(lambda: restart.check_paths(config, sim.sources))
    live = [] if config.live is None else [watchers.live_view(config.live, sim.comm)]
    with ExitStack() as stack:
        out = config.out
        if out is None and config.plot is not None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.nc"
        summary = sim.run(
            out=out, overwrite=config.overwrite, callbacks=[*live, *observers], progress=False,
            warn=warn, raises=False,
        )  # fmt: skip
        if more and summary.completed and sim.signal_number is not None:
            raise Interrupted(f"interrupted by {signal.Signals(sim.signal_number).name}")
        if out is not None and config.plot is not None:
            picture = partial(_plotted, summary, out, config.plot, config.overwrite)
            summary = sim.comm.on_root(picture)
    own = {"out": config.out and str(config.out), "total_seconds": time.perf_counter() - started}
    return replace(summary, numbers={**summary.numbers, **own})


def _plotted(summary: Summary, file: Path, picture: Path, overwrite: bool) -> Summary:
    """Draw the last frame; a picture that cannot be drawn leaves the file of the run as it is."""
    from swe_sphere.pictures.plot import plot_file  # matplotlib takes its time to import

    try:
        plot_file(file, out=picture, overwrite=overwrite)
    except Exception as error:  # also an unexpected error must not lose the numbers of the run
        clear = isinstance(error, SweError)
        why = str(error) if clear else f"cannot draw {picture}: {cause(error)}"
        status = summary.exit_status or RunFailed.exit_status
        reason = summary.reason or errors.in_one_line(why)
        return replace(summary, reason=reason, exit_status=status)
    return summary
