"""Explicit steppers that step the depth first, and then the wind with the new depth."""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import element_terms, pointwise_terms
from swe_sphere.equations.tracer_equations import MassFlux
from swe_sphere.kernels import Terms, specialise
from swe_sphere.kernels import forward_backward as kernels
from swe_sphere.kernels.dynamics import transport
from swe_sphere.kernels.local import field_kernel, tendency_kernels
from swe_sphere.kernels.pointwise import pointwise_sum
from swe_sphere.kernels.simd.stages import levels_struct
from swe_sphere.operators.launch import MOST_CACHED
from swe_sphere.operators.tendency import fill, filled
from swe_sphere.steppers.flow_limit import NOTHING_BUT_WIND, FlowLimitStepper, wind_share
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.steppers.stability import Complex

Levels = tuple[wp.array, ...]
"""States at several times, the present one first."""


class Passes:
    """Steps depth and tracers, or the wind, by explicit Euler steps, while the other is held.

    The equations are evaluated at combinations of time levels, which each pass stores for later
    passes: `mass_mix` holds the masses; `wind_mix` holds the wind that carries them and enters its
    own equation, and the depth whose gradient accelerates it. Both have the size of a state; in
    linearised dynamics they are differences from the base. A prescribed wind is not stepped. An
    accumulated mass flux gains the flux that steps the depth.
    """

    def __init__(self, model: Model) -> None:
        self._model, mesh = model, model.device_mesh
        self._mesh, self._real = mesh, mesh.real
        terms = element_terms(model.scene, "conservative")
        point = pointwise_terms(model.scene, "conservative", model.parameters)
        self._moves, self._first = not terms.passive, terms.unknowns - 1
        self._flux = model.carried if isinstance(model.carried, MassFlux) else None
        self._mass_fields = 1 if self._flux else len(model.names) - self._first
        self.mass_mix, self.wind_mix, self._loss, self._crossing = (model.zeros() for _ in range(4))
        self._base: wp.array | None = model.parameters.get("base")
        self._shift = self._loss if self._base is None else self._base
        """The base of linearised dynamics, or otherwise an array that is not read."""
        self._combine = specialise(kernels.combine_levels_kernel(point.tangent), self._real)
        self._steps: dict[Any, Any] = {}
        damped, parameters = model.dissipative, {"base": None, **model.parameters}
        moving = terms.dynamics and terms.gradient == self._moves
        direct = mesh.lanes > 1 and not point.tangent and moving
        self._direct, lanes = direct, mesh.lanes if direct else 1
        depth, wind, kind = kernels.run_kernels(terms.unknowns, point, damped)
        begin = mesh.inner if direct else 0
        self._sum_depth = mesh.over_nodes(depth, begin, lanes)
        if self._moves:
            self._sum_wind = mesh.over_nodes(wind, begin, lanes)
        kind = specialise(kind, self._real)
        parameters["point"] = fill(kind.vars["point"].type, parameters, point)
        self._node_geometry = mesh.geometry(kind, parameters)
        """Arguments of the kernels that step the nodes which the elements left out."""
        stepped = {"point": pointwise_sum(terms.unknowns, point), "steps": True} if direct else {}
        types = mesh.types()
        self._local_depth = mesh.scratch(self._mass_fields, types.value)
        self._local_wind = mesh.scratch(2, types.value)
        self._transport = None
        if direct:
            types = mesh.types(terms=Terms(passive=terms.passive, no_transport=True), **stepped)
            self._transport = kernels.carrying_kernel(types, damped, self._mass_fields == 1)
        elif terms.dynamics:
            self._transport = field_kernel(types, transport(terms.tangent))
        self._geometry = mesh.geometry(types.geometry, parameters)
        self._force, self._force_geometry = None, None
        if terms.gradient:
            types = mesh.types(terms=replace(terms, momentum=True), **stepped)
            made = kernels.pushing_kernel(types, damped) if direct else tendency_kernels(types)[0]
            self._force, self._force_geometry = made, mesh.geometry(types.geometry, parameters)
        model.launch.load(*filter(None, (self._transport, self._force, self._combine)))

    def weights(self, *numbers: float) -> Any:
        """Return the weights of three time levels in the format of the passes."""
        return wp.types.vector(3, self._real)(*numbers)

    def damp(self, state: wp.array, t: float) -> None:
        """Compute the dissipation at a state at t [s], which is added to all rates from now on."""
        if self._model.dissipative:
            self._model.set_time(t)
            self._model.dissipative_tendency(state, self._loss)

    def step_depth(
        self, t: float, tau: float, levels: Levels, out: wp.array, masses: Any, depths: Any
    ) -> None:
        """Set out = now + tau (rate of depth and tracers at `mass_mix` and time t [s]).

        levels: now, past; masses, depths: weights of (out, now, past) in the masses of `mass_mix`
        and in the depth of `wind_mix`.
        """
        model, mesh, count, local = self._model, self._mesh, self._mass_fields, self._local_depth
        model.counters["rhs_evaluations"] += 1
        model.set_time(t)
        step = self._step_of(tau, levels, out, masses, depths)
        if self._flux is not None:  # before the elements change `mass_mix`
            self._flux.transport(self.wind_mix, self.mass_mix, self._crossing)
            of_now, rate, of_out = (x[self._flux.first :] for x in (levels[0], self._crossing, out))
            model.launch.combine(of_now, rate, tau, out=of_out)
        if self._transport is not None:
            wind = model.parameters.get("wind", self.wind_mix) if self._base is None else self._base
            first, done = self._first * mesh.size, step if self._direct else out
            inputs = self._geometry, wind, self.mass_mix, first, count, local.values, done
            mesh.over_elements(local, self._transport, mesh.threads(count), *inputs, wait=False)
        layout = self._node_geometry, mesh.places(count), mesh.lanes, count
        self._sum_depth(*layout, local.flat, step)

    def step_wind(self, tau: float, levels: Levels, out: wp.array, winds: Any) -> None:
        """Set out = now + tau (rate of the wind at `wind_mix`), at the time of the last depth step.

        levels: now, past; winds: weights of (out, now, past) in the winds of `wind_mix`.
        """
        if not self._moves:
            return
        mesh, step = self._mesh, self._step_of(tau, levels, out, winds, winds)
        if self._force is not None:
            done = step if self._direct else out
            inputs = self._force_geometry, self.wind_mix, self._local_wind.values, done
            mesh.over_elements(self._local_wind, self._force, mesh.threads(), *inputs, wait=False)
        self._sum_wind(self._node_geometry, mesh.places(2), mesh.lanes, self._local_wind.flat, step)

    def _step_of(self, tau: float, levels: Levels, out: wp.array, weights: Any, depths: Any) -> Any:
        """Return the arguments of kernels of a pass; equal arguments give the same object."""
        key = (tau, *(x.ptr for x in (*levels, out)), *weights, *depths)
        if key not in self._steps:
            if len(self._steps) >= MOST_CACHED:
                self._steps.clear()
            now, past = levels
            given = {"now": now, "past": past, "out": out, "tau": tau, "weights": weights}
            given |= {"depth_weights": depths, "mass_mix": self.mass_mix, "wind_mix": self.wind_mix}
            given |= {"loss": self._loss, "base": self._shift}
            self._steps[key] = filled(levels_struct(self._real), given)
        return self._steps[key]

    def prepare(self, levels: Levels, masses: Any, winds: Any) -> None:
        """Compute both combinations again from (now, past, older) with the given weights."""
        size, moving = self._model.size, self._first * self._mesh.size
        jobs = [(size - moving, moving, masses, self.mass_mix)]
        if self._moves:
            jobs += [(moving, 0, winds, self.wind_mix), (moving, 0, winds, self.mass_mix)]
        for count, first, weights, out in jobs:
            self._model.launch(self._combine, count, first, *levels, weights, self._shift, out)

    def follow(self, change: wp.array, winds: Any) -> None:
        """Update both combinations for a change (2N,) of the wind at the present level."""
        for out in (self.mass_mix, self.wind_mix):
            self._model.launch.combine(wind := out[: change.size], change, winds[0], out=wind)


