"""Viscosity, hyperviscosity and the edge penalty in separate steps, so that they limit no step.

Viscosity and hyperviscosity are linear and symmetric: a Runge-Kutta-Legendre method of s stages
damps all modes up to a rate times step of (s² + s - 2)/2 (Meyer, Balsara & Aslam 2014,
doi:10.1016/j.jcp.2013.08.021, section 2.2: RKL2, of second order, s at least 2). If first order
suffices and the step is short enough, a single Euler stage replaces them.

The edge penalty removes modes that grow over days, so that it need not act in every step.
"""

import math
from collections.abc import Callable

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.simd.stages import diffusive_stage
from swe_sphere.operators.launch import Span
from swe_sphere.operators.replay import Replay

REACH = 0.75
"""Fraction of the stable interval that is used; near its end damping of fast modes is weak."""
ONE_STAGE = 1.24
"""Largest rate times step of a single stage.  Modes beyond 1 change their sign; at 0.97 of its
limit `forward-backward` amplifies waves whose factor is below -0.24, at 0.95 it does not."""
LONGEST_CYCLE = 24
"""Largest number of steps between two actions of the edge penalty, which are also at most 1.5
radians of inertial oscillations apart: the modes that it removes are such oscillations."""
MIDPOINT = 1.5
"""Largest rate times step for one step of the midpoint rule with the edge penalty."""
MOST_PARTS = 200
"""Largest number of equal parts of an action of the edge penalty."""
HELD = 0.75
"""Largest rate times step for which an implicit step holds the edge penalty unchanged: explicit
steps of a state extrapolated by half a step are stable up to 1."""
MOST_STAGES = 1000
"""Largest number of stages; so many smooth out whole elements in a step."""


