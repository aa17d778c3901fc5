"""A scene on a mesh and a device: the coefficients and fields of its effects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import Effect, PointwiseEffect
from swe_sphere.equations.scene import Scene
from swe_sphere.equations.scene_checks import is_finite
from swe_sphere.equations.scene_functions import fitted
from swe_sphere.errors import ConfigError, shown
from swe_sphere.files.user_file import guarded
from swe_sphere.mesh import Mesh
from swe_sphere.operators import DeviceMesh, Launcher, find_device
from swe_sphere.operators.device_mesh import REALS
from swe_sphere.ranks.communicator import Communicator

SHAPES = ("element", "node")


@dataclass(frozen=True, eq=False)
class DiscreteScene:
    """The scene, where its nodes are, and its coefficients and fields on the device.

    Every model and right-hand side of the scene shares these arrays.
    """

    mesh: Mesh
    scene: Scene
    device_mesh: DeviceMesh
    launch: Launcher
    counters: dict[str, int] = field(
        default_factory=lambda: {"rhs_evaluations": 0, "tangent_evaluations": 0}
    )
    """Evaluations so far."""

    @cached_property
    def fluid(self) -> tuple[str, ...]:
        """Names of the blocks (N,) of wind and depth in a state."""
        return ("h",) if self.scene.wind else ("u", "v", "h")

    @property
    def fluid_size(self) -> int:
        """Length of wind and depth in a state."""
        return len(self.fluid) * self.device_mesh.size

    def zeros(self, size: int) -> wp.array:
        """Return zeros (size,) in the number type of the run."""
        return wp.zeros(size, dtype=self.device_mesh.real, device=self.device_mesh.device)

    @cached_property
    def laplacian(self) -> wp.array:
        """Room for the Laplacian of wind and depth, which all right-hand sides share."""
        return self.zeros(self.fluid_size)

    @cached_property
    def difference(self) -> wp.array:
        """Room for the difference of wind and depth from the base, shared likewise."""
        return self.zeros(self.fluid_size)

    @cached_property
    def wind(self) -> "PrescribedFields":
        """The prescribed wind, if there is one."""
        return PrescribedFields(self, "wind", "uv", self.scene.steady_wind)

    @cached_property
    def forcing(self) -> "PrescribedFields":
        """The prescribed rates of change, if there are any."""
        return PrescribedFields(self, "forcing", self.fluid, self.scene.steady_forcing)

    @cached_property
    def bottom(self) -> Array:
        """Height of the bottom (N,) [m]."""
        return self._on_nodes(self.scene.bottom)

    @cached_property
    def coriolis(self) -> Array:
        """Coriolis parameter (N,) [s-1]."""
        return self._on_nodes(self.scene.coriolis)

    @cached_property
    def parameters(self) -> dict[str, Any]:
        """Coefficients and fields of the effects, by the names that the kernels have for them."""
        mesh, scene, upload = self.device_mesh, self.scene, self.device_mesh.scatter
        parameters: dict[str, Any] = {"gravity": scene.planet.gravity}
        if scene.bottom:
            parameters["bottom"] = upload(self.bottom - self._surface_level())
        if scene.coriolis:
            parameters["coriolis"] = upload(self.coriolis)
        if scene.wind:
            parameters["wind"] = mesh.upload(np.zeros(2 * mesh.size))
        if scene.forcing:
            parameters["forcing"] = mesh.upload(np.zeros(self.fluid_size))
        if scene.base:
            parameters["base"] = upload(np.concatenate(scene.base(self.mesh.lon, self.mesh.lat)))
        for effect in scene.effects:
            mine = self._coefficients(effect)
            parameters |= {effect.name: mine} if isinstance(effect, PointwiseEffect) else mine
        return parameters

    def _coefficients(self, effect: Effect) -> dict[str, Any]:
        """What the terms of an effect read, fields on the device."""
        mesh, label = self.mesh, f"{self.scene.name}: coefficients of {effect.name}"
        found = dict(guarded(label, effect.coefficients, mesh))
        if isinstance(effect, PointwiseEffect) and effect.needs is not None:
            found[effect.needs] = getattr(self.scene, effect.needs)(mesh.lon, mesh.lat)
        for name, value in found.items():
            if np.ndim(value):
                field = fitted(f"{label}: {name}", value, mesh.lon, mesh.lat)
                found[name] = self.device_mesh.scatter(field)
            elif not is_finite(value):
                raise ConfigError(f"{label}: {name} must be finite, not {shown(value)}")
        return found

    def _on_nodes(self, formula: Callable[[Array, Array], Array] | None) -> Array:
        """The field on the nodes, zeros where the scene has none."""
        mesh = self.mesh
        return np.zeros(mesh.size) if formula is None else formula(mesh.lon, mesh.lat)

    def _surface_level(self) -> float:
        """Mean surface height of the initial state [m], exact in float32.

        Bottoms are measured from there.  Gradients do not notice, but h + b is then a small number
        that does not lose the digits of a float32: a lake at rest stays at rest bit for bit.
        """
        _, _, depth = self.scene.initial(self.mesh.lon, self.mesh.lat)
        return float(np.float32(np.average(depth + self.bottom, weights=self.mesh.area)))


class PrescribedFields:
    """Fields on the device that are evaluated on the host, and only when the time changes."""

    def __init__(
        self, discrete: DiscreteScene, name: str, blocks: Sequence[str], steady: bool
    ) -> None:
        """name: of the scene's function, and of the parameter with the blocks (N,) of its results,
        if there is one; steady: once is enough."""
        self._discrete, self._blocks = discrete, blocks
        self._formula = getattr(discrete.scene, name)
        self._target: wp.array | None = discrete.parameters.get(name)
        self.steady = steady or self._target is None
        """Whether they are the same at all times."""
        self._time: float | None = None
        self.mean_of_depth = 0.0
        """Mean over the sphere of what is prescribed for the depth."""

    def set_time(self, t: float) -> None:
        """Bring the fields to time t [s], unless they are there already."""
        if self._target is None or t == self._time:
            return
        if self._time is None or not self.steady:
            wp.copy(self._target, self._discrete.device_mesh.scatter(self._evaluate(t)))
        self._time = t

    def _evaluate(self, t: float) -> Array:
        mesh = self._discrete.mesh
        fields = dict(zip("uvh", self._formula(mesh.lon, mesh.lat, t), strict=False))
        if "h" in fields:
            self.mean_of_depth = float(np.average(fields["h"], weights=mesh.area))
        return np.concatenate([fields[name] for name in self._blocks])


def discretise(
    mesh: Mesh, scene: Scene, device: str, precision: str, shape: str | None, comm: Communicator
) -> DiscreteScene:
    """Return a scene on a mesh and a device; arguments and errors as for `Model`."""
    if precision not in REALS:
        raise ConfigError(f"precision is float64 or float32, not {precision!r}")
    device = find_device(device, comm.local)
    if comm.shared:
        wp.set_device(device)  # which MPI takes to be the rank's own
    shape = shape or ("element" if device == "cpu" else "node")
    if shape not in SHAPES:
        raise ConfigError(f"the launch shape is element or node, not {shape!r}")
    launch = Launcher(device, comm, mesh.np**2)
    device_mesh = DeviceMesh(mesh, device, REALS[precision], shape, comm)
    discrete = DiscreteScene(mesh, scene, device_mesh, launch)
    for prescribed in (discrete.wind, discrete.forcing):
        prescribed.set_time(0.0)  # a function that fails does so before anything is computed
    return discrete
