"""Adaptive steps, whose length follows their error, inside the fixed steps of a run."""

import math
from collections import deque
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.ranks.limits import one_thread
from swe_sphere.steppers.implicit import ImplicitStepper
from swe_sphere.steppers.stepper import STEPPERS, Stepper, Trajectory

SAFETY = 0.9
"""Ratio of a step to the one whose estimated error would be the tolerance."""
PRESENT, PAST = 0.7, 0.4
"""Exponents of the present and the previous error, times `power`."""
MIN_RATIO, MAX_RATIO = 0.5, 2.0
"""Bounds of the ratio of two successive steps."""
CAUTION = 0.1
"""Ratio of the first step to tolerance^(1/power) times the time scale."""
SOLVER = 0.1
"""Fraction of the tolerance that errors of the solver may use."""
SMALLEST_PART = 1e-6
"""Smallest step as a fraction of the outer step; a shorter one ends the run."""
CUTS_KEPT = 100
"""Number of rejected steps that are remembered."""


def step_ratio(error: float, before: float, tolerance: float, power: int) -> float:
    """Return the length of the next step over that of this one, from two successive errors.

    0.9 (tolerance/error)^(0.7/p) (before/tolerance)^(0.4/p), between 1/2 and 2, with the error
    proportional to dt^p, p = power: proportional-integral control (Gustafsson 1991,
    doi:10.1145/210232.210242; Hairer & Wanner 1996, IV.2). A previous error of 0 is ignored.
    """
    if not math.isfinite(error):
        return MIN_RATIO
    if error == 0.0:
        return MAX_RATIO
    present: float = (tolerance / error) ** (PRESENT / power)
    past = (before / tolerance) ** (PAST / power) if before > 0.0 else 1.0
    return min(MAX_RATIO, max(MIN_RATIO, SAFETY * present * past))


