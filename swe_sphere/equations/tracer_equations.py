"""Fields of a state after wind and depth: tracer masses hq, or the mass flux."""

from functools import partial
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.effects import Tracers
from swe_sphere.equations.right_hand_side import Operation, element_terms, term_operations
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import Terms
from swe_sphere.kernels.tracers import mass_flux, surface, surface_tangent
from swe_sphere.mesh import Mesh
from swe_sphere.operators.tracers import Limiter, MixingRatio, TracerTransport

TRANSPORT = ("all", "conservative", "tangent")
"""Components of a right-hand side that contain transport; the others contain only dissipation."""


def mixing_ratios(scene: Scene, mesh: Mesh) -> dict[str, Array]:
    """Return the initial mixing ratios (N,) of the scene's tracers by name."""
    return {name: formula(mesh.lon, mesh.lat) for name, formula in (scene.tracers or {}).items()}


class TracerEquations:
    """The equations of tracers: d(hq)/dt = -div(hq V) + diffusion.

    The wind V is that of the state, or the prescribed wind. The equation is that of the depth with
    hq in place of h, including the order of its roundings, so that a constant q stays constant.
    Diffusion acts on q (h + b), as it acts on h + b in the equation of the depth, which also keeps
    a constant q. Sources of fluid add no tracer.
    """

    def __init__(self, model: DiscreteScene) -> None:
        self._model = model
        self.first = model.fluid_size
        """Offset of the first tracer in a state vector."""
        self.depth = self.first - model.device_mesh.size
        """Offset of the depth."""
        self.names = tuple(f"hq_{name}" for name in model.scene.tracers or ())
        """Names of the blocks (N,)."""
        self.count = len(self.names)
        self._wind: wp.array | None = model.parameters.get("wind")
        self._transport = TracerTransport(model.device_mesh, self.count)
        terms = element_terms(model.scene, "dissipative")
        self._diffusion = _Diffusion(self, model, terms) if terms.diffuses else None

    def operations(self, component: str, base: wp.array | None, stage: Any) -> list[Operation]:
        """Return the operations on tracers of a component; arguments as for `fluid_operations`.

        Raises ConfigError for a stage with diffusion, which can only be added to rates.
        """
        if component not in TRANSPORT:
            operations = [Operation(lambda x, out: out[self.first :].zero_())]
        elif component == "tangent" and self._wind is None:
            transport = self._transport.tangent
            operations = [Operation(lambda x, out: transport(base, x, self.first, out))]
        else:
            wind = self._wind
            operations = [
                Operation(lambda x, out: self.transport(x if wind is None else wind, x, out, stage))
            ]
        if self._diffusion is None or component == "conservative":
            return operations
        if stage is not None:
            raise ConfigError(
                "viscosity of tracers cannot be added in stages: leave out `splits_diffusion`"
            )
        return operations + self._diffusion.operations(base if component == "tangent" else None)

    def transport(self, wind: wp.array, x: wp.array, out: wp.array, stage: Any = None) -> None:
        """Write to `out` the transport of the masses in x: rates, or a stage; wind: (2N, ...)."""
        self._transport(wind, x, self.first, out, self.first, stage)

    def mixing_ratio(self) -> MixingRatio:
        """Return an operator that computes the mixing ratios of a state, with its own arrays."""
        return MixingRatio(self._model.device_mesh, self.count, self.depth, self.first)

    def limiter(self) -> Limiter | None:
        """Return a limiter to the range of initial mixing ratios; None if the scene has none."""
        scene, mesh = self._model.scene, self._model.mesh
        effect = scene.effect("tracers")
        if not (isinstance(effect, Tracers) and effect.limiter):
            return None
        if not scene.initial(mesh.lon, mesh.lat)[2].min() > 0.0:
            raise ConfigError(f"{scene.name}: tracers.limiter needs a positive depth everywhere")
        ratios = np.stack([*mixing_ratios(scene, mesh).values()])
        bounds = ratios.min(axis=1), ratios.max(axis=1)
        return Limiter(self._model.device_mesh, self.depth, self.first, *bounds)


