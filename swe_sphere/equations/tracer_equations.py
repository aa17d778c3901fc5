"""What a state carries behind wind and depth: the masses hq of tracers, or the flux of mass."""

import copy
from typing import Any, Self

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.scene import Scene
from swe_sphere.equations.tendencies import TermsOperator, element_terms
from swe_sphere.kernels import Terms
from swe_sphere.kernels.tracer_step import flux_kernel
from swe_sphere.kernels.tracers import pointwise_kernels
from swe_sphere.mesh import Mesh
from swe_sphere.operators.limiter_operator import Limiter
from swe_sphere.operators.transport_operator import MixingRatio, TracerTransport


def mixing_ratios(scene: Scene, mesh: Mesh) -> dict[str, Array]:
    """The initial mixing ratios (N,) of the scene's tracers by name."""
    formulas = scene.tracers or {}
    return {name: formula(mesh.lon, mesh.lat) for name, formula in formulas.items()}


class TracerEquations:
    """What the right-hand side does to tracers: d(hq)/dt = -div(hq V) + diffusion.

    The wind V is that of the state, or the prescribed one.  The equation is that of the depth with
    hq in the place of h, term by term and rounding by rounding, so that a constant q stays
    constant.  Diffusion acts on q (h + b), as it acts on the depth's h + b: a constant q stays
    constant then too.  Sources of fluid bring no tracer with them.
    """

    def __init__(self, discrete: DiscreteScene) -> None:
        self._discrete = discrete
        self._launch, self._mesh = discrete.launch, discrete.device_mesh
        self.first = discrete.fluid_size
        """Where the first tracer begins in a state vector."""
        self.count = len(discrete.names) - len(discrete.fluid)
        self.depth = self.first - self._mesh.size
        """Where the depth begins."""
        self._wind: wp.array | None = discrete.parameters.get("wind")
        self._transport = TracerTransport(self._mesh, self._launch, self.count)
        terms = element_terms(discrete.scene, "dissipative")
        self._diffusion = _Diffusion(self, discrete, terms) if terms.diffuses else None

    def inviscid(self) -> "TracerEquations":
        """These equations without diffusion; kernels and work arrays are shared."""
        other = copy.copy(self)
        other._diffusion = None
        return other

    def stepping(self, stage: Any) -> Self:
        """These equations without diffusion, whose `tendency` is what the stage makes of it."""
        other = copy.copy(self)
        other._transport, other._diffusion = self._transport.stepping(stage), None
        return other

    def tendency(self, x: wp.array, out: wp.array) -> None:
        """What the whole right-hand side does to tracers at the state x."""
        self.transport(x, out)
        if self._diffusion is not None:
            self._diffusion(x, out)

    def transport(self, x: wp.array, out: wp.array) -> None:
        """Transport alone, by the wind of x."""
        wind = x if self._wind is None else self._wind
        self.carry(wind, x, out)

    def carry(self, wind: wp.array, x: wp.array, out: wp.array) -> None:
        """Transport by a wind (2N, ...)."""
        self._transport(wind, x, self.first, out, self.first)

    def diffuse(self, x: wp.array, out: wp.array) -> None:
        """Diffusion alone."""
        out[self.first :].zero_()
        if self._diffusion is not None:
            self._diffusion(x, out)

    def tangent(self, base: wp.array, direction: wp.array, out: wp.array) -> None:
        """The derivative of `tendency` at the state `base` along a direction."""
        if self._wind is None:
            self._transport.tangent(base, direction, self.first, out)
        else:
            self.transport(direction, out)
        if self._diffusion is not None:
            self._diffusion.tangent(base, direction, out)

    def mixing_ratio(self) -> MixingRatio:
        """New room for the mixing ratios of a state."""
        return MixingRatio(self._mesh, self._launch, self.count, self.depth, self.first)

    def limiter(self) -> Limiter | None:
        """A limiter with the bounds of the initial mixing ratios, if the scene asks for it."""
        mesh, scene = self._discrete.mesh, self._discrete.scene
        effect = scene.effect("tracers")
        if not (isinstance(effect, Tracers) and effect.limiter):
            return None
        ratios = np.stack([*mixing_ratios(scene, mesh).values()])
        lower, upper = ratios.min(axis=1), ratios.max(axis=1)
        return Limiter(self._mesh, self._launch, self.depth, self.first, lower, upper)


