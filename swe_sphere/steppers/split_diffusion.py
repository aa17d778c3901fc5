"""Viscosity and hyperviscosity on their own, so that they limit no step.

They are linear, symmetric and cheap to keep stable: a Runge-Kutta-Legendre method of s stages
damps all modes up to a rate times step of (s² + s - 2)/2 (Meyer, Balsara & Aslam 2014,
doi:10.1016/j.jcp.2013.08.021, section 2.2: RKL2, of second order).  Where first order will do and
the step is short enough for it, one stage of Euler's is half of that.
"""

import math

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.simd.stages import diffusive_stage
from swe_sphere.operators.launch import Span, in_runs
from swe_sphere.operators.replay import Replay

REACH = 0.75
"""Part of the stable interval that is used: with two or four stages the fastest modes are hardly
damped at its end."""
ONE_STAGE = 1.24
"""Rate times step up to which one stage is taken.  Modes beyond 1 change their sign; at 0.97 of its
limit `forward-backward` amplifies waves of which less than -0.24 is left, at 0.95 it does not."""
MOST_STAGES = 1000
"""So many even out whole elements in a step."""

Stage = tuple[float, float, float, float]


def legendre_stages(reach: float, order: int = 2) -> list[Stage]:
    """Coefficients (mu, nu, a, b) of the stages for a rate times step of up to `reach`.

    For the changes d_j = Y_j - Y_0 = mu d_(j-1) + nu d_(j-2) + a dt F(Y_(j-1)) + b dt F(Y_0).

    Raises ConfigError for so many that no step would ever end.
    """
    if order == 1 and reach <= ONE_STAGE:
        return [(0.0, 0.0, 1.0, 0.0)]
    needed = 0.5 * (math.sqrt(9.0 + 8.0 * reach / REACH) - 1.0)
    if not needed <= MOST_STAGES:
        raise ConfigError(
            f"diffusion would take {needed:.2g} stages a step: take a smaller coefficient of"
            " viscosity or hyperviscosity, or a shorter step"
        )
    stages = max(math.ceil(needed), 2)
    unit = 4.0 / (stages**2 + stages - 2)
    b = [1 / 3, 1 / 3, *((j**2 + j - 2) / (2 * j * (j + 1)) for j in range(2, stages + 1))]
    found = [(0.0, 0.0, unit / 3.0, 0.0)]
    for j in range(2, stages + 1):
        mu = (2 * j - 1) / j * b[j] / b[j - 1]
        nu = -(j - 1) / j * b[j] / b[j - 2]
        found.append((mu, nu, mu * unit, (b[j - 1] - 1.0) * mu * unit))
    return found


class Diffusion:
    """Steps of dt [s] of dy/dt = D(y) + slope, with D the diffusion of a model."""

    def __init__(self, model: Model, dt: float, order: int = 2) -> None:
        self._model, self._dt = model, dt
        stages = legendre_stages(dt * model.diffusion_radius, order)
        self._stages = [(mu, nu, dt * a, dt * b) for mu, nu, a, b in stages]
        self._first, self._rate, self._stage = (model.zeros() for _ in range(3))
        self._changes = model.zeros(), model.zeros()
        mesh = model.device_mesh
        run = mesh.real, mesh.lanes, Span(0, model.size)
        self._combinations = in_runs(model.launch, diffusive_stage, *run)
        self._replay = Replay(model.launch)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of D in a step."""
        return len(self._stages)

    def act(self, state: wp.array) -> None:
        """Diffuse the state by itself."""
        last, _ = self._changes
        self._replay(state.ptr, self._step, state, None, 1.0, last, state)

    def join(self, past: wp.array, slope: wp.array) -> None:
        """Make of the slope of all else, held from `past` on, the mean slope of both together.

        Where D(past) and the slope cancel nothing is left of it: steady states stay.
        """
        self._step(past, slope, 1.0 / self._dt, slope, self._stage)

    def _step(
        self, x: wp.array, slope: wp.array | None, scale: float, change: wp.array, y: wp.array
    ) -> None:
        """change = scale (Y - x) and y = x + change after a step from x.

        Stages are kept as changes: rounded factors of the state itself would add to its mass.
        """
        first, stage, (last, before) = self._first, self._stage, self._changes
        held = 0.0 if slope is None else 1.0
        slope = first if slope is None else slope
        last.zero_()
        before.zero_()
        self._model.diffusion(x, first)
        rate = first
        *stages, end = self._stages
        for mu, nu, a, b in stages:
            c = held * (a + b)
            for combine in self._combinations:
                combine(x, last, mu, before, nu, rate, a, first, b, slope, c, before, stage)
            last, before, rate = before, last, self._rate
            self._model.diffusion(stage, rate)
        mu, nu, a, b = (scale * c for c in end)
        c = held * (a + b)
        for combine in self._combinations:
            combine(x, last, mu, before, nu, rate, a, first, b, slope, c, change, y)
