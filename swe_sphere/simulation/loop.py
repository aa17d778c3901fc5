"""The run loop: steps and, between them, observers, signals and the time limit."""

import math
import signal
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from types import FrameType
from typing import Any, Self

from swe_sphere.errors import Interrupted, RunFailed, TimedOut
from swe_sphere.files.user_file import is_custom
from swe_sphere.planet import DAY
from swe_sphere.ranks.limits import StopRequest, stop_is_asked
from swe_sphere.simulation.observers import Callback, HealthCheck, Observer, label, notify


class Interruption:
    """Records the first stop signal in a block; a second one acts as it does outside the block.

    The signals are SIGINT, SIGTERM, SIGHUP, and SIGUSR1, which batch systems send before the end.

    It has no effect outside the main thread, where Python delivers no signals. Ignored signals, as
    SIGHUP under nohup, stay ignored.
    """

    def __init__(self) -> None:
        self.received: str | None = None
        """Name of the signal, None if none has come."""
        self.number: int | None = None
        self._handlers = ExitStack()

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            known = signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP
            for number in (n for n in known if signal.getsignal(n) not in (signal.SIG_IGN, None)):
                self._handlers.callback(signal.signal, number, signal.signal(number, self._note))
        return self

    def __exit__(self, *_: object) -> None:
        self._handlers.close()

    def check(self) -> None:
        """Raise Interrupted if a signal has come."""
        if self.received is not None:
            raise Interrupted(f"interrupted by {self.received}")

    def _note(self, number: int, _: FrameType | None) -> None:
        self.number = number
        self.received = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        self._handlers.close()


def _may_change_states(observer: Observer) -> bool:
    return isinstance(observer, Callback) or is_custom(type(observer))


TICK = 0.1
"""Seconds between two ticks of the observers."""


class Loop:
    """Steps a simulation along its plan; a health check sees each state before the observers do.

    sim: the simulation.  interruption: records signals.  Others: as in `Simulation.run_plan`.
    """

    def __init__(
        self, sim: Any, observers: Sequence[Observer], time_limit: float | None,
        interruption: Interruption, since: float | None = None,
    ) -> None:  # fmt: skip
        # files come last, so that they contain the state that callbacks and custom observers leave
        self.observers = sorted(observers, key=lambda each: not _may_change_states(each))
        self.sim, self.plan = sim, sim.plan
        self.health, self.interruption = HealthCheck(sim), interruption
        self.time_limit = math.inf if time_limit is None else time_limit
        self._limit, self._since = sim.wall_seconds + self.time_limit, since
        self._deadline = math.inf
        self._is_late = False
        self._last_tick = 0.0

    def step_to_end(self) -> None:
        """Step to the end; the state is always that after a whole step.

        Raises RunFailed if a stepper or an observer fails, or the time limit is reached, and
        Interrupted if the user asked to stop.
        """
        while self.sim.steps < self.plan.steps:
            before = self.sim.steps
            self.sim.fit_step()
            is_asked = self._advance(self._next_stop())
            steps = self.sim.steps
            if steps == before:  # this state has been observed already
                self._stop()
            self.health.observe(self.sim.snapshot)
            for observer in self.observers:
                is_end = steps == self.plan.steps and observer.sees_end
                if is_end or notify(observer, "due", steps):
                    dt = self.sim.stepper.dt
                    if may_change := _may_change_states(observer):
                        self.sim.known_state = self.sim.stepper.state.numpy().copy()
                    notify(observer, "observe", self.sim.snapshot)
                    if self.sim.steps != steps or self.sim.stepper.dt != dt:
                        what = "has stepped, run or reset the simulation or changed its dt"
                        raise RunFailed(f"{label(observer)} {what}: do so after the run")
                    if may_change:
                        self.health.observe(self.sim.snapshot, observer)
                        self.sim.accept_changes(self.sim.known_state)
                        self.sim.known_state = None
            if is_asked or self._is_asked_to_stop():
                self._stop()

    def _next_stop(self) -> int:
        """Return the next step after which an observer is due or the step changes its length."""
        plan, everyone, steps = self.plan, (self.health, *self.observers), self.sim.steps
        end = min(each for each in (plan.lead_steps, plan.tail_begin, plan.steps) if each > steps)
        following = range(steps + plan.cycle, end, plan.cycle)
        due = (step for step in following if any(notify(each, "due", step) for each in everyone))
        return next(due, end)

    def _advance(self, stop: int) -> bool:
        """Take timed steps up to that number; return, on all ranks, whether a rank must stop."""
        import warp as wp

        sim, model, start = self.sim, self.sim.model, time.monotonic()
        sim.release()
        compiled, worked = model.launch.compile_seconds, self._cpu_seconds()
        self._deadline = start - compiled + self._limit - sim.wall_seconds
        is_asked = False
        try:
            while not is_asked and sim.steps < stop:
                self._step(stop - sim.steps)
                if (now := time.monotonic()) - self._last_tick >= TICK:
                    self._last_tick = now
                    for observer in self.observers:
                        notify(observer, "tick", sim.steps)
                is_asked = sim.steps < stop and self._is_asked_to_stop()
            wp.synchronize_device(model.device)
            return is_asked
        finally:
            sim.wall_seconds += time.monotonic() - start - (model.launch.compile_seconds - compiled)
            sim.cpu_seconds += self._cpu_seconds() - worked

    def _step(self, most: int) -> None:
        """Take a step, or up to `most` at once; a step that is given up changes nothing."""
        if not (stepper := self.sim.stepper).can_give_up:
            self.sim.take(most)
            return
        restore = stepper.restore_point()
        token = stop_is_asked.set(self._is_asked_to_stop)
        try:
            self.sim.take(1)
        except StopRequest:
            restore()
        finally:
            stop_is_asked.reset(token)

    def _cpu_seconds(self) -> float:
        """Return the CPU time of this process without compiling [s]."""
        return time.process_time() - float(self.sim.model.launch.compile_cpu_seconds)

    def _is_asked_to_stop(self) -> bool:
        """Return whether any rank is late or interrupted; several ranks agree one call later."""
        if self._since is None:
            end = self._deadline + self.sim.model.launch.compile_seconds
        else:
            end = self._since + self.time_limit
        self._is_late = time.monotonic() > end
        asked = self._is_late or self.interruption.received is not None
        return bool(self.sim.comm.any_lately(asked))

    def _stop(self) -> None:
        """Raise Interrupted or TimedOut on all ranks, unless the run is complete."""
        asked = self.sim.comm.allgather((self.interruption.received, self._is_late))
        if (steps := self.sim.steps) == self.plan.steps:
            return
        for signal_name, _ in asked:
            if signal_name is not None:
                raise Interrupted(f"interrupted by {signal_name}")
        if any(is_late for _, is_late in asked):
            day = self.plan.time(steps) / DAY
            raise TimedOut(
                f"the time limit of {self.time_limit:g} s was reached at day {day:.4g}"
                f" (step {steps} of {self.plan.steps}): raise the limit or take a larger dt"
            )