class _Diffusion:
    """Adds viscosity and hyperviscosity of q (h + b) to the tendencies of hq."""

    def __init__(self, tracers: TracerEquations, discrete: DiscreteScene, terms: Terms) -> None:
        mesh, size = discrete.device_mesh, discrete.device_mesh.size
        count, real = tracers.count, mesh.real
        self._launch, self._kernels = discrete.launch, pointwise_kernels(real)
        self._dim, self._first = (count, size), tracers.first
        self._offsets = (tracers.depth, tracers.first, size)
        raised = discrete.scene.bottom is not None
        self._bottom = mesh.scatter(discrete.bottom) if raised else None
        self._raised, self._rate = (
            wp.zeros(count * size, dtype=real, device=mesh.device) for _ in range(2)
        )
        blocks = [slice(k * size, (k + 1) * size) for k in range(count)]
        self._fields = [(self._raised[block], self._rate[block]) for block in blocks]
        diffusion, biharmonic = terms.diffusion, terms.biharmonic
        of_field = Terms(wind=True, still=True, diffusion=diffusion, biharmonic=biharmonic)
        self._operator = TermsOperator(discrete, of_field)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """Add the diffusion at the state x to `out`."""
        kernels, bottom = self._kernels, self._bottom
        if bottom is None:
            wp.copy(self._raised, x, src_offset=self._first, count=self._raised.size)
        else:
            self._launch(kernels.raised, self._dim, x, bottom, *self._offsets, self._raised)
        self._add(out)

    def tangent(self, base: wp.array, x: wp.array, out: wp.array) -> None:
        """Add its derivative at the state `base` along x to `out`."""
        if self._bottom is None:
            self(x, out)
            return
        self._launch(
            self._kernels.raised_tangent, self._dim, base, self._bottom, *self._offsets, x,
            self._raised,
        )  # fmt: skip
        self._add(out)

    def _add(self, out: wp.array) -> None:
        for field, rate in self._fields:
            self._operator(field, rate)
        *_, size = self._offsets
        self._launch(self._kernels.add, self._dim, self._rate, self._first, size, out)


class MassFlux:
    """Two blocks G (N,) [m2] in the place of tracers behind wind and depth, with dG/dt = h V.

    Without dissipation and sources dh/dt = -div(dG/dt), and every scheme that combines tendencies
    and states linearly keeps h + div G to round-off: what it has added to G between two times is
    the mass flux with which tracers have to be carried from one to the other.
    """

    names = ("flux_u", "flux_v")

    def __init__(self, discrete: DiscreteScene) -> None:
        self._launch, self._size = discrete.launch, discrete.device_mesh.size
        self.first = discrete.fluid_size
        """Where G begins in a state vector."""
        self.depth = self.first - self._size
        """Where the depth begins."""
        self._kernel = flux_kernel(discrete.device_mesh.real)
        self._stage = discrete.device_mesh.stage
        self._launch.load(self._kernel)

    def stepping(self, stage: Any) -> Self:
        """This flux, whose `tendency` is what the stage makes of it."""
        other = copy.copy(self)
        other._stage = stage
        return other

    def tendency(self, x: wp.array, out: wp.array) -> None:
        """out_G = h V at the state x."""
        self.carry(x, x, out)

    transport = tendency

    def carry(self, wind: wp.array, x: wp.array, out: wp.array) -> None:
        """out_G = h V with the wind in front of `wind`."""
        size = self._size
        self._launch(self._kernel, size, wind, x, self.depth, size, self.first, self._stage, out)

    def diffuse(self, x: wp.array, out: wp.array) -> None:
        """Dissipation is no flux: out_G = 0."""
        out[self.first :].zero_()
