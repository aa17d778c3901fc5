"""A prepared run while it runs: the loop, its end in good order, and the numbers it leaves."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from swe_sphere.errors import ConfigError, RunFailed, TimedOut
from swe_sphere.planet import DAY
from swe_sphere.simulation.health import HealthCheck
from swe_sphere.simulation.interrupt import Interrupted, Interruption
from swe_sphere.simulation.loop import Loop
from swe_sphere.simulation.prepare import Prepared
from swe_sphere.simulation.recorder import Recorder
from swe_sphere.simulation.sampler import Sampler
from swe_sphere.simulation.snapshot import Array, Moment
from swe_sphere.simulation.summary import Summary
from swe_sphere.simulation.watcher import Watcher

if TYPE_CHECKING:
    from swe_sphere.io.netcdf import FrameWriter
    from swe_sphere.steppers import Stepper

__all__ = ["Execution"]

COSTS = (
    "newton_iterations", "krylov_iterations", "rejected_steps", "tangent_evaluations",
    "preconditioner_applications", "setups", "setup_seconds",
)  # fmt: skip
"""Costs that are told of every run, also where they are zero."""

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


class Execution:
    """Steps a prepared run; without a writer it leaves nothing but its summary."""

    def __init__(self, prepared: Prepared, writer: FrameWriter | None, watcher: Watcher) -> None:
        self._prepared, self._watcher = prepared, watcher
        model, plan = prepared.model, prepared.plan
        start = _start_fields(prepared)
        self._sampler = Sampler(model, self._step_length, start)
        self._health = HealthCheck(model, start, _advice(prepared))
        stepper = prepared.config.stepper
        self._recorder = Recorder(self._sampler, plan, writer, stepper, self._counts)
        self._loop = Loop(
            model, prepared.stepper, plan, self._health, [self._recorder], self._tick,
            prepared.config.time_limit,
        )  # fmt: skip
        self._reason: str | None = None
        self._exit_status = 0

    def run(self) -> Summary:
        """Step to the end, or until something comes in the way."""
        try:
            self._recorder.frame(self._loop.moment())
            self._watcher.begin(self._prepared)
            with Interruption() as interruption:
                self._loop.run(interruption)
        except TimedOut as error:
            self._stop(str(error), error.exit_status)
            self._keep(self._loop.moment())
        except (RunFailed, ConfigError) as error:  # also a function of the scene, late in the run
            self._stop(str(error), error.exit_status)
            self._recorder.latest = {}
        except Interrupted as error:
            moment = self._loop.moment()
            self._stop(f"interrupted by {error} at day {moment.time / DAY:.4g}", INTERRUPTED)
            self._keep(moment)
        finally:
            with suppress(OSError):
                self._watcher.end()
        numbers = self._numbers()
        return Summary(numbers, self._exit_status == 0, self._reason, self._exit_status)

    def _tick(self, step: int) -> None:
        """Tell the watcher; that its terminal is gone is no reason to end the run."""
        with suppress(OSError):
            self._watcher.tick(step)

    def _step_length(self) -> float:
        """The present step [s], which follows its error in an adaptive run."""
        return float(getattr(self._prepared.stepper, "next_dt", self._prepared.plan.dt))

    def _stop(self, reason: str, exit_status: int) -> None:
        self._reason, self._exit_status = reason, exit_status

    def _keep(self, moment: Moment) -> None:
        """Write the state of an interrupted run as its last frame, if it is worth keeping."""
        try:
            self._health.observe(moment)
            self._recorder.frame(moment)
        except RunFailed as error:
            self._stop(f"{self._reason}; its last state was not kept: {error}", self._exit_status)

    def _counts(self) -> dict[str, float]:
        """Counters and seconds of the run, with those before a restart."""
        prepared = self._prepared
        after = prepared.model.counters
        counts: dict[str, float] = {k: n - prepared.before.get(k, 0) for k, n in after.items()}
        counts |= prepared.stepper.costs()
        counts["wall_seconds"] = self._loop.wall_seconds
        carried = prepared.counts
        return {name: n + carried.get(name, 0) for name, n in counts.items()}

    def _numbers(self) -> dict[str, object]:
        prepared = self._prepared
        config, model, plan = prepared.config, prepared.model, prepared.plan
        steps = prepared.stepper.steps
        return {
            "scene": prepared.scene.name,
            "title": prepared.scene.title,
            "stepper": config.stepper,
            "scheme": prepared.stepper.name,
            **prepared.options,
            "ne": model.mesh.ne,
            "np": model.mesh.np,
            "dt": plan.dt,
            "steps": steps,
            "days": plan.time(steps) / DAY,
            "compile_seconds": model.compile_seconds,
            **dict.fromkeys(COSTS, 0),
            **self._counts(),
            **self._recorder.latest,
            **self._reference_errors(),
            "stretch": model.mesh.stretch,
            "device": model.device,
            "precision": config.precision,
            "launch": model.shape,
            "days_planned": prepared.days,
            "dt_wanted": plan.wanted,
            "dt_rule": prepared.dt_rule,
            "stable_dt": prepared.stable_dt,
            "out": None if config.out is None else str(config.out),
            **_cuts(prepared.stepper),
        }

    def _reference_errors(self) -> dict[str, float]:
        if self._prepared.reference is None or self._exit_status:
            return {}
        return self._prepared.reference(self._prepared.model, self._loop.moment())


def _cuts(stepper: Stepper) -> dict[str, list[str]]:
    """Of an adaptive run: the last steps that were taken back, since a restart, and why."""
    cuts = getattr(stepper, "cuts", None)
    return {} if cuts is None else {"cuts": [str(cut) for cut in cuts]}


def _start_fields(prepared: Prepared) -> dict[str, Array]:
    """All fields at the scene's own start, also where the run begins later."""
    model = prepared.model
    state = model.initial_state()
    return model.fields(state) | {
        "vorticity": model.vorticity(state),
        "divergence": model.divergence(state),
    }


def _advice(prepared: Prepared) -> str:
    """What to say when a run goes wrong."""
    dt, limit = prepared.plan.dt, prepared.stable_dt
    text = f"dt = {dt:.6g} s, stability limit at the start about {limit:.4g} s"
    if dt > limit:
        return f"{text}; take a smaller dt"
    return f"{text}; try a finer mesh, a smaller dt or more dissipation"
