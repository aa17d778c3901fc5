"""Steps of a length that follows their error, by a rule, inside the fixed steps of a run."""

import math
from collections import deque
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.energy_conserving import PoissonTendency
from swe_sphere.errors import ConfigError, SolverFailed
from swe_sphere.files.user_file import users_code
from swe_sphere.planet import DAY
from swe_sphere.ranks.limits import one_thread
from swe_sphere.steppers.stepper import STEPPERS, Stepper, Trajectory
from swe_sphere.steppers.variable_stepper import ImplicitStepper

SAFETY = 0.9
PRESENT, PAST = 0.7, 0.4
"""Exponents of the present error and of the one before, times the order."""
LEAST, MOST = 0.5, 2.0
"""Bounds of the ratio of two successive steps."""
CAUTION = 0.1
"""The first step, as a part of what the time scale of the start allows."""
SOLVER = 0.1
"""Part of the tolerance that may be errors of the solver."""
SMALLEST_PART = 1e-6
"""Steps shorter than this part of the outer step are given up."""
CUTS_KEPT = 100
ROUNDOFFS = 10.0
"""Changes of the energy by fewer round-offs of it are no drift."""


def step_ratio(error: float, before: float, tolerance: float, order: int) -> float:
    """Length of the next step over that of this one, from its error and the one before.

    0.9 (tolerance/error)^(0.7/p) (before/tolerance)^(0.4/p), between 1/2 and 2, p the power of dt
    that the error goes with: proportional-integral control (Gustafsson 1991,
    doi:10.1145/210232.210242; Hairer & Wanner 1996, IV.2).  An error of 0 before tells no trend.
    """
    if not math.isfinite(error):
        return LEAST
    if error == 0.0:
        return MOST
    present: float = (tolerance / error) ** (PRESENT / order)
    past = (before / tolerance) ** (PAST / order) if before > 0.0 else 1.0
    return min(MOST, max(LEAST, SAFETY * present * past))


class LocalError:
    """What a scheme estimates for its last attempt, over the norm of the state.

    Winds and depth times sqrt(g/H) are measured alike [m s-1], so that the ratio means the same in
    any units and on any planet.  `order`: the power of dt that it goes with.
    """

    unit = "relative error of a step"

    def __init__(self, scheme: ImplicitStepper) -> None:
        if scheme.estimate_order is None:
            raise ConfigError(
                f"adaptive: stepper {scheme.name} has no error estimate; take one of "
                f"{_with_estimate()}, or adaptive-by energy"
            )
        self._scheme, self.order = scheme, scheme.estimate_order

    def __call__(self, dt: float) -> float:
        """The error of the step of dt [s] last attempted, which has not been accepted yet."""
        return self._scheme.error_estimate() / self._scheme.space.norm(self._scheme.state)

    def per_change(self, dt: float) -> float:
        """The value that an error as large as the present change over dt [s] would have."""
        return dt * _relative_rate(self._scheme)


class EnergyDrift:
    """Relative change of the total energy I(h |V|^2/2 + g h (h/2 + b)), per day."""

    unit = "relative energy drift per day"

    def __init__(self, scheme: ImplicitStepper) -> None:
        model = scheme.model
        driven = model.scene.forcing is not None
        if driven or model.dissipative or not PoissonTendency.fits(model):
            raise ConfigError(
                f"adaptive-by energy: {model.scene.name} as set up here does not conserve energy;"
                " take adaptive-by embedded"
            )
        self._scheme, self.order = scheme, scheme.order
        # from the lowest point: from anywhere else the total may be 0, or negative
        self._bottom = model.bottom - model.bottom.min()

    def __call__(self, dt: float) -> float:
        """The drift over the step, 0 where it is round-off and NaN where it is none."""
        before, after = self._energy(self._scheme.state), self._energy(self._scheme.new)
        drift = abs(after - before) / before
        return 0.0 if drift <= ROUNDOFFS * self._scheme.space.epsilon else drift * DAY / dt

    def per_change(self, dt: float) -> float:
        """The relative change of the energy in a day, were all of the change in its direction."""
        return 2.0 * DAY * _relative_rate(self._scheme)

    def _energy(self, state: wp.array) -> float:
        model = self._scheme.model
        fluid = model.device_mesh.collect(state[: model.fluid_size])
        u, v, h = fluid.astype(np.float64).reshape(3, -1)
        potential = model.scene.planet.gravity * (h + 2.0 * self._bottom)
        return float(0.5 * np.sum(model.mesh.area * h * (u**2 + v**2 + potential)))


def _relative_rate(scheme: ImplicitStepper) -> float:
    """Rate of the last step [s-1], over the norm of the state."""
    return scheme.solver.rate / scheme.space.norm(scheme.state)


def _with_estimate() -> str:
    return ", ".join(k for k, cls in STEPPERS.items() if cls.estimate_order)


MEASURES: dict[str, type[LocalError] | type[EnergyDrift]] = {
    "embedded": LocalError,
    "energy": EnergyDrift,
}


