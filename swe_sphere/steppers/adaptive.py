"""Steps of a length that follows their error, by a rule, inside the fixed steps of a run."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.files.user_file import users_code
from swe_sphere.ranks.blas import one_thread
from swe_sphere.steppers.error_measures import make_measure
from swe_sphere.steppers.stepper import Stepper, Trajectory

SAFETY = 0.9
PRESENT, PAST = 0.7, 0.4
"""Exponents of the present error and of the one before, times the order."""
LEAST, MOST = 0.5, 2.0
"""Bounds of the ratio of two successive steps."""


@dataclass(frozen=True)
class PIController:
    """Proportional-integral control of the step by an estimate of its error.

    dt_new = dt 0.9 (tolerance/error)^(0.7/p) (error_before/tolerance)^(0.4/p), between dt/2 and
    2 dt (Gustafsson 1991, doi:10.1145/210232.210242; Hairer & Wanner 1996, IV.2); without the last
    factor where the error before is 0, which tells no trend.  It has no memory: who steps keeps the
    error before.  `tolerance` in the unit of the errors; `order` p: the
    power of dt that the error goes with.  Raises ConfigError for values out of range.
    """

    tolerance: float
    order: int

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tolerance) and self.tolerance > 0.0):
            raise ConfigError(
                f"adaptive: the tolerance must be positive and finite, not {self.tolerance}"
            )
        if self.order < 1:
            raise ConfigError(f"adaptive: the order must be at least 1, not {self.order}")

    def accepts(self, error: float) -> bool:
        """Whether a step with that error may stand; one that is NaN may not."""
        return error <= self.tolerance

    def ratio(self, error: float, before: float) -> float:
        """Length of the next step over that of this one, from its error and the one before."""
        if not math.isfinite(error):
            return LEAST
        if error == 0.0:
            return MOST
        present: float = (self.tolerance / error) ** (PRESENT / self.order)
        past = (before / self.tolerance) ** (PAST / self.order) if before > 0.0 else 1.0
        return min(MOST, max(LEAST, SAFETY * present * past))


CAUTION = 0.1
"""The first step, as a part of what the time scale of the start allows."""
SOLVER = 0.1
"""Part of the tolerance that may be errors of the solver."""
SMALLEST_PART = 1e-6
"""Steps shorter than this part of the outer step are given up."""
CUTS_KEPT = 100


@dataclass(frozen=True)
class Cut:
    """A step that was taken back: when [s], how long it was [s], and why."""

    time: float
    dt: float
    why: str

    def __str__(self) -> str:
        """In words."""
        return f"at {self.time:.6g} s a step of {self.dt:.6g} s was taken back: {self.why}"


class AdaptiveSteps(Trajectory):
    """Steps of an implicit scheme that follow their error; `dt` is the outer step, met exactly.

    `by="embedded"`: the difference to the embedded method in the energy norm, over the norm of the
    state, a step.  The error of a run then goes with the tolerance for rosenbrock-w, whose estimate
    is that of an embedded method of lower order, and with its power 2/3 for tr-bdf2; for esdirk4
    with a power between the two while steps are longer than the fastest gravity waves (`lauter`,
    ne 3).

    `by="energy"`: relative drift of the total energy, per day.  All of it is the time integrator's,
    as the discretisation in space keeps energy.  It goes with the error of schemes that damp
    (implicit-euler, bdf2, tr-bdf2, sdirk3, esdirk4, rosenbrock-w), though as a sum over the globe
    it may pass through zero, and it says nothing of phases.  It is no measure of error, but an
    alarm that the solver is not well, for implicit-midpoint, crank-nicolson, gauss-legendre and
    average-vector-field: on williamson5 at dt = 7200 s midpoint drifts by 4e-10 where depths are
    wrong by 1e-3.

    Errors of the solver are part of the error: it is asked for `SOLVER` of the tolerance, or for
    the scheme's own tolerance where that is stricter.

    A step that is not good enough, or cannot be solved, is taken again, shorter, and noted in
    `cuts`; no step is longer than the outer one.  `first`: length of the very first step [s].
    Raises ConfigError for what has no such estimate.
    """

    def __init__(
        self, scheme: Stepper, tolerance: float, by: str = "embedded", first: float | None = None
    ) -> None:
        self.scheme, self._measure = make_measure(by, scheme)
        self.name, self.order = scheme.name, scheme.order  # type: ignore[misc]
        super().__init__(scheme.model, scheme.dt)
        self.state, self.counters = scheme.state, scheme.counters
        self.counters["accepted_steps"] = 0
        self.controller = PIController(tolerance, self._measure.order)
        self._loosest = self.scheme.solver.loosest
        if first is not None and not (math.isfinite(first) and first > 0.0):
            raise ConfigError(f"adaptive: the first step must be positive and finite, not {first}")
        self._first, self._next, self._before = first, 0.0, tolerance
        self._cuts: deque[Cut] = deque(maxlen=CUTS_KEPT)
        self._start = self.model.zeros()

    @property
    def cuts(self) -> list[Cut]:
        """The last steps that were taken back, since the start or a restart."""
        return list(self._cuts)

    @property
    def next_dt(self) -> float:
        """Length of the next step [s], if the outer step leaves room for it."""
        return self._next

    def start(self, state: wp.array, t: float = 0.0) -> None:
        """Begin from a copy of the state at time t [s]."""
        super().start(state, t)
        self.scheme.start(state, t)
        self._before = self.controller.tolerance
        self._next = min(self.dt, self._first or self._first_guess())
        self._cuts.clear()

    def step(self) -> None:
        """Move `state` forward by dt."""
        done = 0.0
        wp.copy(self._start, self.state)
        with users_code(), one_thread():
            while done < self.dt:
                dt = self._fitted(self.dt - done)
                if self._try(self.time + done, dt):
                    # the last one ends the outer step whatever the round-off of the sum
                    done = self.dt if dt >= self.dt - done else done + dt
            if self.model.limiter is not None:
                self.model.limiter(self.state)
        self.steps += 1

    def costs(self) -> dict[str, float]:
        """What the steps so far have taken."""
        return self.scheme.costs()

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies of all that a bitwise exact restart needs, the controller's included."""
        control = {"adaptive": np.array([self._next, self._before])}
        return self.scheme.state_dict() | control

    def load_state_dict(self, state: dict[str, NDArray[Any]], steps: int) -> None:
        """Resume from what `state_dict` returned after that many outer steps.

        Raises ConfigError when the state is not that of an adaptive stepper.
        """
        if "adaptive" not in state:
            raise ConfigError("the restart data are of a run with fixed steps: leave adaptive out")
        self.scheme.load_state_dict(state, steps)
        self._origin, self.steps = float(state["origin"]), steps
        self._next, self._before = (float(value) for value in state["adaptive"])

    def _fitted(self, rest: float) -> float:
        """The next step, fitted to the rest of the outer step without leaving a sliver of it."""
        if self._next >= rest * (1.0 - 1e-9):
            return rest
        return min(self._next, 0.5 * rest)

    def _try(self, t: float, dt: float) -> bool:
        """Attempt a step, keep it if it is good, and set the length of the next one."""
        self._set_solver(dt)
        fault = self.scheme.attempt(t, dt)
        if fault is not None:
            self._cut(t, dt, fault, LEAST, "try a finer mesh or more dissipation")
            return False
        error = self._measure(dt)
        if not self.controller.accepts(error):
            why = f"{self._measure.unit} {error:.3g} above {self.controller.tolerance:.3g}"
            ratio = self.controller.ratio(error, self._before)
            self._cut(t, dt, why, ratio, "choose a larger tolerance of adaptive")
            return False
        self._keep(dt, error)
        return True

    def _keep(self, dt: float, error: float) -> None:
        """Accept; after a step that was short to fit the outer one, what came before holds."""
        self.scheme.accept(dt)
        self.counters["accepted_steps"] += 1
        proposed = dt * self.controller.ratio(error, self._before)
        if dt >= self._next * (1.0 - 1e-9):
            self._next, self._before = min(self.dt, proposed), error
        else:
            self._next = min(self.dt, max(self._next, proposed))

    def _cut(self, t: float, dt: float, why: str, ratio: float, advice: str) -> None:
        self._cuts.append(Cut(t, dt, why))
        self.counters["rejected_steps"] += 1
        self._next = dt * ratio
        if self._next < SMALLEST_PART * self.dt:
            wp.copy(self.state, self._start)  # that of `time`
            raise SolverFailed(
                f"{self.name}: no step from {t:.0f} s is short enough, the last of {dt:.3g} s:"
                f" {why}; {advice}"
            )

    def _set_solver(self, dt: float) -> None:
        """Have the equations solved as exactly as a step of dt [s] needs it."""
        change = self._measure.per_change(dt)
        needed = SOLVER * self.controller.tolerance / change if change > 0.0 else math.inf
        self.scheme.solver.loosest = min(self._loosest, needed)

    def _first_guess(self) -> float:
        """A step [s] from the time the state takes to change by itself; the outer one at rest."""
        solver = self.scheme.solver
        if solver.motion.rate == 0.0:
            return self.dt
        scale = solver.space.norm(self.state) / solver.motion.rate
        part = self.controller.tolerance ** (1.0 / self.controller.order)
        return float(max(CAUTION * part * scale, 1e-3 * self.dt))