Triple = tuple[float, float, float]
STRONG = 0.139
"""`wind_share`, U/(U + c), above which the coefficients for strong winds permit longer steps."""


class DepthThenWind(FlowLimitStepper):
    """A stepper whose evaluations are one pass for the depth and then one for the wind.

    Drag and relaxation are evaluated at the start of a step. If diffusion or a limiter changes
    states (`_altered`), the combinations of levels are computed again.
    """

    holds_damping = True
    _wind_weights: Any
    """Weights of the levels in the winds of `wind_mix`."""

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        self._passes = Passes(self.model)
        self._altered = self.diffusion is not None or self.model.limiter is not None
        self.wind_changed = lambda change: self._passes.follow(change, self._wind_weights)


def level_weights(wind: float, mass: float, gamma: float) -> tuple[Triple, Triple, Triple]:
    """Return weights of levels in the generalised AB3-AM4 scheme: of winds, masses and depths.

    AB_b(q) = (3/2 + b) q - (1/2 + 2b) q- + b q--, with b `wind` for the wind and `mass` for the
    masses that it carries. The depth that accelerates the wind is delta h+ + (1 - delta - gamma) h
    + gamma h-; second order requires delta = 1/2 + gamma (third: wind = 1/3 - gamma at rest).
    """
    winds, masses = ((1.5 + b, -0.5 - 2.0 * b, b) for b in (wind, mass))
    return winds, masses, (0.5 + gamma, 0.5 - 2.0 * gamma, gamma)


