"""The right-hand side of a scene on a mesh and a device."""

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..errors import ConfigError
from ..kernels import Terms
from ..mesh import Mesh
from ..operators import DeviceMesh, Launcher, TendencyOperator, find_device
from ..operators.device_mesh import REALS
from ..operators.diagnose import divergence, vorticity
from .difference import DifferenceProduct
from .effects import Hyperviscosity, Viscosity
from .scene import Scene
from .spectrum import Spectrum, estimate_spectrum

Array = NDArray[np.float64]
SHAPES = ("element", "node")
JACOBIANS = ("exact", "difference")


class Model:
    """Tendencies of the shallow-water equations with exactly the effects of one scene.

    A state is a flat Warp array: N eastward winds, N northward winds [m s-1] and N depths [m], or
    the depths alone where the wind is prescribed.  `shape` chooses the launch shape of the kernels;
    by default one thread a group of elements on a CPU and one thread a node elsewhere.

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
    ) -> None:
        if precision not in REALS:
            raise ConfigError(f"precision is float64 or float32, not {precision!r}")
        self.mesh, self.scene, self.precision = mesh, scene, precision
        self.device = find_device(device)
        self.shape = shape or ("element" if self.device == "cpu" else "node")
        if self.shape not in SHAPES:
            raise ConfigError(f"the launch shape is element or node, not {shape!r}")
        if jacobian not in JACOBIANS:
            raise ConfigError(f"the Jacobian is exact or difference, not {jacobian!r}")
        self.launch = Launcher(self.device)
        self.device_mesh = DeviceMesh(mesh, self.device, REALS[precision], self.shape)
        self.names = ("h",) if scene.wind else ("u", "v", "h")
        self.size = len(self.names) * mesh.size
        self.counters = {"rhs_evaluations": 0, "tangent_evaluations": 0}
        self.bottom = _on_nodes(scene.bottom, mesh)
        self.coriolis = _on_nodes(scene.coriolis, mesh)
        self._wind_time: float | None = None
        self._parameters = self._device_parameters()
        self._parts: dict[str, _Part] = {}
        self._part("all")
        self._difference = DifferenceProduct(self) if jacobian == "difference" else None

    @property
    def compile_seconds(self) -> float:
        """Wall time spent compiling or loading kernels so far [s]."""
        return self.launch.compile_seconds

    @property
    def dissipative(self) -> bool:
        """Whether the scene has viscosity or hyperviscosity."""
        return any(effect.dissipation for effect in self.scene.effects)

    # --- states

    def zeros(self) -> wp.array:
        """A state of zeros."""
        return wp.zeros(self.size, dtype=self.device_mesh.real, device=self.device)

    def state_from(self, u: Array, v: Array, h: Array) -> wp.array:
        """State from winds [m s-1] and depth [m], each (N,)."""
        values = {"u": u, "v": v, "h": h}
        return self.device_mesh.upload(np.concatenate([values[name] for name in self.names]))

    def initial_state(self) -> wp.array:
        """The scene's initial state."""
        return self.state_from(*self.scene.initial(self.mesh.lon, self.mesh.lat))

    def fields(self, state: wp.array, t: float = 0.0) -> dict[str, Array]:
        """Winds u, v [m s-1] and depth h [m] as float64 numpy arrays (N,)."""
        blocks = state.numpy().astype(np.float64).reshape(len(self.names), -1)
        fields = dict(zip(self.names, blocks, strict=True))
        if self.scene.wind:
            u, v = self.scene.wind(self.mesh.lon, self.mesh.lat, t)
            fields = {"u": u, "v": v} | fields
        return fields

    def vorticity(self, state: wp.array, t: float = 0.0) -> Array:
        """Relative vorticity on the nodes (N,) [s-1]."""
        fields = self.fields(state, t)
        return vorticity(self.mesh, fields["u"], fields["v"])

    def divergence(self, state: wp.array, t: float = 0.0) -> Array:
        """Divergence of the wind on the nodes (N,) [s-1]."""
        fields = self.fields(state, t)
        return divergence(self.mesh, fields["u"], fields["v"])

    # --- right-hand sides

    def tendency(self, state: wp.array, t: float, out: wp.array) -> None:
        """out = d state / dt at time t [s], after DSS; counted as one right-hand side."""
        self.counters["rhs_evaluations"] += 1
        self._set_wind(t)
        self._part("all")(state, out)

    def conservative_tendency(self, state: wp.array, t: float, out: wp.array) -> None:
        """The right-hand side without dissipation; counted as one right-hand side."""
        self.counters["rhs_evaluations"] += 1
        self._set_wind(t)
        self._part("conservative")(state, out)

    def dissipative_tendency(self, state: wp.array, out: wp.array) -> None:
        """The dissipation alone, for schemes that step it apart."""
        self._part("dissipative")(state, out)

    def linearise(self, state: wp.array, t: float) -> None:
        """Make `tangent` the derivative of the right-hand side at this state."""
        if self._difference is not None:
            self._difference.linearise(state, t)
            return
        self._set_wind(t)
        part = self._part("tangent")
        if part.base is not None:
            wp.copy(part.base, state)

    def tangent(self, direction: wp.array, out: wp.array) -> None:
        """out = J direction, with J the Jacobian at the state of `linearise`."""
        self.counters["tangent_evaluations"] += 1
        if self._difference is not None:
            self._difference(direction, out)
        else:
            self._part("tangent")(direction, out)

    def spectrum(self, state: wp.array, t: float = 0.0) -> Spectrum:
        """Extent of the spectrum of the Jacobian at a state, which limits explicit steps [s-1]."""
        self._set_wind(t)
        parts = ["conservative"] + ["dissipative"] * self.dissipative
        return estimate_spectrum(self, state, *(self._part(name) for name in parts))

    # --- building

    def _part(self, name: str) -> "_Part":
        """The named part of the right-hand side, compiled when first called for."""
        if not self.dissipative and name == "conservative":
            name = "all"
        if name not in self._parts:
            terms = self._terms(name)
            coriolis = self._parameters.get("coriolis") if name != "dissipative" else None
            base = self.zeros() if name == "tangent" and terms.gradient else None
            self._parts[name] = _Part(self, terms, self._parameters, coriolis, base)
        return self._parts[name]

    def _terms(self, part: str) -> Terms:
        has = {effect.name for effect in self.scene.effects}
        terms = Terms(
            advection="momentum-advection" in has and part != "dissipative",
            pressure="pressure-gradient" in has and part != "dissipative",
            bottom="orography" in has,
            wind="prescribed-wind" in has,
            diffusion="viscosity" in has,
            biharmonic="hyperviscosity" in has,
            tangent=part == "tangent",
        )
        if part == "conservative":
            return replace(terms, diffusion=False, biharmonic=False)
        return replace(terms, still=True) if part == "dissipative" else terms

    def _device_parameters(self) -> dict[str, Any]:
        """Coefficients and fields of the effects, on the device."""
        scene, upload = self.scene, self.device_mesh.upload
        parameters: dict[str, Any] = {"gravity": scene.planet.gravity}
        if scene.bottom:
            parameters["bottom"] = upload(self.bottom)
        if scene.coriolis:
            parameters["coriolis"] = upload(self.coriolis)
        if scene.wind:
            parameters["wind"] = upload(np.zeros(2 * self.mesh.size))
        for effect in scene.effects:
            if isinstance(effect, Viscosity):
                parameters["nu"] = effect.nu
            if isinstance(effect, Hyperviscosity):
                parameters["nu4"] = effect.coefficient(self.mesh)
        return parameters

    def _set_wind(self, t: float) -> None:
        """Bring the prescribed wind to time t, if there is one and it is not there already."""
        if self.scene.wind is None or t == self._wind_time:
            return
        if self._wind_time is None or not self.scene.steady_wind:
            wind = np.concatenate(self.scene.wind(self.mesh.lon, self.mesh.lat, t))
            wp.copy(self._parameters["wind"], self.device_mesh.upload(wind))
        self._wind_time = t


class _Part:
    """Some of the terms, with the Laplacian that hyperviscosity applies its own Laplacian to."""

    def __init__(
        self,
        model: Model,
        terms: Terms,
        parameters: dict[str, Any],
        coriolis: wp.array | None,
        base: wp.array | None,
    ) -> None:
        mesh, launch, self.base = model.device_mesh, model.launch, base
        self._laplacian, self._first = model.zeros() if terms.biharmonic else None, None
        if terms.biharmonic:
            raised = terms.bottom and not terms.tangent
            once = Terms(wind=terms.wind, bottom=raised, diffusion=True, still=True)
            self._first = TendencyOperator(mesh, once, launch, parameters | {"nu": 1.0})
        mine = parameters | {"base": base, "laplacian": self._laplacian}
        self._operator = TendencyOperator(mesh, terms, launch, mine, coriolis)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        if self._first is not None:
            self._first(x, self._laplacian)
        self._operator(x, out)


def _on_nodes(formula: Any, mesh: Mesh) -> Array:
    """The field on the nodes, zeros where the scene has none."""
    return np.zeros(mesh.size) if formula is None else np.asarray(formula(mesh.lon, mesh.lat))