def legendre_stages(reach: float, order: int = 2) -> list[tuple[float, float, float, float]]:
    """Return coefficients (mu, nu, a, b) of the stages for a rate times step of up to `reach`.

    The changes are d_j = Y_j - Y_0 = mu d_(j-1) + nu d_(j-2) + a dt F(Y_(j-1)) + b dt F(Y_0).

    Raises ConfigError for more than `MOST_STAGES`.
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
        self.stages = [(mu, nu, dt * a, dt * b) for mu, nu, a, b in stages]
        """Coefficients of the stages of a step, each of which evaluates D once."""
        self._first, self._rate, self._stage = (model.zeros() for _ in range(3))
        self._changes = model.zeros(), model.zeros()
        self._combine = model.device_mesh.over_nodes(diffusive_stage, spans=[Span(0, model.size)])
        self._replay = Replay(model.launch)

    def act(self, state: wp.array) -> None:
        """Diffuse the state without other terms."""
        last, _ = self._changes
        self._replay(state.ptr, self._step, state, None, 1.0, last, state)

    def join(self, past: wp.array, slope: wp.array) -> None:
        """Replace `slope`, the other terms, by the mean slope over dt from `past` with diffusion.

        If D(past) and the slope cancel, the result is zero: steady states stay steady.
        """
        self._step(past, slope, 1.0 / self._dt, slope, self._stage)

    def _step(
        self, x: wp.array, slope: wp.array | None, scale: float, change: wp.array, y: wp.array
    ) -> None:
        """Set change = scale (Y - x), and y = x + change, which is Y if scale is 1.

        Stages are kept as changes: rounded factors of the state itself would change its mass.
        """
        first, stage, (last, before) = self._first, self._stage, self._changes
        held = 0.0 if slope is None else 1.0
        slope = first if slope is None else slope
        last.zero_()
        before.zero_()
        self._model.diffusion(x, first)
        rate = first
        *stages, end = self.stages
        for mu, nu, a, b in stages:
            c = held * (a + b)
            self._combine(x, last, mu, before, nu, rate, a, first, b, slope, c, before, stage)
            last, before, rate = before, last, self._rate
            self._model.diffusion(stage, rate)
        mu, nu, a, b = (scale * c for c in end)
        c = held * (a + b)
        self._combine(x, last, mu, before, nu, rate, a, first, b, slope, c, change, y)


class SplitPenalty:
    """The edge penalty in steps of dt [s]: it acts on the newest level in the middle of a cycle.

    A cycle has an even number of steps, `every`. With `levels` None it uses the midpoint rule.
    Otherwise it takes Euler steps on `levels` successive levels (two for leapfrog); the penalty
    must then be weak enough not to affect waves near the stability limit of the step.
    """

    def __init__(self, model: Model, dt: float, levels: int | None) -> None:
        self._model, self._second_order = model, levels is None
        self._levels = levels or 1
        # largest (cycle, part) times the penalty's largest rate, by the number of levels
        limits = {None: (MIDPOINT, MIDPOINT), 1: (0.7, 1.0)}
        longest_cycle, longest_part = limits.get(levels, (0.5, 1.0))
        radius, rotation = model.penalty_radius, abs(model.scene.planet.rotation)
        rates = (longest_cycle, radius), (0.75, rotation)
        longest = min(a / b if b else math.inf for a, b in rates)
        self.every = max(2, 2 * int(min(longest / (2.0 * dt), LONGEST_CYCLE // 2)))
        self._parts = penalty_parts(self.every * dt * radius / longest_part, dt)
        self._tau = self.every * dt / self._parts
        self._middle, self._change = model.zeros(), model.zeros(2 * model.device_mesh.size)
        self._replay = Replay(model.launch)

    def is_due(self, steps: int, before: int = 0) -> bool:
        """Return whether the penalty acts before the step that follows `steps` after the start.

        before: steps from time 0 to the start. A start between two actions omits the second one.
        """
        turn = (before + steps - self.every // 2) % self.every
        return turn < self._levels and (turn <= steps or not before)

    def act(self, state: wp.array, follow: Callable[[wp.array], None] | None = None) -> None:
        """Damp the wind of the state; `follow` receives the change of the wind (2N,)."""
        self._replay(state.ptr, self._act, state, follow)

    def _act(self, x: wp.array, follow: Callable[[wp.array], None] | None) -> None:
        penalise, tau, point = self._model.penalise, self._tau, x
        combine, change = self._model.launch.combine, self._change
        if follow is not None:
            wp.copy(change, x, count=change.size)
        for _ in range(self._parts):
            if self._second_order:
                point = self._middle
                penalise(x, 0.5 * tau, point, x)
            penalise(point, tau, x, x)
        if follow is not None:
            combine(x, change, -1.0, out=change)
            follow(change)


def penalty_parts(needed: float, dt: float) -> int:
    """Return the number of equal parts of an action; ConfigError for too many in a step dt [s]."""
    if not needed <= MOST_PARTS:
        raise ConfigError(
            f"edge-penalty.c is {needed / MOST_PARTS:.2g} times what steps of {dt:.4g} s allow:"
            " take a smaller c, or a shorter step"
        )
    return max(1, math.ceil(needed))


class HeldPenalty:
    """The edge penalty as a `rate` of the wind that is constant in a step of at most dt [s].

    The equations of an implicit step then cost as much as without the penalty.
    """

    def __init__(self, model: Model, dt: float) -> None:
        penalty_parts(dt * model.penalty_radius / MIDPOINT, dt)
        self.rate = model.zeros(2 * model.device_mesh.size)
        self._model = model
        self._point, self._middle, self._end = (model.zeros() for _ in range(3))

    def find(self, state: wp.array, slope: wp.array, ahead: float, dt: float) -> None:
        """Find the rate for a step of dt [s], at the state extrapolated over `ahead` [s].

        Long steps, where this rate would overshoot, use the mean rate of sub-steps of the penalty.
        The longer a step, the less its state is extrapolated: grid-scale waves must not grow.
        """
        combine, rate, end = self._model.launch.combine, self.rate, self._end
        penalise, reach = self._model.penalise, dt * self._model.penalty_radius
        combine(state, slope, ahead * min(1.0, math.exp(HELD - reach)), out=self._point)
        rate.zero_()
        if reach <= HELD:
            penalise(self._point, 1.0, rate, rate)
            return
        wp.copy(end, self._point)
        parts = penalty_parts(reach / MIDPOINT, dt)
        for _ in range(parts):
            penalise(end, 0.5 * dt / parts, self._middle, end)
            penalise(self._middle, dt / parts, end, end)
        combine(rate, end, 1.0 / dt, self._point, -1.0 / dt, out=rate)
