"""The run loop: steps, and between them a look at their sense, and the observers.

Only the steps are on the clock.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from swe_sphere.errors import TimedOut, Unstable
from swe_sphere.planet import DAY
from swe_sphere.simulation.callbacks import Observer
from swe_sphere.simulation.interrupt import Interrupted, Interruption
from swe_sphere.simulation.running import Running

if TYPE_CHECKING:
    import warp as wp


EVERY = 16
"""Steps between looks."""

RUNAWAY = 10.0
"""Growth of the energy that no scene here has, and every numerical explosion soon."""


class HealthCheck:
    """Ends the run where a value is NaN, a depth negative or the energy runs away.

    It takes sums where the state is, and never the state from there.
    """

    def __init__(self, sim: Running) -> None:
        from swe_sphere.solvers.vector_space import VectorSpace  # imports Warp
        from swe_sphere.steppers.solving import energy_weights

        model, mesh = sim.model, sim.model.device_mesh
        self._space = VectorSpace(energy_weights(model), model.device, mesh.real, mesh=mesh)
        first = model.names.index("h") * mesh.size
        self._depth = first, first + mesh.size
        self._linear = sim.scene.linear
        start = model.initial_state()
        self._energy = self._space.dot(start, start)

    def due(self, step: int) -> bool:
        """Every few steps."""
        return step % EVERY == 0

    def observe(self, sim: Running) -> None:
        """Look; Unstable says what is wrong, when, and what could be done."""
        failure = self._failure(sim.stepper.state)
        if failure:
            when = f"at day {sim.time / DAY:.4g} (step {sim.steps})"
            raise Unstable(f"{failure} {when}: {_advice(sim.plan.dt, sim.stable_dt)}")

    def _failure(self, state: wp.array) -> str | None:
        energy = self._space.dot(state, state)
        if not math.isfinite(energy):
            return "the solution is NaN"
        # a passive h, and that of a linear wave, may undershoot zero without harm
        if not self._linear and (depth := self._space.lowest(state, *self._depth)) < 0.0:
            return f"the depth is negative ({depth:.3g} m)"
        growth = energy / self._energy
        return f"the energy has grown {growth:.3g} times" if growth > RUNAWAY else None


def _advice(dt: float, limit: float) -> str:
    """What to say when a run goes wrong."""
    text = f"dt = {dt:.6g} s, stability limit at the start about {limit:.4g} s"
    if dt > limit:
        return f"{text}; take a smaller dt"
    return f"{text}; try a finer mesh, a smaller dt or more dissipation"


TICK = 0.1
"""Seconds between two calls of the progress report."""


class Loop:
    """Steps a simulation along its plan.

    guard: sees the state when it is due and before any observer does, so that none of them is
    shown a state that makes no sense.  observers: each sees the state when it is due, and always
    the last one.  tick: called about ten times a second.  time_limit: wall time [s] that the steps
    may take, looked at after each of them; None: any.
    """

    def __init__(
        self,
        sim: Running,
        guard: Observer,
        observers: Sequence[Observer],
        tick: Callable[[Running], None] | None = None,
        time_limit: float | None = None,
    ) -> None:
        self._sim, self._model = sim, sim.model
        self._stepper, self._plan = sim.stepper, sim.plan
        self._guard, self._observers, self._tick = guard, observers, tick
        self._time_limit = math.inf if time_limit is None else time_limit
        self._limit = sim.wall_seconds + self._time_limit
        self._last_tick = 0.0

    def run(self, interruption: Interruption) -> None:
        """Step to the end.

        Raises:
            RunFailed: a stepper or an observer cannot go on, or the time limit is reached.
            Interrupted: the user asked to stop; the state is that after a whole step.
        """
        while self._stepper.steps < self._plan.steps:
            late = self._advance(self._next_stop(), interruption)
            self._observe()
            self._stop(interruption, late)

    def _next_stop(self) -> int:
        """The next step after which anyone is due."""
        cycle = self._plan.cycle
        following = range(self._stepper.steps + cycle, self._plan.steps, cycle)
        everyone = (self._guard, *self._observers)
        due = (step for step in following if any(who.due(step) for who in everyone))
        return next(due, self._plan.steps)

    def _advance(self, stop: int, interruption: Interruption) -> bool:
        """Take steps up to that number, with the clock running; whether it has run out then.

        Whoever is due after the last one has yet to see the state.
        """
        self._sim.forget()
        compiled, start = self._model.compile_seconds, time.perf_counter()
        worked = time.process_time()
        deadline = start - compiled + self._limit - self._sim.wall_seconds
        try:
            while True:
                self._stepper.step()
                now = time.perf_counter()
                self._report(now)
                late = now > deadline + self._model.compile_seconds
                if self._stepper.steps >= stop:
                    break
                self._stop(interruption, late)
            self._finish_device()
            return late
        finally:
            elapsed = time.perf_counter() - start
            self._sim.wall_seconds += elapsed - (self._model.compile_seconds - compiled)
            self._sim.cpu_seconds += time.process_time() - worked

    def _finish_device(self) -> None:
        import warp as wp

        wp.synchronize_device(self._model.device)

    def _observe(self) -> None:
        step = self._stepper.steps
        self._guard.observe(self._sim)
        for observer in self._observers:
            if step == self._plan.steps or observer.due(step):
                observer.observe(self._sim)

    def _stop(self, interruption: Interruption, late: bool = False) -> None:
        """Raise Interrupted or TimedOut on all ranks where there is reason to on one."""
        comm = self._sim.comm
        if not comm.any_lately(late or interruption.received is not None):
            return
        signals, hurry = zip(*comm.tell_all((interruption.received, late)), strict=True)
        for signal in filter(None, signals):
            raise Interrupted(signal)
        if any(hurry):
            self._give_up()

    def _give_up(self) -> None:
        steps = self._stepper.steps
        if steps < self._plan.steps:
            day = self._plan.time(steps) / DAY
            raise TimedOut(
                f"the time limit of {self._time_limit:g} s was reached at day {day:.4g}"
                f" (step {steps} of {self._plan.steps}): give it more time or take a larger dt"
            )

    def _report(self, now: float) -> None:
        if self._tick is not None and now - self._last_tick >= TICK:
            self._last_tick = now
            self._tick(self._sim)
