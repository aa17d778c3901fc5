"""The right-hand side of a scene on a mesh and a device."""

import copy
from functools import cached_property

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.discrete_scene import DiscreteScene, PrescribedFields
from swe_sphere.equations.jacobian import DifferenceJacobian, ExactJacobian, Jacobian
from swe_sphere.equations.scene import Scene, State
from swe_sphere.equations.spectrum import Spectrum, estimate_spectrum, spectral_radius
from swe_sphere.equations.tendencies import TendencyComponent, acting
from swe_sphere.equations.tracer_equations import MassFlux, TracerEquations, mixing_ratios
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.stages import stage_struct
from swe_sphere.mesh import Mesh
from swe_sphere.operators import DeviceMesh, Launcher, find_device
from swe_sphere.operators.device_mesh import REALS
from swe_sphere.ranks.parallel import Alone

SHAPES = ("element", "node")
JACOBIANS = ("exact", "difference")
LEAST_DEPTH = 1e-30
"""A depth below this [m] is none: one over it does not fit into every number of a run."""


class Model:
    """Tendencies of the shallow-water equations with exactly the effects of one scene.

    A state is a flat Warp array: N eastward winds, N northward winds [m s-1] and N depths [m], or
    the depths alone where the wind is prescribed; then the masses hq [m] of tracers, N of each.
    `shape` chooses the launch shape of the kernels; by default one thread a group of elements on a
    CPU and one thread a node elsewhere.  comm: the ranks that share the mesh; by default there are
    none.

    Raises ConfigError for an unknown device, precision, launch shape or kind of Jacobian.
    """

    def __init__(
        self,
        mesh: Mesh,
        scene: Scene,
        device: str = "cpu",
        precision: str = "float64",
        shape: str | None = None,
        jacobian: str = "exact",
        comm: Alone | None = None,
    ) -> None:
        if precision not in REALS:
            raise ConfigError(f"precision is float64 or float32, not {precision!r}")
        if jacobian not in JACOBIANS:
            raise ConfigError(f"the Jacobian is exact or difference, not {jacobian!r}")
        self.mesh, self.scene, self.precision = mesh, scene, precision
        self.comm = comm or Alone()
        """The ranks that share the mesh."""
        self.device = find_device(device, self.comm.local)
        if self.comm.shared:
            wp.set_device(self.device)  # which MPI takes to be the rank's own
        self.shape = shape or ("element" if self.device == "cpu" else "node")
        if self.shape not in SHAPES:
            raise ConfigError(f"the launch shape is element or node, not {shape!r}")
        self.launch = Launcher(self.device, self.comm, mesh.np**2)
        self.device_mesh = DeviceMesh(mesh, self.device, REALS[precision], self.shape, self.comm)
        made = DiscreteScene(mesh, scene, self.device_mesh, self.launch)
        self.discrete = made
        self.names, self.size = made.names, made.size
        self.fluid_size = made.fluid_size
        """Length of wind and depth in a state; tracers come behind them."""
        self.bottom, self.coriolis = made.bottom, made.coriolis
        self.parameters = made.parameters
        """Coefficients and fields of the effects, on the device."""
        self.counters = {"rhs_evaluations": 0, "tangent_evaluations": 0}
        differentiable = all(effect.differentiable for effect in scene.effects)
        self._exact = jacobian == "exact" and differentiable
        self._wind = PrescribedFields(made, "wind", "uv", scene.steady_wind)
        self._forcing = PrescribedFields(made, "forcing", made.fluid, scene.steady_forcing)
        self.set_time(0.0)  # a function that fails does so before anything is computed
        self._components: dict[tuple[object, ...], TendencyComponent] = {}
        self._stepping: TendencyComponent | None = None
        if not self.diffusive:  # else a stepper may want it without diffusion
            self.component("all")
        self.tracers = TracerEquations(made) if scene.tracers else None
        self.carried: TracerEquations | MassFlux | None = self.tracers
        """What a state carries behind wind and depth."""
        self.limiter = None if self.tracers is None else self.tracers.limiter()
        """What steppers have to apply to the state after every step, if anything."""

    @property
    def compile_seconds(self) -> float:
        """Wall time spent compiling or loading kernels so far [s]."""
        return self.launch.compile_seconds

    @property
    def repeats(self) -> bool:
        """Whether a right-hand side is the same launches at all times, with nothing in between."""
        alone = self.limiter is None or not self.comm.shared  # it adds up on the host
        return self._wind.steady and self._forcing.steady and alone

    @property
    def dissipative(self) -> bool:
        """Whether the scene has an effect that damps."""
        return any(effect.dissipation for effect in self.scene.effects)

    @property
    def diffusive(self) -> bool:
        """Whether the scene has viscosity or hyperviscosity."""
        return any(effect.diffuses for effect in self.scene.effects)

    def damping(self, squares: Array) -> Array:
        """Rate [s-1] at which all effects together damp waves of squared wavenumbers [m-2]."""
        total = np.zeros_like(squares)
        for effect in self.scene.effects:
            total += effect.damping(self.mesh, squares)
        return total

    @cached_property
    def inviscid(self) -> "Model":
        """This model without viscosity and hyperviscosity, which shares all arrays and counts."""
        if not self.diffusive:
            return self
        other = copy.copy(self)
        other.discrete = self.discrete.inviscid()
        other.scene, other._components = other.discrete.scene, {}
        other.tracers = self.tracers and self.tracers.inviscid()
        other.carried = other.tracers or self.carried
        return other

    @cached_property
    def carrier(self) -> "Model":
        """This model with what carries tracers in their place, all else shared with it."""
        _ = self.diffusive and self.diffusion_radius  # which is shared as well
        other = copy.copy(self)
        vars(other).pop("inviscid", None)
        other.tracers, other.carried, other.limiter = None, MassFlux(self.discrete), None
        other.names = (*self.discrete.fluid, *MassFlux.names)
        other.size = len(other.names) * self.device_mesh.size
        return other

    def stepping(self, start: wp.array, tau: float) -> "Model":
        """This model without diffusion, whose `tendency` leaves start + tau rate, tau in [s].

        `start` is a state, `out` may be that too.  All else is shared.
        """
        stage = stage_struct(self.device_mesh.real)()
        stage.on, stage.start, stage.tau = True, start, tau
        other = copy.copy(self)
        other._stepping = self.component("all").stepping(stage)
        other.carried = self.carried and self.carried.stepping(stage)
        return other

    # --- states

    def zeros(self) -> wp.array:
        """A state of zeros."""
        return wp.zeros(self.size, dtype=self.device_mesh.real, device=self.device)

    def state_from(self, u: Array, v: Array, h: Array, **tracers: Array) -> wp.array:
        """State from winds [m s-1], depth [m] and mixing ratios by name, each (N,).

        Tracers that are not given have those of the scene's start.  Raises ValueError for arrays
        of another size.
        """
        ratios = mixing_ratios(self.scene, self.mesh) | tracers
        masses = {f"hq_{name}": h * q for name, q in ratios.items()}
        values = {"u": u, "v": v, "h": h} | masses | dict.fromkeys(MassFlux.names, np.zeros(1))
        blocks = [np.broadcast_to(values[name], self.mesh.size) for name in self.names]
        return self.device_mesh.scatter(np.concatenate(blocks))

    def initial_state(self) -> wp.array:
        """The scene's initial state.

        Raises ConfigError where a depth that waves run on, which is that of the base of linearised
        dynamics, is not positive.
        """
        scene, mesh = self.scene, self.mesh
        if scene.wind is None and scene.effect("pressure-gradient") is not None:
            name = "initial" if scene.base is None else "base"
            _check_depth(f"{scene.name}: the {name} depth", getattr(scene, name), mesh)
        return self.state_from(*scene.initial(mesh.lon, mesh.lat))

    def fields(self, state: wp.array, t: float = 0.0) -> dict[str, Array]:
        """Winds u, v [m s-1] and depth h [m] as float64 numpy arrays (N,).

        For each tracer also its mass hq_NAME [m] and its mixing ratio q_NAME.
        """
        blocks = self.device_mesh.collect(state).astype(np.float64).reshape(len(self.names), -1)
        fields = dict(zip(self.names, blocks, strict=True))
        if self.scene.wind:
            u, v = self.scene.wind(self.mesh.lon, self.mesh.lat, t)
            fields = {"u": u, "v": v} | fields
        ratios = {
            f"q_{name}": fields[f"hq_{name}"] / fields["h"] for name in self.scene.tracers or ()
        }
        return fields | ratios

    # --- right-hand sides

    def tendency(self, state: wp.array, t: float, out: wp.array) -> None:
        """out = d state / dt at time t [s], after DSS; counted as one right-hand side."""
        self.counters["rhs_evaluations"] += 1
        self.set_time(t)
        (self._stepping or self.component("all"))(state, out)
        if self.carried is not None:
            self.carried.tendency(state, out)

    def conservative_tendency(self, state: wp.array, t: float, out: wp.array) -> None:
        """The right-hand side without dissipation; counted as one right-hand side."""
        self.fluid_tendency(state, t, out)
        if self.carried is not None:
            self.carried.transport(state, out)

    def fluid_tendency(self, state: wp.array, t: float, out: wp.array) -> None:
        """That of wind and depth alone, also for vectors that hold nothing else."""
        self.counters["rhs_evaluations"] += 1
        self.set_time(t)
        self.component("conservative")(state, out)

    def dissipative_tendency(self, state: wp.array, out: wp.array) -> None:
        """The dissipation alone, for schemes that step it apart."""
        self.fluid_dissipation(state, out)
        if self.carried is not None:
            self.carried.diffuse(state, out)

    def fluid_dissipation(self, state: wp.array, out: wp.array) -> None:
        """That of wind and depth alone, also for vectors that hold nothing else."""
        self.component("dissipative")(state, out)

    def diffusion(self, state: wp.array, out: wp.array) -> None:
        """What viscosity and hyperviscosity do; the scene has one of them."""
        self.component("diffusive")(state, out)
        if self.carried is not None:
            self.carried.diffuse(state, out)

    @cached_property
    def diffusion_radius(self) -> float:
        """Largest rate at which they damp [s-1], the same for all states."""
        operator = self.component("diffusive")
        return spectral_radius(self.discrete, self.initial_state(), operator, reach=1.0)

    def jacobian(self) -> Jacobian:
        """A Jacobian to be kept and brought to one state after the other by its `update`."""
        if self._exact:
            tangent = self.component("tangent")
            return ExactJacobian(self.discrete, tangent, self.tracers, self._wind, self.counters)
        return DifferenceJacobian(self.discrete, self.tendency, self.counters)

    def linearise(self, state: wp.array, t: float) -> Jacobian:
        """The derivative of the right-hand side at a state and time t [s]."""
        return self.jacobian().update(state, t)

    def spectrum(self, state: wp.array, t: float = 0.0) -> Spectrum:
        """Extent of the spectrum of the Jacobian at a state, which limits explicit steps [s-1]."""
        self.set_time(t)
        dissipation = self.fluid_dissipation if self.dissipative else None
        waves = self.component("conservative")
        return estimate_spectrum(self.discrete, state, waves, dissipation)

    def point_of_tangent(self, state: wp.array) -> wp.array:
        """Where the Jacobian is taken: at the state, but of linearised dynamics at their base."""
        return self.parameters.get("base", state)

    # --- what changes in time

    def set_time(self, t: float) -> None:
        """Bring the prescribed wind and the forcing to time t [s]."""
        self._wind.set_time(t)
        self._forcing.set_time(t)

    def mean_source(self, t: float) -> float:
        """Mean of the prescribed rate of change of depth at time t [m s-1], which moves mass."""
        self._forcing.set_time(t)
        return self._forcing.mean_of_depth

    def component(self, name: str) -> TendencyComponent:
        """The named component of the right-hand side, compiled when first called for."""
        effects = tuple(effect.name for effect in acting(self.scene, name))
        key = (name == "tangent", *effects)
        if key not in self._components:
            self._components[key] = TendencyComponent(self.discrete, name)
        return self._components[key]


def _check_depth(name: str, flow: State, mesh: Mesh) -> None:
    depth = flow(mesh.lon, mesh.lat)[2]
    node = int(np.argmin(depth))
    if not depth[node] > LEAST_DEPTH:
        lon, lat = np.degrees((mesh.lon[node], mesh.lat[node]))
        raise ConfigError(
            f"{name} is {depth[node]:.3g} m at longitude {lon:.4g}°, latitude {lat:.4g}°; make the"
            " fluid deeper or the bottom lower: every depth must be positive"
        )
