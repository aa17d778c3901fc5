"""Passive tracers: the blocks of mass hq that a state carries behind wind and depth."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.scene import Scene
from swe_sphere.kernels import Terms
from swe_sphere.kernels.tracers import pointwise_kernels
from swe_sphere.mesh import Mesh
from swe_sphere.operators import TendencyOperator
from swe_sphere.operators.limiter_operator import Limiter
from swe_sphere.operators.transport_operator import MixingRatio, TracerTransport

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model

__all__ = ["TracerPart", "mixing_ratios"]

Array = NDArray[np.float64]


def mixing_ratios(scene: Scene, mesh: Mesh) -> dict[str, Array]:
    """The initial mixing ratios (N,) of the scene's tracers by name."""
    formulas = scene.tracers or {}
    return {name: formula(mesh.lon, mesh.lat) for name, formula in formulas.items()}


class TracerPart:
    """What the right-hand side does to tracers: d(hq)/dt = -div(hq V) + diffusion.

    The wind V is that of the state, or the prescribed one.  The equation is that of the depth with
    hq in the place of h, term by term and rounding by rounding, so that a constant q stays
    constant.  Diffusion acts on q (h + b), as it acts on the depth's h + b: a constant q stays
    constant then too.  Sources of fluid bring no tracer with them.
    """

    def __init__(self, model: "Model") -> None:
        self._launch, self._mesh = model.launch, model.device_mesh
        self.first = model.fluid_size
        """Where the first tracer begins in a state vector."""
        self.count = len(model.names) - model.fluid_size // model.mesh.size
        self.depth = self.first - model.mesh.size
        """Where the depth begins."""
        self._wind: wp.array | None = model.parameters.get("wind")
        self._transport = TracerTransport(
            self._mesh, self._launch, self.count, self._wind is not None
        )
        diffuses = any(model.scene.effect(name) for name in ("viscosity", "hyperviscosity"))
        self._diffusion = _Diffusion(self, model) if diffuses else None
        self._base: wp.array | None = None
        self._model = model

    def tendency(self, x: wp.array, out: wp.array) -> None:
        """The tracers' part of the whole right-hand side at the state x."""
        self.transport(x, out)
        if self._diffusion is not None:
            self._diffusion(x, out)

    def transport(self, x: wp.array, out: wp.array) -> None:
        """Transport alone, by the wind of x."""
        wind = x if self._wind is None else self._wind
        self.carry(wind, x, out)

    def carry(self, wind: wp.array, x: wp.array, out: wp.array) -> None:
        """Transport by a given wind (2N, ...)."""
        self._transport(wind, x, self.first, out, self.first)

    def diffuse(self, x: wp.array, out: wp.array) -> None:
        """Diffusion alone."""
        out[self.first :].zero_()
        if self._diffusion is not None:
            self._diffusion(x, out)

    def linearise(self, state: wp.array) -> None:
        """Make `tangent` the derivative at this state."""
        if self._base is None:
            self._base = self._model.zeros()
        wp.copy(self._base, state)

    def tangent(self, direction: wp.array, out: wp.array) -> None:
        """The derivative of `tendency` along a direction."""
        if self._wind is None:
            self._transport.tangent(self._base, direction, self.first, out)
        else:
            self.transport(direction, out)
        if self._diffusion is not None:
            self._diffusion.tangent(self._base, direction, out)

    def mixing_ratio(self) -> MixingRatio:
        """New room for the mixing ratios of a state."""
        return MixingRatio(self._mesh, self._launch, self.count, self.depth, self.first)

    def limiter(self) -> Limiter | None:
        """A limiter with the bounds of the initial mixing ratios, if the scene asks for it."""
        effect = self._model.scene.effect("tracers")
        if not (isinstance(effect, Tracers) and effect.limiter):
            return None
        ratios = np.stack([*mixing_ratios(self._model.scene, self._model.mesh).values()])
        lower, upper = ratios.min(axis=1), ratios.max(axis=1)
        return Limiter(self._mesh, self._launch, self.depth, self.first, lower, upper)


class _Diffusion:
    """Adds viscosity and hyperviscosity of q (h + b) to the tendencies of hq."""

    def __init__(self, part: TracerPart, model: "Model") -> None:
        mesh, size, real = model.device_mesh, model.mesh.size, model.device_mesh.real
        self._launch, self._kernels = model.launch, pointwise_kernels(real)
        self._dim, self._first = (part.count, size), part.first
        self._offsets = (part.depth, part.first, size)
        self._bottom = mesh.upload(model.bottom) if model.scene.bottom else None
        self._raised, self._rate = (
            wp.zeros(part.count * size, dtype=real, device=mesh.device) for _ in range(2)
        )
        blocks = [slice(k * size, (k + 1) * size) for k in range(part.count)]
        self._fields = [(self._raised[block], self._rate[block]) for block in blocks]
        self._laplacian = wp.zeros(size, dtype=real, device=mesh.device)
        self._operators = self._make_operators(model)

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
        *before, last = self._operators
        for field, rate in self._fields:
            for laplacian in before:
                laplacian(field, self._laplacian)
            last(field, rate)
        *_, size = self._offsets
        self._launch(self._kernels.add, self._dim, self._rate, self._first, size, out)

    def _make_operators(self, model: "Model") -> list[TendencyOperator]:
        """The diffusion of a field; before it, for hyperviscosity, its Laplacian."""
        mesh, launch, parameters = model.device_mesh, model.launch, model.parameters
        terms = Terms(
            wind=True,
            still=True,
            diffusion=model.scene.effect("viscosity") is not None,
            biharmonic=model.scene.effect("hyperviscosity") is not None,
        )
        last = TendencyOperator(mesh, terms, launch, parameters | {"laplacian": self._laplacian})
        if not terms.biharmonic:
            return [last]
        once = Terms(wind=True, still=True, diffusion=True)
        return [TendencyOperator(mesh, once, launch, parameters | {"nu": 1.0}), last]
