"""A scene on a mesh and a device: its states and its right-hand sides."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations import right_hand_side as rhs
from swe_sphere.equations.discrete_scene import DiscreteScene, place_mesh
from swe_sphere.equations.effects import EFFECTS, Effect
from swe_sphere.equations.jacobian import DifferenceJacobian, ExactJacobian, Jacobian
from swe_sphere.equations.scene import Scene
from swe_sphere.equations.spectrum import SpectralRadii, spectral_radius
from swe_sphere.equations.tracer_equations import MassFlux, TracerEquations, mixing_ratios
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.operators.replay import Replay
from swe_sphere.operators.tracers import Limiter
from swe_sphere.ranks.communicator import Communicator

LEAST_DEPTH = 1e-30
"""Depths below this [m] count as zero: their reciprocal may overflow in the run's precision."""


class Model(DiscreteScene):
    """Tendencies of the shallow-water equations with exactly the effects of one scene.

    A state is a flat Warp array: N eastward winds, N northward winds [m s-1] and N depths [m], or
    the depths alone if the wind is prescribed; then the masses hq [m] of tracers, N of each. Nodes
    are in the order of `device_mesh`; `state_from` and `fields` use the order of the mesh. device:
    a device of Warp. precision: "float64" or "float32". shape: launch shape of kernels over
    elements, "element" (one thread per group of elements, the default on a CPU) or "node" (one per
    element node). comm: the ranks that share the mesh; by default there is only one.

    Raises ConfigError for an unknown device, precision or launch shape.
    """

    def __init__(
        self, mesh: Mesh, scene: Scene, device: str = "cpu", precision: str = "float64",
        shape: str | None = None, comm: Communicator | None = None,
    ) -> None:  # fmt: skip
        super().__init__(scene, place_mesh(mesh, device, precision, shape, comm or Communicator()))
        self._append_carried(flux=False)
        if not (self.diffusive or self.penalised):  # steppers may apply those terms separately
            _ = self.tendency

    def _append_carried(self, flux: bool) -> None:
        """Add tracers to states after wind and depth, or the mass flux that carries them."""
        self.tracers: TracerEquations | None = None
        self.carried: TracerEquations | MassFlux | None = None
        """Fields of a state after wind and depth: tracer masses, the mass flux, or None."""
        if flux:
            self.carried = MassFlux(self)
        elif self.scene.tracers:
            self.carried = self.tracers = TracerEquations(self)
        self.names = (*self.fluid, *(self.carried.names if self.carried else ()))
        """Names of the blocks (N,) of a state."""
        self.size = len(self.names) * self.device_mesh.size
        if self.size >= 2**31:
            raise ConfigError("a state has more than 2^31 numbers on one rank: take more ranks")

    @cached_property
    def limiter(self) -> Limiter | None:
        """Limiter that steppers apply to the state after every step, or None."""
        return None if self.tracers is None else self.tracers.limiter()

    @property
    def dissipative(self) -> bool:
        """True if the scene has an effect that damps, or the model a `held` rate."""
        return self.held is not None or any(effect.dissipation for effect in self.scene.effects)

    @property
    def diffusive(self) -> bool:
        """True if the scene has viscosity or hyperviscosity."""
        return any(effect.diffuses for effect in self.scene.effects)

    @property
    def penalised(self) -> bool:
        """True if the scene has an edge penalty."""
        return self.scene.effect("edge-penalty") is not None

    def damping(self, squares: Array) -> Array:
        """Return the sum [s-1] of each `Effect.damping`; squares: squared wavenumbers [m-2]."""
        rates = (effect.damping(self.mesh, squares) for effect in self.scene.effects)
        return np.asarray(sum(rates, np.zeros_like(squares)))

    @cached_property
    def inviscid(self) -> "Model":
        """The model without viscosity, hyperviscosity and edge penalty; it shares all arrays."""
        return self.without(lambda effect: effect.diffuses or effect.name == "edge-penalty")

    def unpenalised(self, held: wp.array | None = None) -> "Model":
        """Return the model without edge penalty, and with the rate of the wind (2N,) in `held`."""
        return self.without(lambda effect: effect.name == "edge-penalty", held)

    def without(self, left_out: Callable[[Effect], bool], held: wp.array | None = None) -> "Model":
        """Return the model without the effects for which `left_out` is true; arrays are shared."""
        effects = tuple(effect for effect in self.scene.effects if not left_out(effect))
        if len(effects) == len(self.scene.effects) and held is None:
            return self
        scene = replace(self.scene, effects=effects)
        held = self.held if held is None else held
        return self._alike(scene, isinstance(self.carried, MassFlux), held)

    @cached_property
    def flux_model(self) -> "Model":
        """The model with the mass flux in place of tracers; it shares all other arrays."""
        return self._alike(self.scene, True, self.held)

    @cached_property
    def for_solves(self) -> "Model":
        """The model in float32, for the linear systems of Newton's method.

        It is this model itself if it has tracers, whose mixing ratios must stay constant to
        round-off; with custom effects, whose formulas may need the precision of the run; and in
        linear dynamics, where one solve in that precision reaches the tolerance.
        """
        custom = any(effect.name not in EFFECTS for effect in self.scene.effects)
        if self.precision == "float32" or self.scene.linear or self.carried or custom:
            return self
        other = Model.__new__(Model)
        DiscreteScene.__init__(other, self.scene, self.device_mesh.like(wp.float32, self.shape))
        other.counters = self.counters
        other._append_carried(flux=False)
        return other

    def _alike(self, scene: Scene, carries_flux: bool, held: wp.array | None) -> "Model":
        """Return a model with fewer effects, or other fields after wind and depth."""
        other, computed = Model.__new__(Model), vars(Model)
        kept = {k: x for k, x in vars(self).items() if k not in computed}
        vars(other).update(kept, held=held, scene=scene)
        other._append_carried(carries_flux)
        return other

    def zeros(self, size: int | None = None) -> wp.array:
        """Return a state of zeros, or zeros (size,)."""
        return super().zeros(self.size if size is None else size)

    def state_from(self, u: Array, v: Array, h: Array, /, **tracers: Array) -> wp.array:
        """Return a state from winds [m s-1], depth [m] and mixing ratios by name, each (N,).

        Tracers that are not passed get the initial values of the scene. Raises ValueError for
        arrays that do not broadcast to (N,).
        """
        initial = mixing_ratios(self.scene, self.mesh)
        if unknown := tracers.keys() - initial.keys():
            raise ValueError(f"{self.scene.name} has no tracers {', '.join(sorted(unknown))}")
        masses = {f"hq_{name}": h * q for name, q in (initial | tracers).items()}
        values = {"u": u, "v": v, "h": h} | masses | dict.fromkeys(MassFlux.names, np.zeros(1))
        blocks = [np.broadcast_to(values[name], self.mesh.size) for name in self.names]
        return self.device_mesh.scatter(np.concatenate(blocks))

    def initial_state(self) -> wp.array:
        """Return the scene's initial state.

        Raises ConfigError if the depth is zero everywhere, or if the depth under a wind that is not
        prescribed (that of the base in linearised dynamics) is not positive.
        """
        scene, mesh = self.scene, self.mesh
        u, v, h = scene.initial(mesh.lon, mesh.lat)
        if not h.any():
            raise ConfigError(f"{scene.name}: the initial depth is zero everywhere: make it deeper")
        if scene.wind is None:
            name, depth = "initial", h
            if scene.base is not None:
                name, depth = "base", scene.base(mesh.lon, mesh.lat)[2]
            node = int(np.argmin(depth))
            if not depth[node] > LEAST_DEPTH:
                lon, lat = np.degrees((mesh.lon[node], mesh.lat[node]))
                raise ConfigError(
                    f"{scene.name}: the {name} depth is {depth[node]:.3g} m at longitude"
                    f" {lon:.4g}°, latitude {lat:.4g}°; make the fluid deeper or the bottom lower:"
                    " every depth must be positive"
                )
        return self.state_from(u, v, h)

    def fields(self, state: wp.array, t: float = 0.0) -> dict[str, Array]:
        """Return winds u, v [m s-1] and depth h [m] as float64 numpy arrays (N,).

        For each tracer the mass hq_NAME [m] and mixing ratio q_NAME are added. t: time of u, v [s].
        """
        blocks = self.device_mesh.collect(state).astype(np.float64).reshape(len(self.names), -1)
        fields = dict(zip(self.names, blocks, strict=True))
        if self.scene.wind:
            u, v = self.scene.wind(self.mesh.lon, self.mesh.lat, t)
            fields = {"u": u, "v": v} | fields
        names = self.scene.tracers or ()
        with np.errstate(divide="ignore", invalid="ignore"):  # a depth of zero has no mixing ratio
            return fields | {f"q_{name}": fields[f"hq_{name}"] / fields["h"] for name in names}

    def right_hand_side(
        self, component: str = "all", *, stage: tuple[wp.array, float] | None = None,
        base: wp.array | None = None, fluid_only: bool = False, counted: bool = True,
    ) -> rhs.RightHandSide:  # fmt: skip
        """Return a component of the right-hand side: a key of `COMPONENTS`, see `RightHandSide`.

        stage: (start, tau [s]) to compute start + tau rate; the state start may also be the result.
        base: array of the state at which the tangent is taken; it is not copied. fluid_only: only
        the rates of wind and depth, also for vectors without tracers. counted: count evaluations.
        """
        step = None if stage is None else self.device_mesh.stage_at(*stage)
        operations = rhs.fluid_operations(self, component, base, step)
        if self.carried is not None and not fluid_only:
            operations += self.carried.operations(component, base, step)
        counter = rhs.COMPONENTS[component].counter
        fields = (self.wind,) if component == "tangent" else (self.wind, self.forcing)
        return rhs.RightHandSide(
            operations=tuple(operations), counters=self.counters, replay=Replay(self.launch),
            prescribed=tuple(each for each in fields if counter and not each.steady),
            counter=counter if counted else None,
        )  # fmt: skip

    @cached_property
    def tendency(self) -> rhs.RightHandSide:
        """The whole right-hand side: `tendency(state, t, out)`."""
        return self.right_hand_side()

    @cached_property
    def conservative_tendency(self) -> rhs.RightHandSide:
        """The right-hand side without dissipation: `conservative_tendency(state, t, out)`."""
        return self.right_hand_side("conservative")

    @cached_property
    def dissipative_tendency(self) -> rhs.Operator:
        """The dissipation alone, for schemes that step it separately: called as (state, out)."""
        return self.right_hand_side("dissipative").without_time

    @cached_property
    def diffusion(self) -> rhs.Operator:
        """Rates of viscosity and hyperviscosity, called as (state, out); the scene needs one."""
        return self.right_hand_side("diffusive").without_time

    @cached_property
    def diffusion_radius(self) -> float:
        """Largest damping rate of viscosity and hyperviscosity [s-1], the same for all states."""
        radius = self._radius("diffusive", self.initial_state())
        if self.tracers is None or self.scene.effect("orography") is None:
            return radius
        # of tracers q (h + b) is diffused, which exceeds hq; the depth may fall during a run
        _, _, h = (self.scene.base or self.scene.initial)(self.mesh.lon, self.mesh.lat)
        if not h.min() > 0.0:
            raise ConfigError(
                f"{self.scene.name}: over orography tracers diffuse only where the depth is"
                " positive everywhere: make the fluid deeper, or leave diffusion out"
            )
        return 1.25 * radius * float((1.0 + (self.bottom - self.bottom.min()) / h).max())

    @cached_property
    def penalty_radius(self) -> float:
        """Largest damping rate of the edge penalty [s-1], the same for all states."""
        return self._radius("penalising", self.initial_state())

    def _radius(self, component: str, state: wp.array) -> float:
        operator = self.right_hand_side(component, fluid_only=True).without_time
        return spectral_radius(self, state, operator)

    def penalise(self, x: wp.array, tau: float, out: wp.array, start: wp.array) -> None:
        """Set the wind of `out` to that of `start` plus tau [s] times the edge penalty at x."""
        base, source = self.parameters.get("base"), x
        if base is not None:
            source = self.scratch("difference")
            self.launch.combine(x, base, -1.0, out=source)
        self.edge_penalty(source, tau, out, start)

    def jacobian(self) -> Jacobian:
        """Return a new Jacobian; call its `update` with a state and a time before the first use."""
        if not all(effect.differentiable for effect in self.scene.effects):
            return DifferenceJacobian(self, self.names, self.tendency)
        terms = rhs.element_terms(self.scene, "tangent")
        point = rhs.pointwise_terms(self.scene, "tangent", self.parameters)
        depends = "base" not in self.parameters and (terms.gradient or point.needs_base)
        base = self.zeros() if depends or self.tracers is not None else None
        return ExactJacobian(self.right_hand_side("tangent", base=base), base)

    def spectral_radii(self, state: wp.array, t: float = 0.0) -> SpectralRadii:
        """Return the extent [s-1] of the spectrum of the Jacobian, which limits explicit steps."""
        waves = self.right_hand_side("conservative", fluid_only=True, counted=False)
        wave = spectral_radius(self, state, lambda x, out: waves(x, t, out))
        return SpectralRadii(wave, self.dissipation_radius(state))

    def dissipation_radius(self, state: wp.array) -> float:
        """Return the largest damping rate of all dissipation at a state [s-1]."""
        return self._radius("dissipative", state) if self.dissipative else 0.0

    def point_of_tangent(self, state: wp.array) -> wp.array:
        """Return the state at which the Jacobian is taken: the base in linearised dynamics."""
        return self.parameters.get("base", state)

    def mean_source(self, t: float) -> float:
        """Return the mean prescribed rate of change of depth at time t [m s-1]."""
        self.forcing.set_time(t)
        return self.forcing.mean_source