class ForwardBackward(DepthThenWind):
    """Generalised AB3-AM4: one evaluation a step; the new depth also accelerates the wind.

    Shchepetkin & McWilliams 2005 (doi:10.1016/j.ocemod.2004.08.002), with new coefficients that are
    stable in a wind: `benchmarks/forward_backward.py` derives them. Extrapolated fluxes step
    the depth; extrapolated winds and the gradient of a depth that includes the new one then step
    the wind. Without gravity waves the method is AB3. The first two steps use rk4. Diffusion acts
    on every new level, which damps all modes at any step, to first order.
    """

    name, order, long_run_factor = "forward-backward", 2, 0.76
    levels = "state", "previous", "older"
    memory = *levels, "mass_mix", "wind_mix"
    diffusion_steps = 1
    diffusion_order = 1
    repeats_from: ClassVar[int] = 2
    fused_steps = 4
    waves: ClassVar[Triple] = (1 / 5, 1 / 3, 3 / 20)
    """The wind, mass and gamma of `level_weights`."""
    strong: ClassVar[Triple] = (1 / 5, 1 / 5, 1 / 5)
    """Coefficients for strong winds in the initial state of the scene."""
    advection: ClassVar[Triple] = (5 / 12, 5 / 12, 0.0)
    """Coefficients for flows without gravity waves."""

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        self.previous, self.older = model.zeros(), model.zeros()
        self.mass_mix, self.wind_mix = self._passes.mass_mix, self._passes.wind_mix
        self._starter = RK4(model.unpenalised(), dt)
        rows = level_weights(*self.weights_in(wind_share(model, model.initial_state())))
        weights = [self._passes.weights(*row) for row in rows]
        self._wind_weights, self._mass_weights, self._depth_weights = weights

    @classmethod
    def weights_in(cls, share: float) -> Triple:
        """Return the coefficients for a flow of that `wind_share`."""
        if share == NOTHING_BUT_WIND:
            return cls.advection
        return cls.strong if share > STRONG else cls.waves

    def advance(self) -> None:
        """Step the depth, then the wind; the first two steps are those of rk4."""
        if self.steps < self.repeats_from:
            wp.copy(self.older, self.previous)
            wp.copy(self.previous, self.state)
            self._starter.start(self.state, self.time)
            self._starter.step()
            wp.copy(self.state, self._starter.state)
            if self.steps == 1:
                self._extrapolate()
            return
        now, past, passes, dt = self.state, self.previous, self._passes, self.dt
        new = self.previous
        if self._altered:  # by changes between steps, which need the past level again
            self._extrapolate()
            new = self.older
        passes.damp(now, self.time)
        weights = self._mass_weights, self._depth_weights
        passes.step_depth(self.time + 0.5 * dt, dt, (now, past), new, *weights)
        passes.step_wind(dt, (now, past), new, self._wind_weights)
        if self.diffusion is not None:
            self.diffusion.act(new)

    def swap(self) -> None:
        if self.steps < self.repeats_from:
            return
        if self._altered:
            self.state, self.previous, self.older = self.older, self.state, self.previous
        else:
            self.state, self.previous = self.previous, self.state

    def _extrapolate(self) -> None:
        levels = self.state, self.previous, self.older
        self._passes.prepare(levels, self._mass_weights, self._wind_weights)

    @classmethod
    def propagator(cls, share: float, wave: Complex, wind: Complex, loss: Complex) -> Complex:
        """Return matrices (..., 6, 6) that map three levels of h' sqrt(g/H) and u; see the base."""
        winds, masses, depths = map(np.array, level_weights(*cls.weights_in(share)))
        h, u = np.eye(6).reshape(2, 3, 6)
        new = (1.0 + loss) * h[0] - wind * (masses @ h) - wave * (winds @ u)
        pushed = depths[0] * new + depths[1:] @ h[:2]
        speed = (1.0 + loss) * u[0] - wind * (winds @ u) - wave * pushed
        return np.stack(np.broadcast_arrays(new, *h[:2], speed, *u[:2]), axis=-2)


