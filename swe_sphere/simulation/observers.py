"""Observers of a run: checks, frames and series, progress, callbacks, pictures.

All of them are an `Observer`, which sees snapshots of the state. Only callbacks and custom
observers may change the state, which is then checked again.
"""

import logging
import math
import time
import uuid
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from inspect import isasyncgenfunction, iscoroutinefunction, isgeneratorfunction
from numbers import Real
from typing import Any

import numpy as np

from swe_sphere.equations.effects import PointwiseEffect
from swe_sphere.errors import ConfigError, RunFailed, Unstable
from swe_sphere.files.user_file import is_custom
from swe_sphere.logs import LOGGER
from swe_sphere.mesh import Interpolator
from swe_sphere.planet import DAY, HOUR
from swe_sphere.simulation.config import Output
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, Snapshot, call_in_run
from swe_sphere.simulation.planning import RunPlan, meant_hours
from swe_sphere.simulation.restart import appends, holds_run

Function = Callable[..., Any]


class Observer:
    """Watches a run; a subclass defines the methods that it needs.  RunFailed ends the run."""

    sees_end = True
    """True if it sees the state at the end of the plan even where that is not due."""

    def begin(self, plan: RunPlan, snapshot: Snapshot) -> None:
        """Prepare for the steps of the plan, which begin at the state of the snapshot."""

    def due(self, step: int) -> bool:
        """Return whether to observe the state after that many steps."""
        return False

    def observe(self, snapshot: Snapshot) -> None:
        """Inspect a state that is due, or the last one."""

    def tick(self, step: int) -> None:
        """Receive the number of steps so far; called about ten times a second."""

    def end(self) -> None:
        """Finish; called after the last step, also if the run stopped early."""


def notify(observer: Observer, method: str, *arguments: Any) -> Any:
    """Call a method of an observer; errors of a user-defined one end the run in one line."""
    call = getattr(observer, method)
    if not is_custom(type(observer)):
        return call(*arguments)
    return call_in_run(label(observer), call, *arguments)


def label(observer: Observer) -> str:
    """Return the name of an observer for messages."""
    if isinstance(observer, Callback):
        function = observer.function
        return f"the callback {getattr(function, '__name__', type(function).__name__)}"
    return f"the observer {type(observer).__name__}"


CHECK_STEPS, MOST_FORCING_TIMES = 16, 1000
"""Steps between health checks, and largest number of times at which a check sees a forcing."""
RUNAWAY = 10.0
"""Growth of the energy that effects do not explain, and that every unstable run exceeds."""
DEFERRED = isgeneratorfunction, iscoroutinefunction, isasyncgenfunction
"""Tests for functions of which a call runs no code."""
LOST_MASS = 1e-3
"""Relative change of the total mass that no method causes where all effects conserve it."""
MASS_ROUNDING = {"float64": 1e-9, "float32": 1e-3}
"""Relative change of the total mass in a day that may be rounding, by precision."""


