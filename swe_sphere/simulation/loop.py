"""The run loop: steps and, between them, observers, signals and the time limit."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

from swe_sphere.errors import TimedOut
from swe_sphere.planet import DAY
from swe_sphere.simulation.observers import Observer

if TYPE_CHECKING:
    from swe_sphere.steppers import Trajectory


class Interrupted(Exception):
    """The user asked the run to stop; the message names the signal."""


class Interruption:
    """Notes the first SIGINT, SIGTERM or SIGHUP within a block; the second acts as outside of it.

    It does nothing outside the main thread, where Python delivers no signals, and nothing about an
    ignored SIGHUP, as nohup has it.
    """

    def __init__(self) -> None:
        self.received: str | None = None
        """Name of the signal, None if none has come."""
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            numbers = [signal.SIGINT, signal.SIGTERM]
            if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
                numbers.append(signal.SIGHUP)
            self._before = {number: signal.signal(number, self._note) for number in numbers}
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()

    def check(self) -> None:
        """Raise Interrupted if a signal has come."""
        if self.received is not None:
            raise Interrupted(f"interrupted by {self.received}")

    def _note(self, number: int, _: FrameType | None) -> None:
        self.received = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}


@dataclass
class Clock:
    """Time spent stepping, without observing and writing."""

    wall_seconds: float = 0.0
    """Wall time, without compiling [s]."""
    cpu_seconds: float = 0.0
    """CPU time of all threads, without compiling [s]."""


TICK = 0.1
"""Seconds between two ticks of the observers."""


class Loop:
    """Steps a simulation along its plan.

    Args:
        sim: the simulation.
        guard: sees the state when it or an observer is due, before any observer does.
        observers: see the state when they are due, and always the last one.
        time_limit: wall time that the steps may take [s].
    """

    def __init__(
        self, sim: Any, guard: Observer, observers: Sequence[Observer], time_limit: float | None
    ) -> None:
        self.sim, self.model, self.plan, self.clock = sim, sim.model, sim.plan, sim.clock
        self.stepper: Trajectory = sim.stepper
        self.guard, self.observers = guard, observers
        self.time_limit = math.inf if time_limit is None else time_limit
        self._limit = self.clock.wall_seconds + self.time_limit
        self._last_tick = 0.0

    def run(self, interruption: Interruption) -> None:
        """Step to the end.

        Raises:
            RunFailed: a stepper or an observer fails, or the time limit is reached.
            Interrupted: the user asked to stop; the state is that after a whole step.
        """
        while self.stepper.steps < self.plan.steps:
            late = self._advance(self._next_stop(), interruption)
            self.guard.observe(self.sim.snapshot)
            for observer in self.observers:
                if self.stepper.steps == self.plan.steps or observer.due(self.stepper.steps):
                    observer.observe(self.sim.snapshot)
            self._stop(interruption, late)

    def _next_stop(self) -> int:
        """Return the next step after which an observer is due."""
        everyone = self.guard, *self.observers
        following = range(self.stepper.steps + 1, self.plan.steps)
        due = (step for step in following if any(each.due(step) for each in everyone))
        return next(due, self.plan.steps)

    def _advance(self, stop: int, interruption: Interruption) -> bool:
        """Take steps up to that number, with the clock running; return whether time has run out.

        Observers that are due after the last step have yet to see the state.
        """
        import warp as wp

        self.sim.snapshot.release()
        compiled, start = self.model.compile_seconds, time.perf_counter()
        worked = time.process_time() - self.model.launch.compile_cpu_seconds
        deadline = start - compiled + self._limit - self.clock.wall_seconds
        try:
            while True:
                self.stepper.step()
                now = time.perf_counter()
                self._tick(now)
                late: bool = now > deadline + self.model.compile_seconds
                if self.stepper.steps >= stop:
                    break
                self._stop(interruption, late)
            wp.synchronize_device(self.model.device)
            return late
        finally:
            elapsed = time.perf_counter() - start
            self.clock.wall_seconds += elapsed - (self.model.compile_seconds - compiled)
            cpu = time.process_time() - self.model.launch.compile_cpu_seconds
            self.clock.cpu_seconds += cpu - worked

    def _stop(self, interruption: Interruption, late: bool = False) -> None:
        """Raise Interrupted or TimedOut on all ranks where there is reason to on one."""
        comm = self.model.comm
        if not comm.of_each(late or interruption.received is not None).any():
            return
        signals, hurry = zip(*comm.tell_all((interruption.received, late)), strict=True)
        for name in filter(None, signals):
            raise Interrupted(name)
        steps = self.stepper.steps
        if any(hurry) and steps < self.plan.steps:
            day = self.plan.time(steps) / DAY
            raise TimedOut(
                f"the time limit of {self.time_limit:g} s was reached at day {day:.4g}"
                f" (step {steps} of {self.plan.steps}): give it more time or take a larger dt"
            )

    def _tick(self, now: float) -> None:
        if now - self._last_tick >= TICK:
            self._last_tick = now
            for observer in self.observers:
                observer.tick(self.stepper.steps)
