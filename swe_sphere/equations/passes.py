"""The continuity and the momentum equation stepped in turn, one pass each."""

from dataclasses import replace
from typing import Any

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import element_terms, pointwise_terms
from swe_sphere.equations.tracer_equations import MassFlux
from swe_sphere.kernels import Terms, combine_kernel, specialise
from swe_sphere.kernels.dynamics import transport
from swe_sphere.kernels.forward_backward import (
    carrying_kernel,
    combine_levels_kernel,
    pushing_kernel,
    run_kernels,
)
from swe_sphere.kernels.local import field_kernel, tendency_kernels
from swe_sphere.kernels.pointwise import pointwise_sum
from swe_sphere.kernels.simd.stages import levels_struct
from swe_sphere.operators.launch import REMEMBERED, in_runs
from swe_sphere.operators.tendency import fill

Levels = tuple[wp.array, ...]
"""States at several times, the present one first."""


class Passes:
    """Steps depth and tracers, or the wind, by explicit Euler steps, while the other is held.

    The equations are evaluated at combinations of time levels, which each pass stores for later
    passes: `carried` holds the masses, and `pushed` the wind that moves and turns them, with the
    depth whose slope accelerates it. Both have the size of a state; in linearised dynamics they are
    differences from the base. A prescribed wind is not stepped. A mass flux that the model
    accumulates is that of the depth's own step.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._mesh, self._real = model.device_mesh, model.device_mesh.real
        mesh = self._mesh
        terms = element_terms(model.scene, "conservative")
        point = pointwise_terms(model.scene, "conservative", model.parameters)
        self._moves, self._first = not terms.wind, terms.unknowns - 1
        self._flux = model.carried if isinstance(model.carried, MassFlux) else None
        self._masses = 1 if self._flux else len(model.names) - self._first
        self._crossing, self._add = model.zeros(), combine_kernel(self._real, 1)
        self.carried, self.pushed, self._loss = (model.zeros() for _ in range(3))
        self._base: wp.array | None = model.parameters.get("base")
        self._combine = specialise(combine_levels_kernel(point.tangent), self._real)
        self._steps: dict[Any, Any] = {}
        damped, parameters = model.dissipative, {"base": None, **model.parameters}
        direct = (
            mesh.lanes > 1
            and not point.tangent
            and terms.dynamics
            and terms.gradient == self._moves
        )
        self._direct, lanes = direct, mesh.lanes if direct else 1
        depth, wind, kind = run_kernels(terms.unknowns, point, damped)
        span = self._real, lanes, *mesh.spans(mesh.inner if direct else 0)
        self._depth_sums = in_runs(model.launch, depth, *span)
        self._wind_sums = []
        if self._moves:
            self._wind_sums = in_runs(model.launch, wind, *span)
        kind = specialise(kind, self._real)
        parameters["point"] = fill(kind.vars["point"].type, parameters, point)
        self._node_geometry = mesh.geometry(kind, parameters)
        """Arguments of the kernels that step the nodes which the elements left out."""
        stepped = {"point": pointwise_sum(terms.unknowns, point), "steps": True} if direct else {}
        types = mesh.types()
        self._local_depth = mesh.scratch(self._masses, types.value)
        self._local_wind = mesh.scratch(2, types.value)
        self._transport = None
        if direct:
            types = mesh.types(terms=Terms(wind=terms.wind, still=True), **stepped)
            self._transport = carrying_kernel(types, damped)
        elif terms.dynamics:
            self._transport = field_kernel(types, transport(terms.tangent))
        self._geometry = mesh.geometry(types.geometry, parameters)
        self._force, self._force_geometry = None, None
        if terms.gradient:
            types = mesh.types(terms=replace(terms, momentum=True), **stepped)
            self._force = pushing_kernel(types, damped) if direct else tendency_kernels(types)[0]
            self._force_geometry = mesh.geometry(types.geometry, parameters)
        wanted = [self._transport, self._force, self._combine, self._add]
        model.launch.load(*(kernel for kernel in wanted if kernel is not None))

    def weights(self, *numbers: float) -> Any:
        """Return the weights of three time levels in the format of the passes."""
        return wp.types.vector(3, self._real)(*numbers)

    def damp(self, state: wp.array) -> None:
        """Compute the dissipation at a state, which is added to all rates from now on."""
        if self._model.dissipative:
            self._model.dissipative_tendency(state, self._loss)

    def step_depth(
        self, t: float, tau: float, levels: Levels, out: wp.array, flows: Any, mixes: Any
    ) -> None:
        """Set out = now + tau (rate of depth and tracers at `carried` and time t [s]).

        levels: now, past; flows: weights of (out, now, past) in the masses of `carried`; mixes: the
        weights in the depth of `pushed`.
        """
        model, mesh, size = self._model, self._mesh, self._mesh.size
        model.counters["rhs_evaluations"] += 1
        model.set_time(t)
        step = self._step_of(tau, levels, out, flows, mixes)
        if self._flux is not None:  # before the elements change `carried`
            self._flux.carry(self.pushed, self.carried, self._crossing)
            of_now, rate, of_out = (x[self._flux.first :] for x in (levels[0], self._crossing, out))
            model.launch(self._add, of_now.size, of_now, rate, tau, of_out)
        if self._transport is not None:
            wind = model.parameters.get("wind", self.pushed) if self._base is None else self._base
            local = self._local_depth
            mesh.sweep(model.launch, local)(
                self._transport, mesh.threads(self._masses), 0, self._geometry, wind, self.carried,
                self._first * size, self._masses, local.values, step if self._direct else out,
            )  # fmt: skip
        for sum_depth in self._depth_sums:
            sum_depth(
                self._node_geometry, mesh.places(self._masses), mesh.lanes, self._masses,
                self._local_depth.flat, step,
            )  # fmt: skip

    def step_wind(self, tau: float, levels: Levels, out: wp.array, turns: Any) -> None:
        """Set out = now + tau (rate of the wind at `pushed`), at the time of the last depth step.

        levels: now, past; turns: weights of (out, now, past) in the winds of `pushed`.
        """
        if not self._moves:
            return
        mesh, step = self._mesh, self._step_of(tau, levels, out, turns, turns)
        if self._force is not None:
            done = step if self._direct else out
            local = self._local_wind
            mesh.sweep(self._model.launch, local)(
                self._force, mesh.threads(), 0, self._force_geometry, self.pushed, local.values,
                done,
            )  # fmt: skip
        for sum_wind in self._wind_sums:
            sum_wind(self._node_geometry, mesh.places(2), mesh.lanes, self._local_wind.flat, step)

    def _step_of(self, tau: float, levels: Levels, out: wp.array, weights: Any, mixes: Any) -> Any:
        """Return the arguments of kernels of a pass; equal arguments give the same object."""
        key = (tau, *(x.ptr for x in (*levels, out)), *weights, *mixes)
        if key not in self._steps:
            if len(self._steps) >= REMEMBERED:
                self._steps.clear()
            now, past = levels
            given = {"now": now, "past": past, "out": out, "tau": tau, "weights": weights}
            given |= {"mixes": mixes, "carried": self.carried, "pushed": self.pushed}
            step = levels_struct(self._real)()
            for name, value in (given | {"loss": self._loss, "base": self._shift}).items():
                setattr(step, name, value)
            self._steps[key] = step
        return self._steps[key]

    def prepare(self, levels: Levels, masses: Any, winds: Any) -> None:
        """Compute `carried` and `pushed` again from (now, past, older) with the given weights."""
        size, moving = self._model.size, self._first * self._mesh.size
        jobs = [(size - moving, moving, masses, self.carried)]
        if self._moves:
            jobs += [(moving, 0, winds, self.pushed), (moving, 0, winds, self.carried)]
        for count, first, weights, out in jobs:
            self._model.launch(self._combine, count, first, *levels, weights, self._shift, out)

    def follow(self, change: wp.array, winds: Any) -> None:
        """Update `carried` and `pushed` for a changed wind (2N,) of the present level."""
        for out in (self.carried, self.pushed):
            self._model.launch(self._add, change.size, out, change, winds[0], out)

    @property
    def _shift(self) -> wp.array:
        """The base of linearised dynamics, or otherwise an array that is not read."""
        return self._loss if self._base is None else self._base