class AdaptiveSteps(Trajectory):
    """Steps of an implicit scheme that follow their error; `dt` is the outer step, met exactly.

    The error is the difference from the embedded method in the energy norm [m s-1], over the norm
    of the state: the ratio is independent of units and planet. Solver errors are at most
    `SOLVER` times `tolerance`, or as the scheme has them if that is stricter. A step that is not
    accurate enough, or whose solve fails, is repeated with a shorter length and recorded in `cuts`;
    no step is longer than the outer one. Raises ConfigError for a scheme without error estimate.
    """

    can_give_up = True

    def __init__(self, scheme: Stepper, tolerance: float) -> None:
        if not isinstance(scheme, ImplicitStepper) or scheme.estimate_order is None:
            names = ", ".join(name for name, cls in STEPPERS.items() if cls.estimate_order)
            raise ConfigError(
                f"adaptive: stepper {scheme.name} has no error estimate; take one of {names}"
            )
        if scheme.diffusion is not None:
            raise ConfigError(
                "adaptive: diffusion=apart has no error estimate: use diffusion=whole"
            )
        if not (least := 0.5 * scheme.space.epsilon) <= tolerance < math.inf:
            raise ConfigError(
                f"adaptive: the tolerance must be finite and at least {least:.3g}, got {tolerance}"
            )
        self.scheme, self._power = scheme, scheme.estimate_order
        self.name, self.order = scheme.name, scheme.order  # type: ignore[misc]
        super().__init__(scheme.model, scheme.dt)
        self.state, self.solver = scheme.state, scheme.solver
        self.counters["accepted_steps"] = 0
        self._largest_tolerance = scheme.solver.largest_tolerance
        self.tolerance = self._before = tolerance
        self.next_dt = 0.0
        """Length of the next step [s], if the outer step leaves room for it."""
        self.cuts: deque[str] = deque(maxlen=CUTS_KEPT)
        """The last steps that were rejected, since the run began or resumed, in words."""
        self._start = self.model.zeros()

    def start(self, state: wp.array, t: float = 0.0) -> None:
        super().start(state, t)
        self.scheme.start(state, t)
        self._before = self.tolerance
        self.next_dt, solver = self.dt, self.scheme.solver
        if solver.rate > 0.0:  # from the time scale of changes of the state
            scale = solver.space.norm(self.state) / solver.rate
            part = self.tolerance ** (1.0 / self._power)
            self.next_dt = min(self.dt, float(max(CAUTION * part * scale, 1e-3 * self.dt)))

    def follow(self, earlier: Trajectory, t: float) -> None:
        self.load_state_dict(earlier.state_dict() | {"origin": np.array(t)}, 0)
        self.cuts.extend(getattr(earlier, "cuts", ()))

    def step(self) -> None:
        done = 0.0
        wp.copy(self._start, self.state)
        with one_thread():
            while done < self.dt:
                left = self.dt - done
                # the next step fits the remaining time without a very short last step
                dt = min(self.next_dt, 0.5 * left) if self.next_dt < left * (1.0 - 1e-9) else left
                if self._try(self.time + done, dt):
                    # the last one ends the outer step whatever the round-off of the sum
                    done = self.dt if dt >= left else done + dt
            if self.model.limiter is not None:
                self.model.limiter(self.state)
        self.steps += 1

    def _try(self, t: float, dt: float) -> bool:
        """Attempt a step, keep it if it is accurate enough, and set the length of the next one."""
        scheme, solver = self.scheme, self.scheme.solver
        size = scheme.space.norm(self.state)
        change = dt * (solver.rate / size)
        needed = SOLVER * self.tolerance / change if change > 0.0 else math.inf
        solver.largest_tolerance = min(self._largest_tolerance, needed)
        if (fault := scheme.attempt(t, dt)) is not None:
            self._cut(t, dt, fault, MIN_RATIO, "try a finer mesh or more dissipation")
            return False
        error = scheme.error_estimate() / size
        ratio = step_ratio(error, self._before, self.tolerance, self._power)
        if not error <= self.tolerance:  # also rejects NaN
            why = f"relative error of a step {error:.3g} above {self.tolerance:.3g}"
            self._cut(t, dt, why, ratio, "choose a larger tolerance of adaptive")
            return False
        scheme.accept(dt)
        self.state = scheme.state
        self.counters["accepted_steps"] += 1
        if dt >= self.next_dt * (1.0 - 1e-9):
            self.next_dt, self._before = min(self.dt, dt * ratio), error
        else:  # a step shortened to fit the outer one does not shorten the next
            self.next_dt = min(self.dt, max(self.next_dt, dt * ratio))
        return True

    def _cut(self, t: float, dt: float, why: str, ratio: float, advice: str) -> None:
        self.cuts.append(f"at {t:.6g} s a step of {dt:.6g} s was rejected: {why}")
        self.counters["rejected_steps"] += 1
        self.next_dt = dt * ratio
        if self.next_dt < SMALLEST_PART * self.dt:
            wp.copy(self.state, self._start)  # state of `time`
            raise SolverFailed(
                f"{self.name}: even a step of {dt:.3g} s from {t:.0f} s is too long:"
                f" {why}; {advice}"
            )

    def restart_arrays(self) -> dict[str, wp.array]:
        return self.scheme.restart_arrays()

    def numbers(self) -> dict[str, NDArray[Any]]:
        return self.scheme.numbers() | {"adaptive": np.array([self.next_dt, self._before])}

    def load_numbers(self, saved: dict[str, NDArray[Any]], steps: int) -> None:
        """Raise ConfigError if the numbers are not those of an adaptive stepper."""
        if "adaptive" not in saved:
            raise ConfigError("the restart data are of a run with fixed steps: leave adaptive out")
        self.scheme.load_numbers(saved, steps)
        self.origin, self.steps = float(saved["origin"]), steps
        self.next_dt, before = saved["adaptive"].tolist()
        self._before = min(before, self.tolerance)  # which may be stricter than that of before
