"""Measures of the error of a step: to the embedded method, and by the total energy."""

from typing import ClassVar

import numpy as np
import warp as wp

from swe_sphere.equations.energy_conserving import PoissonTendency
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY
from swe_sphere.steppers.stepper import STEPPERS, Stepper
from swe_sphere.steppers.variable_stepper import VariableStepper

ROUNDOFFS = 10.0
"""Changes of the energy by fewer round-offs of it are no drift."""


class Measure:
    """The error of the step last attempted by a scheme, which has not been accepted yet.

    measure(dt) is the error of that step, of dt [s]; measure.per_change(dt) the value that an error
    as large as the present change over dt would have.
    """

    unit: ClassVar[str]
    """What the values are, in words."""

    def __init__(self, scheme: VariableStepper, order: int) -> None:
        """order: the power of dt that the values go with."""
        self._scheme, self.order = scheme, order

    def relative_rate(self) -> float:
        """Rate of the last step [s-1], over the norm of the state."""
        return self._scheme.solver.motion.rate / self._scheme.space.norm(self._scheme.state)


class LocalError(Measure):
    """What the scheme estimates, in the energy norm over the norm of the state, a step.

    Winds and depth times sqrt(g/H) are measured alike [m s-1], so that the ratio means the same in
    any units and on any planet.
    """

    unit = "relative error of a step"

    def __init__(self, scheme: VariableStepper) -> None:
        if scheme.estimate_order is None:
            raise ConfigError(
                f"adaptive: stepper {scheme.name} has no error estimate; take one of "
                f"{_with_estimate()}, or adaptive-by energy"
            )
        super().__init__(scheme, scheme.estimate_order)

    def __call__(self, dt: float) -> float:
        """The estimate of the scheme for the step it attempted last."""
        return self._scheme.error_estimate() / self._scheme.space.norm(self._scheme.state)

    def per_change(self, dt: float) -> float:
        """The relative change over dt [s]."""
        return dt * self.relative_rate()


class EnergyDrift(Measure):
    """Relative change of the total energy I(h |V|^2/2 + g h (h/2 + b)), per day."""

    unit = "relative energy drift per day"

    def __init__(self, scheme: VariableStepper) -> None:
        model = scheme.model
        driven = model.scene.forcing is not None
        if driven or model.dissipative or not PoissonTendency.fits(model):
            raise ConfigError(
                f"adaptive-by energy: {model.scene.name} as set up here does not conserve energy;"
                " take adaptive-by embedded"
            )
        super().__init__(scheme, scheme.order)
        # from the lowest point: from anywhere else the total may be 0, or negative
        self._area, self._bottom = model.mesh.area, model.bottom - model.bottom.min()
        self._gravity = model.scene.planet.gravity

    def __call__(self, dt: float) -> float:
        """The drift over the step, 0 where it is round-off and NaN where it is none."""
        before, after = self._energy(self._scheme.state), self._energy(self._scheme.new)
        drift = abs(after - before) / before
        return 0.0 if drift <= ROUNDOFFS * self._scheme.space.epsilon else drift * DAY / dt

    def per_change(self, dt: float) -> float:
        """The relative change of the energy in a day, were all of the change in its direction."""
        return 2.0 * DAY * self.relative_rate()

    def _energy(self, state: wp.array) -> float:
        model = self._scheme.model
        fluid = model.device_mesh.collect(state[: model.fluid_size])
        u, v, h = fluid.astype(np.float64).reshape(3, -1)
        potential = self._gravity * (h + 2.0 * self._bottom)
        return float(0.5 * np.sum(self._area * h * (u**2 + v**2 + potential)))


MEASURES: dict[str, type[LocalError] | type[EnergyDrift]] = {
    "embedded": LocalError,
    "energy": EnergyDrift,
}
"""Measures by name."""


def make_measure(by: str, scheme: Stepper) -> tuple[VariableStepper, LocalError | EnergyDrift]:
    """The scheme, if its steps can follow an error, and the measure of that name.

    Raises ConfigError where they cannot.
    """
    if by not in MEASURES:
        raise ConfigError(f"adaptive-by: there is no {by!r}; there are {', '.join(MEASURES)}")
    if not isinstance(scheme, VariableStepper) or scheme.family != "implicit":
        raise ConfigError(
            f"adaptive: stepper {scheme.name} only takes equal steps; take one of "
            f"{_with_estimate()}"
        )
    if scheme.diffusion is not None:
        raise ConfigError("adaptive: diffusion apart has no estimate of its error: take it whole")
    return scheme, MEASURES[by](scheme)


def _with_estimate() -> str:
    """Names of the steppers that estimate their error."""
    return ", ".join(k for k, cls in STEPPERS.items() if cls.estimate_order)
