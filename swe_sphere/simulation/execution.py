"""The run of a simulation while it runs: loop, file, its end in good order, and its numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, cast

from swe_sphere.errors import ConfigError, RunFailed, SweError, in_one_line
from swe_sphere.planet import DAY
from swe_sphere.simulation.callbacks import Callback, Observer, Scheduled
from swe_sphere.simulation.interrupt import Interrupted, Interruption
from swe_sphere.simulation.loop import HealthCheck, Loop
from swe_sphere.simulation.progress import Watcher
from swe_sphere.simulation.recorder import Recorder, attributes_of, most_samples
from swe_sphere.simulation.restart import appends
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.summary import Outcome, Summary

if TYPE_CHECKING:
    from swe_sphere.io.netcdf import FrameWriter

COSTS = (
    "newton_iterations", "krylov_iterations", "rejected_steps", "tangent_evaluations",
    "preconditioner_applications", "setups", "setup_seconds",
)  # fmt: skip
"""Costs that are told of every run, also where they are zero."""

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

BREAKDOWNS = (ArithmeticError, ValueError, MemoryError)
"""What libraries raise when they are given a state that makes no sense, or too large a problem."""

SOUND = ("not begun", "completed", "timed-out", "interrupted")
"""Ends after which the state makes sense."""

FAR = 1.05
"""A step longer than the stability limit by this factor is warned of."""


def execute(sim: Running, callbacks: Sequence[Callback], watcher: Watcher) -> Outcome:
    """Step to the end of the plan, or until something comes in the way, with the file asked for.

    Raises:
        ConfigError: the file cannot be made.
    """
    for text in (*sim.warnings, *_warning_of_step(sim)):
        watcher.warn(text)
    if sim.config.out is None:
        return _recorded(sim, callbacks, watcher, None)
    with ExitStack() as stack:
        try:
            writer = _writer(sim, stack)
        except RunFailed as error:
            return _ended_by(error, sim)
        return _noted(sim, writer, _recorded(sim, callbacks, watcher, Recorder(sim, writer)))


def _noted(sim: Running, writer: FrameWriter, outcome: Outcome) -> Outcome:
    """Write into the file how the run ended; where that cannot be done, the run has failed."""
    told = summary_of(sim, outcome).as_dict()
    known = {name: value for name, value in told.items() if value is not None}
    try:
        sim.comm.on_root(lambda: writer.finish(known) if writer.frames else None)
    except RunFailed as error:
        return outcome if outcome.reason else _ended_by(error, sim)
    return outcome


def _warning_of_step(sim: Running) -> Iterator[str]:
    dt, limit = sim.plan.dt, sim.stable_dt
    if dt > FAR * limit:
        yield (
            f"dt = {dt:.6g} s is {dt / limit:.3g} times the stability limit of"
            f" {sim.config.stepper}, {limit:.4g} s: expect the run to blow up"
        )


def _writer(sim: Running, stack: ExitStack) -> FrameWriter:
    """What rank 0 writes with, closed with the stack; on other ranks nobody asks for it."""
    from swe_sphere.io.netcdf import FrameWriter  # netCDF4 takes its time to import

    assert sim.config.out is not None
    from_time = sim.time if sim.comm.on_root(lambda: appends(sim.config)) else None
    given = (
        sim.config.out, sim.mesh, attributes_of(sim), sim.model.bottom, sim.scene.tracers or (),
        most_samples(sim.plan, sim.steps), from_time, sim.own_attributes(), sim.own_fields,
        sim.model.coriolis, sim.config.fields,
    )  # fmt: skip
    made: list[FrameWriter] = []

    def make() -> str:
        made.append(stack.enter_context(FrameWriter(*given)))
        if from_time is not None and made[0].run_id != sim.run_id:
            raise ConfigError(f"out: {sim.config.out} is of another run now: choose another name")
        return made[0].run_id

    sim.run_id = sim.comm.on_root(make)
    return made[0] if made else cast(FrameWriter, None)


def _recorded(
    sim: Running, callbacks: Sequence[Callback], watcher: Watcher, recorder: Recorder | None
) -> Outcome:
    calls = [Scheduled(callback, sim.plan) for callback in callbacks]
    observers: list[Observer] = [*([recorder] if recorder else []), *calls]
    try:
        if recorder:
            recorder.frame(sim)
    except (RunFailed, ConfigError) as error:
        return _ended_by(error, sim)
    with _watched(sim, watcher):
        outcome = step_through(sim, observers, watcher.tick, sim.config.time_limit)
    if recorder and outcome.status in ("timed-out", "interrupted"):
        return _kept(sim, recorder, outcome)
    return outcome


def step_through(
    sim: Running,
    observers: Sequence[Observer] = (),
    tick: Callable[[Running], None] | None = None,
    time_limit: float | None = None,
    interruption: Interruption | None = None,
) -> Outcome:
    """Step a simulation that has begun to the end of its plan, whatever happens.

    observers: see the state when they are due, and the last one.  tick: called about ten times a
    second.  time_limit: wall time [s] that the steps may take.  interruption: of many runs.

    Raises:
        Interrupted: the user asked to stop, and the interruption was given.
    """
    loop = Loop(sim, HealthCheck(sim), observers, tick, time_limit)
    try:
        if interruption is not None:
            loop.run(interruption)
        else:
            with Interruption() as mine:
                loop.run(mine)
        _ = sim.diagnostics  # what fails in them is an end like others
    except Interrupted as error:
        if interruption is not None:
            raise
        return _ended_by(error, sim)
    except (SweError, *BREAKDOWNS) as error:
        return _ended_by(error, sim)
    return Outcome()


@contextmanager
def _watched(sim: Running, watcher: Watcher) -> Iterator[None]:
    """Tell the watcher of begin and end; that its terminal is gone is no reason to end the run."""
    with suppress(OSError):
        watcher.begin(sim)
    try:
        yield
    finally:
        with suppress(OSError):
            watcher.end()


def _ended_by(error: Exception, sim: Running) -> Outcome:
    text = in_one_line(error)
    sim.comm.agree_to_fail(text)
    if isinstance(error, Interrupted):
        reason = f"interrupted by {error} at day {sim.time / DAY:.4g}"
        return Outcome("interrupted", reason, INTERRUPTED)
    if not isinstance(error, SweError):
        return Outcome("solver-failed", f"{type(error).__name__}: {text}", RunFailed.exit_status)
    # of what the scene's own functions raise late it is too late to refuse the run
    status = "failed" if isinstance(error, ConfigError) else error.status
    return Outcome(status, text, error.exit_status)


def _kept(sim: Running, recorder: Recorder, outcome: Outcome) -> Outcome:
    """Write the state of an interrupted run as its last frame, if it is worth keeping."""
    try:
        HealthCheck(sim).observe(sim)
        recorder.frame(sim)
    except RunFailed as error:
        reason = f"{outcome.reason}; its last state was not kept: {error}"
        return Outcome("failed", reason, outcome.exit_status)
    return outcome


def summary_of(sim: Running, outcome: Outcome) -> Summary:
    """All that is told of a run: what was asked for, what it cost, what it came to."""
    config, model = sim.config, sim.model
    sound = outcome.status in SOUND
    numbers = {
        "scene": sim.scene.name,
        **sim.method(),
        **sim.options,
        "ne": model.mesh.ne,
        "np": model.mesh.np,
        "steps": sim.steps,
        "days": sim.time / DAY,
        "compile_seconds": model.compile_seconds,
        **dict.fromkeys(COSTS, 0),
        **sim.counts(),
        **(sim.diagnostics if sound else {}),
        **(sim.reference_errors() if outcome.completed else {}),
        "stretch": model.mesh.stretch,
        "precision": config.precision,
        "days_planned": sim.days,
        "dt_wanted": sim.plan.wanted,
        "out": None if config.out is None else str(config.out),
        **_cuts(sim),
    }
    return Summary(outcome.status, outcome.reason, outcome.exit_status, numbers)


def _cuts(sim: Running) -> dict[str, list[str]]:
    """Of an adaptive run: the last steps that were taken back, since a restart, and why."""
    cuts = getattr(sim.stepper, "cuts", None)
    return {} if cuts is None else {"cuts": [str(cut) for cut in cuts]}