class _Diffusion:
    """Adds viscosity and hyperviscosity of q (h + b) to the tendencies of hq."""

    def __init__(self, tracers: TracerEquations, model: DiscreteScene, terms: Terms) -> None:
        mesh, count = model.device_mesh, tracers.count
        self._model, self._launch = model, model.launch
        self._kernel, self._tangent = model.launch.compile(mesh.real, surface, surface_tangent)
        self._dim, self._first, self._size = (count, mesh.size), tracers.first, mesh.size
        self._offsets = (tracers.depth, tracers.first, mesh.size)
        has_bottom = model.scene.effect("orography") is not None
        height = model.bottom - model.bottom.min()  # so that the datum of b makes no difference
        self._bottom = mesh.scatter(height) if has_bottom else None
        self._raised, self._rate = (model.zeros(count * mesh.size) for _ in range(2))
        diffuses = {"diffusion": terms.diffusion, "biharmonic": terms.biharmonic}
        self._of_field = Terms(passive=True, no_transport=True, **diffuses)

    def operations(self, base: wp.array | None) -> list[Operation]:
        """Return the operations that add the diffusion at a state, or its derivative at `base`."""
        operations = [Operation(partial(self._raise, base), target=self._raised)]
        of_field = term_operations(self._model, self._of_field)
        for k in range(0, self._raised.size, self._size):
            field, rate = (room[k : k + self._size] for room in (self._raised, self._rate))
            for operator, _, target in of_field:
                operations.append(Operation(operator, field, rate if target is None else target))
        return [*operations, Operation(self._add_rates, source=self._rate)]

    def _raise(self, base: wp.array | None, x: wp.array, out: wp.array) -> None:
        known = self._bottom, *self._offsets
        if self._bottom is None:
            wp.copy(out, x, src_offset=self._first, count=out.size)
        elif base is None:
            self._launch(self._kernel, self._dim, x, *known, out)
        else:
            self._launch(self._tangent, self._dim, base, *known, x, out)

    def _add_rates(self, rate: wp.array, out: wp.array) -> None:
        masses = out[self._first : self._first + rate.size]
        self._launch.combine(masses, rate, 1.0, out=masses)


class MassFlux:
    """Two blocks G (N,) [m2] after wind and depth in place of tracers, with dG/dt = h V.

    Without dissipation and sources dh/dt = -div(dG/dt), and every scheme that combines tendencies
    and states linearly keeps h + div G to round-off. The change of G between two times is therefore
    the mass flux that carries tracers in this interval. Dissipation adds nothing to G.
    """

    names = ("flux_u", "flux_v")

    def __init__(self, model: DiscreteScene) -> None:
        self._launch, self._size = model.launch, model.device_mesh.size
        self.first = model.fluid_size
        """Offset of G in a state vector."""
        self._depth, self._rate = self.first - self._size, model.device_mesh.stage
        (self._kernel,) = model.launch.compile(model.device_mesh.real, mass_flux)

    def operations(self, component: str, base: wp.array | None, stage: Any) -> list[Operation]:
        """Return the operations on G of a component; arguments as for `fluid_operations`.

        Raises NotImplementedError for the tangent, which no stepper with this flux needs.
        """
        if component == "tangent":
            raise NotImplementedError("the mass flux has no tangent")
        if component not in TRANSPORT:
            return [Operation(lambda x, out: out[self.first :].zero_())]
        return [Operation(lambda x, out: self.transport(x, x, out, stage))]

    def transport(self, wind: wp.array, x: wp.array, out: wp.array, stage: Any = None) -> None:
        """Set G of `out` to h V, or to a stage; V is the first 2N values of `wind`, h that of x."""
        size, stage = self._size, self._rate if stage is None else stage
        self._launch(self._kernel, size, wind, x, self._depth, size, self.first, stage, out)