class HealthCheck(Observer):
    """Ends a run whose state is NaN, has no depth, or has energy or mass that no effect explains.

    It computes sums on the device of the state, and copies no field.  sim: the simulation.
    """

    def __init__(self, sim: Any) -> None:
        from swe_sphere.steppers.stage_solver import energy_space  # imports Warp

        self._sim, model, scene = sim, sim.model, sim.scene
        mesh, self._space = model.device_mesh, energy_space(model)
        first = model.names.index("h") * mesh.size
        self._depth = first, first + mesh.size
        start, self._unit_depth = model.initial_state(), model.zeros()
        self._unit_depth[first : first + mesh.size].fill_(1.0)
        self._mass = self._space.dot(start, self._unit_depth)
        conserving = [e for e in scene.effects if "mass" in e.conserves]
        self._conserves = len(conserving) == len(scene.effects) and scene.forcing is None
        custom = [effect for effect in scene.effects if is_custom(type(effect))]
        pointwise = [e for e in custom if isinstance(e, PointwiseEffect) and e in conserving]
        self._claims = [e.name for e in pointwise if e.tendencies[1] is not None]
        self._tendency = model.right_hand_side(counted=False) if self._claims else None
        self._rate, self._force = model.zeros(), model.zeros()
        self._expected_norm = self._space.norm(start)
        """Norm [m s-1], the root of the energy, to which the growth of later states is relative."""
        self._mass_scale = self._space.norm(self._unit_depth) * self._expected_norm
        if scene.equilibrium is not None:
            level = scene.equilibrium(model.mesh.lon, model.mesh.lat)
            rest = model.state_from(0.0 * level, 0.0 * level, level)
            self._expected_norm += self._space.norm(rest)
        self._growth = sim.config.energy_growth or (math.inf if custom else RUNAWAY)
        self._time = 0.0

    def due(self, step: int) -> bool:
        return bool(step % CHECK_STEPS < self._sim.plan.cycle)

    def observe(self, snapshot: Snapshot, changed_by: Observer | None = None) -> None:
        """Raise Unstable for an unstable state, RunFailed if an effect changes a conserved mass.

        changed_by: the observer after which the state is checked again.
        """
        import warp as wp

        model, state, time = snapshot.model, snapshot.state, snapshot.time
        norm, self._changed_by = self._space.norm(state), changed_by
        if not math.isfinite(norm):
            raise self._unstable(f"the solution is NaN{spoilt_fields(model, state)}", snapshot)
        # h may undershoot zero without harm if it is passive or the wave is linear
        harmless = model.scene.linear or model.scene.wind is not None
        if not harmless and (depth := self._space.lowest(state, *self._depth)) <= 0.0:
            raise self._unstable(f"the depth is not positive ({depth:.3g} m)", snapshot)
        if model.scene.forcing is not None:
            # of the run so far, maybe resumed
            whole = min(MOST_FORCING_TIMES, 1 + snapshot.steps // 4)
            parts = 1 if model.forcing.steady else 4 if self._time else whole
            span = (time - self._time) / parts
            for t in self._time + span * (0.5 + np.arange(parts)):
                model.forcing.set_time(t)
                wp.copy(self._force, model.parameters["forcing"])
                self._expected_norm += span * self._space.norm(self._force)
            model.forcing.set_time(time)
            self._time = time
        growth = (norm / self._expected_norm) ** 2
        if growth > self._growth:
            raise self._unstable(f"the energy has grown {growth:.3g} times", snapshot)
        if self._tendency is not None:
            self._tendency(state, time, self._rate)
            change = DAY * abs(self._space.dot(self._rate, self._unit_depth)) / self._mass_scale
            if change > MASS_ROUNDING[model.precision]:
                raise RunFailed(
                    f"the effect {' or '.join(self._claims)} changes the total mass by"
                    f" {100.0 * change:.3g} % a day at day {time / DAY:.4g}, but its `conserves`"
                    ' contains "mass": leave it out, as implicit steppers restore that mass'
                )
        lost = abs(self._space.dot(state, self._unit_depth) - self._mass) / self._mass_scale
        if self._conserves and lost > LOST_MASS:
            raise self._unstable(f"the total mass has changed by {100.0 * lost:.3g} %", snapshot)

    def _unstable(self, failure: str, snapshot: Snapshot) -> Unstable:
        failure = f"{failure} at day {snapshot.time / DAY:.4g} (step {snapshot.steps})"
        if self._changed_by is not None:
            return Unstable(f"{failure}: {label(self._changed_by)} has changed the state")
        dt, limit = self._sim.plan.dt, self._sim.stable_dt()
        bound = "no stability limit" if limit == math.inf else f"stability limit {limit:.4g} s"
        advice = "take a smaller dt"
        if dt <= limit:
            advice = "try a finer mesh, a smaller dt or more dissipation (edge-penalty.c=default)"
        if not self._sim.scene.unsteady_wind:
            bound += " at the initial state"
        return Unstable(f"{failure}: dt = {dt:.6g} s, {bound}; {advice}")


def spoilt_fields(model: Any, array: Any) -> str:
    """Return " in " and the names of the blocks of a state with NaN or infinity, if any."""
    blocks = model.device_mesh.collect(array).reshape(len(model.names), -1)
    spoilt = [n for n, x in zip(model.names, blocks, strict=True) if not np.isfinite(x).all()]
    return f" in {', '.join(spoilt)}" if spoilt else ""


def check_finite(sim: Any) -> None:
    """Raise Unstable if the state of the stepper, or its rate of change, is not finite."""
    model, state, rate = sim.model, sim.stepper.state, sim.model.zeros()
    model.right_hand_side(counted=False)(state, sim.time, rate)
    for what, array in ("solution", state), ("rate of change of the solution", rate):
        if spoilt := spoilt_fields(model, array):
            raise Unstable(
                f"the {what} is NaN{spoilt} at day {sim.time / DAY:.4g} (step {sim.steps}): correct"
                f" custom code, or take a smaller dt than {sim.stepper.dt:.6g} s"
            )


SAMPLES = 200
"""Approximate number of samples of the diagnostics in a run."""


class Recorder(Observer):
    """Writes a file of a simulation, on rank 0: frames, from the present state on.

    output: a further file of the run; None: the file `out`, with series of diagnostics and
    checkpoints.  Raises ConfigError if the file cannot be created or belongs to another run;
    RunFailed, also from the methods, if the disk is full or fails.
    """

    def __init__(self, sim: Any, output: Output | None = None) -> None:
        self.sim: Any = sim
        self.plan: RunPlan = sim.plan
        self._output = output
        self.sees_end = output is None
        self._framed: int | None = None  # steps before the last frame
        self._sampled: int | None = None  # steps before the last sample
        _ = sim.snapshot.user_values  # on all ranks, before rank 0 needs it
        sim.run_id = sim.comm.on_root(self._open)

    def _open(self) -> str:
        """Create the file and return the identifier of its run, which a resumed run keeps."""
        from swe_sphere.io.netcdf import FrameWriter  # scipy.io is slow to import
        from swe_sphere.io.runfile import TIME_TOLERANCE, RunFile

        sim, plan, output, config = self.sim, self.plan, self._output, self.sim.config
        transform, ahead = None, plan.steps - sim.steps
        due = ahead // plan.frame_steps + ahead // plan.interval(SAMPLES)
        if output is None:
            path, only, continues = config.out, config.fields, appends(config)
        else:
            path, only = output.path, output.fields
            ours = sim.steps > 0 and holds_run(path, sim.run_id)
            continues = path.exists() and (ours or not config.overwrite)
            branches = ours and config.restart is not None and not appends(config)
            if branches and RunFile(path).times.max() > sim.time + TIME_TOLERANCE:
                raise ConfigError(
                    f"output: {path} has later frames of the resumed run: give other outputs"
                )
            if output.grid is not None:
                from swe_sphere.analysis.regrid import on_grid, parse_grid

                grid = parse_grid(output.grid)
                transform = partial(on_grid, at=Interpolator(sim.mesh, *grid.points), grid=grid)
        if output is not None and sim.steps and not path.exists():
            sim.warn(f"output: {path} does not exist: it begins at day {sim.time / DAY:.4g}")
        attributes = {"run_id": sim.run_id or uuid.uuid4().hex} | sim.attributes(only)
        self._writer = FrameWriter(
            path, sim.mesh, attributes, bottom=sim.model.bottom, coriolis=sim.model.coriolis,
            tracers=sim.scene.tracers or (), samples=min(ahead, due + 3) + 1, only=only,
            append_from=sim.time if continues else None, about=sim.snapshot.about,
            user_fields=sim.snapshot.user_fields, transform=transform,
        )  # fmt: skip
        if continues and self._writer.run_id != sim.run_id:
            self._writer.close()
            name = "out" if output is None else "output"
            also = "" if config.restart else ", or replace it with --overwrite"
            raise ConfigError(f"{name}: {path} belongs to another run: choose another name{also}")
        if output is not None and continues:
            kept = self._writer.kept_times
            interval = HOUR * output.every if output.every else plan.frame_steps * plan.dt
            if sim.time - max(kept, default=0.0) > 1.001 * max(interval, *np.diff(kept), 0.0):
                sim.warn(f"output: {path} lacks the frames before day {sim.time / DAY:.4g}")
        return self._writer.run_id

    def write_first(self) -> None:
        """Write the present state; to a file with times of its own only if it is due there."""
        if self._output is None or not self._output.every or self.due(self.sim.steps):
            self._frame(self.sim.snapshot)

    def due(self, step: int) -> bool:
        """Return whether a frame is due, or one of about `SAMPLES` samples of a run."""
        if self._output is not None and self._output.every is not None:
            return self.plan.is_multiple(step, self._output.every * HOUR)
        is_sample = self._output is None and self.plan.is_sample(step, SAMPLES)
        return is_sample or self.plan.is_frame(step)

    def observe(self, snapshot: Snapshot) -> None:
        if self._output is not None or self.plan.is_frame(snapshot.steps):
            self._frame(snapshot)
            return
        self._sampled, numbers = snapshot.steps, snapshot.diagnostics
        self.sim.comm.on_root(lambda: self._writer.record(snapshot.time, numbers))

    def _frame(self, snapshot: Snapshot) -> None:
        """Write a frame and a checkpoint, unless this step has a frame already."""
        if self._framed == snapshot.steps:
            return
        fields = snapshot.all_fields | snapshot.user_fields
        self._framed = steps = snapshot.steps
        if self._output is not None:
            self.sim.comm.on_root(lambda: self._writer.write(snapshot.time, fields))
            return
        numbers = None if self._sampled == steps else snapshot.diagnostics
        arrays = self.sim.restart_arrays()

        def write() -> None:
            self._writer.write(snapshot.time, fields, numbers)
            self._writer.checkpoint(arrays, steps)

        self.sim.comm.on_root(write)

    def end(self) -> None:
        """Write the last frame of a sound run that ended early, and how it ended; close the file.

        After an unexpected error, perhaps of one rank alone, it only closes the file.
        """
        sim, ended = self.sim, self.sim.outcome
        try:
            if ended.status == "running" or self._framed is None:
                return
            if self.sees_end and ended.is_sound and not ended.completed:
                self._frame(sim.snapshot)
            known = {name: x for name, x in sim.summary.as_dict().items() if x is not None}
            sim.comm.on_root(lambda: self._writer.finish(known))
        finally:
            self.close()

    def close(self) -> None:
        """Close the file; one without frames is removed."""
        if self.sim.comm.rank == 0:
            self._writer.close()


class Keeper(Observer):
    """Keeps the frames of a run in memory: a dataset each, by the number of steps."""

    def __init__(self) -> None:
        self.frames: dict[int, Any] = {}

    def begin(self, plan: RunPlan, snapshot: Snapshot) -> None:
        self._plan, self.frames[snapshot.steps] = plan, snapshot.sim.to_xarray()

    def due(self, step: int) -> bool:
        return self._plan.is_frame(step)

    def observe(self, snapshot: Snapshot) -> None:
        self.frames[snapshot.steps] = snapshot.sim.to_xarray()


@dataclass
class Ticker(Observer):
    """Calls a function with the number of steps so far about ten times a second."""

    function: Callable[[int], None]

    def tick(self, step: int) -> None:
        self.function(step)


class ProgressBar(Observer):
    """A bar on stderr, or in a notebook; a lost terminal does not end the run."""

    _bar: Any = None

    def begin(self, plan: RunPlan, snapshot: Snapshot) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # notebooks without widgets show text instead
            from tqdm.auto import tqdm
        self._plan, self._days = plan, plan.time(plan.steps) / DAY
        with suppress(OSError):
            self._bar = tqdm(
                total=plan.steps, initial=snapshot.steps, unit="step", leave=False,
                desc=f"{snapshot.model.scene.name}  dt {plan.dt:.4g} s", dynamic_ncols=True,
            )  # fmt: skip

    def tick(self, step: int) -> None:
        if self._bar is not None:
            with suppress(OSError):
                day = self._plan.time(step) / DAY
                self._bar.set_postfix_str(f"day {day:.2f} of {self._days:g}", False)
                self._bar.update(step - self._bar.n)

    def end(self) -> None:
        if self._bar is not None:
            with suppress(OSError):
                self._bar.close()


@dataclass
class LogLines(Observer):
    """Logs a line now and then, for a run whose output goes to a file."""

    level: int = logging.INFO
    PATIENCE = 30.0
    """Seconds before the first line; the next ones wait as long, or a tenth of the elapsed time."""

    def begin(self, plan: RunPlan, snapshot: Snapshot) -> None:
        self._start, self._plan, self._from = time.perf_counter(), plan, snapshot.time
        self._due = self._start + self.PATIENCE

    def tick(self, step: int) -> None:
        if (now := time.perf_counter()) < self._due:
            return
        gone, at, end = now - self._start, self._plan.time(step), self._plan.time(self._plan.steps)
        self._due = now + max(self.PATIENCE, 0.1 * gone)
        speed = (at - self._from) / gone
        left = (end - at) / speed if speed > 0.0 else math.inf
        LOGGER.log(
            self.level, "day %.2f of %g after %.0f s, %.3g days a minute, %.0f s to go",
            at / DAY, end / DAY, gone, 60.0 * speed / DAY, left,
        )  # fmt: skip


@dataclass
class Callback(Observer):
    """Calls a function with the simulation, by steps, by simulated time or a few times a run."""

    function: Function
    steps: int = 1
    seconds: float | None = None
    """Simulated time [s]; the steps of a run are chosen so that they meet its multiples."""
    times: int = 0
    """Approximate number of calls in a run, instead of `steps`; 0: unused."""
    sees_end = False

    def __post_init__(self) -> None:
        calls = self.function, getattr(self.function, "__call__", None)  # noqa: B004 - of objects
        if not callable(self.function) or any(test(x) for test in DEFERRED for x in calls):
            raise ConfigError(f"a callback must be a plain function, got {self.function!r}")

    def check(self, plan: RunPlan) -> None:
        """Raise ConfigError if a call is due in the middle of steps that are taken together."""
        if self.steps > 1 and self.steps % plan.cycle:
            raise ConfigError(
                f"every: {self.steps} steps are not a multiple of the {plan.cycle} taken at once"
                " (tracer-steps)"
            )

    def begin(self, plan: RunPlan, snapshot: Snapshot) -> None:
        self._plan = plan

    def due(self, step: int) -> bool:
        if self.seconds is not None:
            return self._plan.is_multiple(step, self.seconds)
        is_next = step % self.steps < self._plan.cycle  # a resumed run may pass over the multiple
        return self._plan.is_sample(step, self.times) if self.times else is_next

    def observe(self, snapshot: Snapshot) -> None:
        call_in_run(label(self), self.function, snapshot.sim)


PICTURES_A_RUN = 100
"""Pictures of a live view in a run, evenly spaced in simulated time."""


def live_view(field: str, comm: Any) -> Callback:
    """Return a callback that draws a field in the terminal, each picture over the one before.

    field: its name, or "auto" for the scene's default. Raises ConfigError for an unknown field, and
    if rank 0 has no terminal with colours.
    """
    from swe_sphere.pictures.plot import LivePicture  # matplotlib is slow to import

    picture = LivePicture(field, DIAGNOSTICS)
    comm.on_root(picture.check_terminal)

    def draw(sim: Any) -> None:
        frame = sim.to_xarray().swe.frames
        caption = f"day {sim.time / DAY:.2f} of {sim.days:g}, {sim.scene.name}"
        comm.on_root(lambda: picture.draw(frame, sim.time, caption))

    return Callback(draw, times=PICTURES_A_RUN)


def every(
    steps: int | None = None, *, hours: float | None = None, days: float | None = None
) -> Callable[[Function], Callback]:
    """Schedule a callback by steps or by simulated time; use it as a decorator or as a call.

    Examples:
        >>> from swe_sphere import Simulation, every
        >>> sim = Simulation("williamson2", ne=2, np=4, dt=3600)
        >>> depths = []
        >>> @every(hours=6)
        ... def look(sim):
        ...     depths.append(float(sim.state.h.max()))
        >>> sim.run(days=0.5, callbacks=[look]).status
        'completed'
        >>> len(depths)
        2

    Raises ConfigError unless exactly one of the three is given, and positive.
    """
    units: tuple[tuple[Any, float], ...] = ((steps, 1.0), (hours, HOUR), (days, DAY))
    given = [(value, unit) for value, unit in units if value is not None]
    if len(given) == 1 and isinstance(given[0][0], Real):
        seconds = float(given[0][0]) * given[0][1]
        if steps is None and 1e-3 <= seconds < math.inf:
            return partial(Callback, seconds=HOUR * float(meant_hours(seconds / HOUR)))
        if steps is not None and 1 <= steps < math.inf and steps == int(steps):
            return partial(Callback, steps=int(steps))
    raise ConfigError(
        "every: give one of steps (a positive whole number), hours and days (at least a"
        " millisecond)"
    )