class ForwardBackwardRK3(DepthThenWind):
    """FB-RK(3,2): three stages; the new depth of a stage also accelerates its wind.

    Lilly et al. 2023 (arXiv:2306.11821), with the weights of github.com/dengwirda/swe-python.
    """

    name, order = "fb-rk3", 2
    repeats_from, fused_steps = 0, 2
    reach = 2.4  # at rest the limit is 4, in any wind at most 3, in fast rotation 2.5
    fractions: ClassVar[tuple[float, ...]] = (1 / 3, 1 / 2, 1.0)
    """Length of each stage, which begins with the step, as a fraction of the step."""
    weights: ClassVar[tuple[float, ...]] = (0.311875, 0.425, 0.3625)

    def __init__(self, model: Model, dt: float) -> None:
        super().__init__(model, dt)
        self._stage = model.zeros()
        self._last = self._wind_weights = self._passes.weights(1.0, 0.0, 0.0)
        self._depth_weights = [self._passes.weights(*row) for row in self._rows()]

    @classmethod
    def _rows(cls) -> tuple[Triple, Triple, Triple]:
        """Return by stage the weights of three depths: new, initial, and of the previous stage."""
        first, second, third = cls.weights
        last = third, third, 1.0 - 2.0 * third
        return (first, 1.0 - first, 0.0), (second, 1.0 - second, 0.0), last

    def start(self, state: wp.array, t: float = 0.0) -> None:
        super().start(state, t)
        self._prepare()

    def load_numbers(self, saved: dict[str, NDArray[Any]], steps: int) -> None:
        super().load_numbers(saved, steps)
        self._prepare()

    def _prepare(self) -> None:
        self._passes.prepare((self.state, self.state, self.state), self._last, self._last)

    def advance(self) -> None:
        now, new, passes = self.state, self._stage, self._passes
        if self._altered:
            self._prepare()
        passes.damp(now, self.time)
        offset = 0.0
        for fraction, depths in zip(self.fractions, self._depth_weights, strict=True):
            tau, t = fraction * self.dt, self.time + offset * self.dt
            passes.step_depth(t, tau, (now, new), new, self._last, depths)
            passes.step_wind(tau, (now, new), new, self._last)
            offset = fraction

    def swap(self) -> None:
        self.state, self._stage = self._stage, self.state

    @classmethod
    def propagator(cls, share: float, wave: Complex, wind: Complex, loss: Complex) -> Complex:
        """Return matrices (..., 2, 2) that map (h' sqrt(g/H), u) over a step; see the base."""
        start_h, start_u = h, u = np.eye(2, dtype=complex)
        for fraction, (a_new, a_now, a_last) in zip(cls.fractions, cls._rows(), strict=True):
            new = start_h + fraction * (loss * start_h - wind * h - wave * u)
            mixed = a_new * new + a_now * start_h + a_last * h
            h, u = new, start_u + fraction * (loss * start_u - wind * u - wave * mixed)
        return np.stack([h, u], axis=-2)
