"""The continuity and the momentum equation stepped one after the other, in a pass each."""

from dataclasses import replace
from typing import Any

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.equations.tendencies import element_terms, pointwise_terms
from swe_sphere.kernels.forward_backward import combine_levels_kernel, level_kernels
from swe_sphere.kernels.local import field_kernels, tendency_kernel
from swe_sphere.operators.pointwise_operator import fill

__all__ = ["Passes"]


class Passes:
    """Steps depth and tracers, or the wind, with the other one held, by explicit Euler steps.

    What the equations are evaluated at are combinations of time levels, which each pass leaves for
    those to come: `carried` (size of a state), the masses and the wind that moves them, and
    `pushed` (of the same size, tracers unused), the wind and the depth whose slope pushes it.  For
    linearised dynamics both are differences to the base.  Under a prescribed wind there is no wind
    to step (`moves`).
    """

    def __init__(self, model: Model) -> None:
        self._model, discrete = model, model.discrete
        mesh, launch, real = discrete.device_mesh, model.launch, discrete.device_mesh.real
        terms = element_terms(model.scene, "conservative")
        point = pointwise_terms(discrete, "conservative")
        self.moves = not terms.wind
        self.carried, self.pushed, self._loss = (model.zeros() for _ in range(3))
        self._masses, self._first = len(model.names) - terms.unknowns + 1, terms.unknowns - 1
        self._base: wp.array | None = model.parameters.get("base")
        self._kernels = level_kernels(terms.unknowns, real, point, model.dissipative)
        self._combine = combine_levels_kernel(real, point.tangent)
        self._structure = fill(self._kernels.structure, {"base": None, **model.parameters}, point)
        launch.load(self._kernels.depth, self._combine)
        self._transport: Any = None
        self._force: Any = None
        of_fields = field_kernels(mesh.mesh.np, real, mesh.shape)
        self._local, self._flat = mesh.local(self._masses, of_fields.value)
        self._local_2, self._flat_2 = mesh.local(2, of_fields.value)
        if terms.dynamics:
            self._transport = of_fields.tangent if terms.tangent else of_fields.transport
            self._geometry = mesh.geometry(of_fields.geometry)
            launch.load(self._transport)
        if terms.gradient:
            made = tendency_kernel(replace(terms, momentum=True), mesh.mesh.np, real, mesh.shape)
            self._force, parameters = made.kernel, model.parameters
            self._force_geometry = mesh.geometry(made.geometry, parameters)
            launch.load(self._force)
        if self.moves:
            launch.load(self._kernels.wind)
        self._triple, self._four = wp.types.vector(3, real), wp.types.vector(4, real)

    def weights(self, *numbers: float) -> Any:
        """Those of three or four time levels, as the passes take them."""
        return (self._triple if len(numbers) == 3 else self._four)(*numbers)

    def damp(self, state: wp.array) -> None:
        """Take the dissipation, which is added to all rates from now on, at a state."""
        if self._model.dissipative:
            self._model.dissipative_tendency(state, self._loss)

    def step_depth(
        self,
        t: float,
        tau: float,
        levels: tuple[wp.array, wp.array, wp.array],
        new: wp.array,
        flows: Any,
        mixes: Any,
    ) -> None:
        """new = now + tau (rate of depth and tracers at `carried` and time t [s]).

        levels: now, past, older; flows: weights of (new, now, past) in the masses of `carried`;
        mixes: those of (new, now, past, older) in the depth of `pushed`.
        """
        model, mesh = self._model, self._model.device_mesh
        model.counters["rhs_evaluations"] += 1
        model.set_time(t)
        size, now = mesh.mesh.size, levels[0]
        if self._transport is not None:
            wind = model.parameters.get("wind", self.carried) if self._base is None else self._base
            model.launch(
                self._transport, mesh.dim, self._geometry, wind, self.carried,
                self._first * size, self._masses, self._local,
            )  # fmt: skip
        model.launch(
            self._kernels.depth, size, mesh.places(self._masses), mesh.inverse_area, mesh.lanes,
            size, self._masses, self._flat, self._structure, tau, *levels, self._loss,
            self._shift(now), flows, mixes, new, self.carried, self.pushed,
        )  # fmt: skip

    def step_wind(
        self,
        tau: float,
        levels: tuple[wp.array, wp.array],
        new: wp.array,
        flows: Any,
        turns: Any,
    ) -> None:
        """new = now + tau (rate of the wind at `pushed`), at the time of the depth's last step.

        levels: now, past; flows, turns: weights of (new, now, past) in the winds of `carried` and
        of `pushed`.
        """
        if not self.moves:
            return
        model, mesh = self._model, self._model.device_mesh
        if self._force is not None:
            model.launch(self._force, mesh.dim, self._force_geometry, self.pushed, self._local_2)
        model.launch(
            self._kernels.wind, mesh.mesh.size, mesh.places(2), mesh.inverse_area, mesh.lanes,
            mesh.mesh.size, self._flat_2, self._structure, tau, *levels, self._loss,
            self._shift(levels[0]), flows, turns, new, self.carried, self.pushed,
        )  # fmt: skip

    def prepare(
        self, levels: tuple[wp.array, wp.array, wp.array], winds: Any, masses: Any, turns: Any
    ) -> None:
        """Make `carried` and the winds of `pushed` from time levels (now, past, older).

        winds, masses: the weights of the levels in those of `carried`; turns: in `pushed`.
        """
        n = self._model.mesh.size
        moving, rest = self._first * n, self._model.size - self._first * n
        for count, first, weights, out in (
            (rest, moving, masses, self.carried),
            (moving, 0, winds, self.carried),
            (moving, 0, turns, self.pushed),
        ):
            if count:
                base = self._shift(levels[0])
                self._model.launch(self._combine, count, first, *levels, weights, base, out)

    def _shift(self, other: wp.array) -> wp.array:
        """The base of linearised dynamics, or whatever other array, which is not read then."""
        return other if self._base is None else self._base