class AdaptiveSteps(Trajectory):
    """Steps of an implicit scheme that follow their error; `dt` is the outer step, met exactly.

    `by="embedded"`: the difference to the embedded method in the energy norm, over the norm of the
    state, a step.  `by="energy"`: the relative drift of the total energy per day, all of which is
    the time integrator's.  It goes with the error of schemes that damp, though as a sum over the
    globe it may pass through zero, and it says nothing of phases; for schemes that conserve energy
    it only shows that the solver fails.

    The tolerance of the solver is `SOLVER` of this one, or that of the scheme where it is stricter.
    A step that is not good enough, or cannot be solved, is taken again, shorter, and noted in
    `cuts`; no step is longer than the outer one.  `first`: length of the very first step [s].
    Raises ConfigError for what has no such estimate.
    """

    def __init__(
        self, scheme: Stepper, tolerance: float, by: str = "embedded", first: float | None = None
    ) -> None:
        if by not in MEASURES:
            raise ConfigError(f"adaptive-by: there is no {by!r}; there are {', '.join(MEASURES)}")
        if not isinstance(scheme, ImplicitStepper):
            raise ConfigError(
                f"adaptive: stepper {scheme.name} only takes equal steps; take one of "
                f"{_with_estimate()}"
            )
        if scheme.diffusion is not None:
            raise ConfigError(
                "adaptive: diffusion apart has no estimate of its error: take it whole"
            )
        self.scheme, self._measure = scheme, MEASURES[by](scheme)
        for name, value in (("tolerance", tolerance), ("first step", first)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"adaptive: the {name} must be positive and finite, not {value}")
        self.name, self.order = scheme.name, scheme.order  # type: ignore[misc]
        super().__init__(scheme.model, scheme.dt)
        self.state, self.counters = scheme.state, scheme.counters
        self.counters["accepted_steps"] = 0
        self._loosest = scheme.solver.loosest
        self._first, self.tolerance, self._before = first, tolerance, tolerance
        self.next_dt = 0.0
        """Length of the next step [s], if the outer step leaves room for it."""
        self.cuts: deque[str] = deque(maxlen=CUTS_KEPT)
        """The last steps that were taken back, since the start or a restart, in words."""
        self._start = self.model.zeros()

    def start(self, state: wp.array, t: float = 0.0) -> None:
        super().start(state, t)
        self.scheme.start(state, t)
        self._before = self.tolerance
        first, solver = self._first or self.dt, self.scheme.solver
        if self._first is None and solver.rate > 0.0:  # from the time in which the state changes
            scale = solver.space.norm(self.state) / solver.rate
            part = self.tolerance ** (1.0 / self._measure.order)
            first = float(max(CAUTION * part * scale, 1e-3 * self.dt))
        self.next_dt = min(self.dt, first)
        self.cuts.clear()

    def step(self) -> None:
        done = 0.0
        wp.copy(self._start, self.state)
        with users_code(), one_thread():
            while done < self.dt:
                left = self.dt - done
                # the next step is fitted to what is left without leaving a sliver of it
                fits = self.next_dt < left * (1.0 - 1e-9)
                dt = min(self.next_dt, 0.5 * left) if fits else left
                if self._try(self.time + done, dt):
                    # the last one ends the outer step whatever the round-off of the sum
                    done = self.dt if dt >= left else done + dt
            if self.model.limiter is not None:
                self.model.limiter(self.state)
        self.steps += 1

    def _try(self, t: float, dt: float) -> bool:
        """Attempt a step, keep it if it is good, and set the length of the next one."""
        change = self._measure.per_change(dt)
        needed = SOLVER * self.tolerance / change if change > 0.0 else math.inf
        self.scheme.solver.loosest = min(self._loosest, needed)
        fault = self.scheme.attempt(t, dt)
        if fault is not None:
            self._cut(t, dt, fault, LEAST, "try a finer mesh or more dissipation")
            return False
        error = self._measure(dt)
        ratio = step_ratio(error, self._before, self.tolerance, self._measure.order)
        if not error <= self.tolerance:  # nor where it is NaN
            why = f"{self._measure.unit} {error:.3g} above {self.tolerance:.3g}"
            self._cut(t, dt, why, ratio, "choose a larger tolerance of adaptive")
            return False
        self.scheme.accept(dt)
        self.counters["accepted_steps"] += 1
        if dt >= self.next_dt * (1.0 - 1e-9):
            self.next_dt, self._before = min(self.dt, dt * ratio), error
        else:  # after a step that was short to fit the outer one, what came before holds
            self.next_dt = min(self.dt, max(self.next_dt, dt * ratio))
        return True

    def _cut(self, t: float, dt: float, why: str, ratio: float, advice: str) -> None:
        self.cuts.append(f"at {t:.6g} s a step of {dt:.6g} s was taken back: {why}")
        self.counters["rejected_steps"] += 1
        self.next_dt = dt * ratio
        if self.next_dt < SMALLEST_PART * self.dt:
            wp.copy(self.state, self._start)  # that of `time`
            raise SolverFailed(
                f"{self.name}: no step from {t:.0f} s is short enough, the last of {dt:.3g} s:"
                f" {why}; {advice}"
            )

    def costs(self) -> dict[str, float]:
        return self.scheme.costs()

    def state_dict(self) -> dict[str, NDArray[Any]]:
        return self.scheme.state_dict() | {"adaptive": np.array([self.next_dt, self._before])}

    def load_state_dict(self, state: dict[str, NDArray[Any]], steps: int) -> None:
        """Resume from the result of `state_dict` after that many outer steps.

        Raises ConfigError when the state is not that of an adaptive stepper.
        """
        if "adaptive" not in state:
            raise ConfigError("the restart data are of a run with fixed steps: leave adaptive out")
        self.scheme.load_state_dict(state, steps)
        self._origin, self.steps = float(state["origin"]), steps
        self.next_dt, self._before = state["adaptive"].tolist()
