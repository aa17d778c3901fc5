"""A scene on a mesh and a device: the coefficients and fields of its effects."""

from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import EdgePenalty, Effect, PointwiseEffect
from swe_sphere.equations.scene import Scene, fitted, is_finite
from swe_sphere.errors import ConfigError, NotCopyable, shown
from swe_sphere.files.user_file import call_custom
from swe_sphere.mesh import Mesh
from swe_sphere.operators import DeviceMesh, find_device
from swe_sphere.operators.device_mesh import REALS
from swe_sphere.operators.tendency import EdgePenaltyOperator
from swe_sphere.ranks.communicator import Communicator


class DiscreteScene(NotCopyable):
    """A scene on the nodes of a mesh: its coefficients and fields on the device."""

    def __init__(self, scene: Scene, device_mesh: DeviceMesh) -> None:
        mesh = device_mesh.mesh
        self.mesh, self.scene, self.device_mesh = mesh, scene, device_mesh
        self.comm, self.device, self.shape = device_mesh.comm, device_mesh.device, device_mesh.shape
        self.precision = device_mesh.numpy_real.name
        self.launch = self.device_mesh.launch
        self.counters: dict[str, float] = {"rhs_evaluations": 0, "tangent_evaluations": 0}
        """Counts by name (evaluations, set-ups, ...), and seconds for names that end in seconds."""
        self.fluid = ("h",) if scene.wind else ("u", "v", "h")
        """Names of the blocks (N,) of wind and depth in a state; blocks of tracers follow them."""
        self.fluid_size = len(self.fluid) * self.device_mesh.size
        self.bottom, self.coriolis = (
            np.zeros(mesh.size) if field is None else np.array(field(mesh.lon, mesh.lat))
            for field in (scene.bottom, scene.coriolis)
        )
        for values in (self.bottom, self.coriolis):
            values.setflags(write=False)
        self.parameters = parameters = _parameters(scene, self.device_mesh, self.bottom)
        """Coefficients and fields of the effects, on the device."""
        wind = parameters.get("wind")
        self.wind = PrescribedFields(device_mesh, scene.wind, wind, "uv", scene.steady_wind)
        limited = getattr(scene.effect("tracers"), "limiter", False)
        no_sources = f"{scene.name} has sources of depth: leave tracers.limiter out"
        if limited and scene.changes_depth:
            raise ConfigError(no_sources)
        self.forcing = PrescribedFields(
            self.device_mesh, scene.forcing, parameters.get("forcing"), self.fluid,
            scene.steady_forcing, no_sources if limited else None,
        )  # fmt: skip
        self.set_time(0.0)  # a faulty function fails before anything is computed
        self.scratch = cache(lambda name: DiscreteScene.zeros(self, self.fluid_size))
        """Scratch array (fluid_size,) by name; models that share arrays use it in turns."""

    held: wp.array | None = None
    """Fixed rate of the wind (2N,) [m s-2], part of the dissipation but of no Jacobian, or None."""

    def zeros(self, size: int) -> wp.array:
        """Return zeros (size,) in the number type of the run."""
        return wp.zeros(size, dtype=self.device_mesh.real, device=self.device)

    @cached_property
    def edge_penalty(self) -> EdgePenaltyOperator:
        """Operator of the edge penalty; ConfigError if the fluid is at rest and no speed is set."""
        effect, mesh = self.scene.effect("edge-penalty"), self.mesh
        assert isinstance(effect, EdgePenalty)
        speed = self.strongest_wind if effect.speed is None else effect.speed
        if speed == 0.0:
            raise ConfigError(
                f"{self.scene.name}: the initial wind or edge-penalty.speed is zero: set"
                " edge-penalty.speed to the wind speed [m s-1] expected later"
            )
        return EdgePenaltyOperator(self.device_mesh, effect.strength(mesh, speed))

    @cached_property
    def strongest_wind(self) -> float:
        """Largest initial wind, or wind of the base of linearised dynamics [m s-1]."""
        u, v, _ = (self.scene.base or self.scene.initial)(self.mesh.lon, self.mesh.lat)
        return float(np.hypot(u, v).max())

    @property
    def growth_time(self) -> float:
        """Approximate time [s] in which computational modes grow tenfold; infinite if none grow.

        The strongest wind circles the planet in this time; below Ω a / 12, modes grow more slowly.
        """
        radius, speed = self.mesh.radius, self.strongest_wind
        damped = any(effect.dissipation for effect in self.scene.effects)
        if damped or speed == 0.0 or self.scene.effect("momentum-advection") is None:
            return np.inf
        slow = abs(self.scene.planet.rotation) * radius / 12.0
        return 2.0 * np.pi * radius / speed * max(1.0, slow / speed)

    def set_time(self, t: float) -> None:
        """Update the prescribed wind and the forcing to time t [s]."""
        self.wind.set_time(t)
        self.forcing.set_time(t)


def place_mesh(
    mesh: Mesh, device: str, precision: str, shape: str | None, comm: Communicator
) -> DeviceMesh:
    """Return the mesh on a device; arguments and errors are those of `Model`."""
    if precision not in REALS:
        raise ConfigError(f"precision must be float64 or float32, got {precision!r}")
    device = find_device(device, comm.local)
    if comm.shared:
        wp.set_device(device)  # MPI takes the current device for that of the rank
    shape = shape or ("element" if device == "cpu" else "node")
    if shape not in ("element", "node"):
        raise ConfigError(f"launch must be element or node, got {shape!r}")
    if shape == "element" and device != "cpu":
        raise ConfigError("launch=element is for CPUs: leave launch out")
    return DeviceMesh(mesh, device, REALS[precision], shape, comm)


def _parameters(scene: Scene, on: DeviceMesh, bottom: Array) -> dict[str, Any]:
    """Return the coefficients and fields of the effects by their names in the kernels."""
    mesh, size = on.mesh, on.size
    parameters: dict[str, Any] = {"gravity": scene.planet.gravity}
    if scene.bottom:
        # Bottoms are measured from the mean surface of the initial state, exact in float32.
        # Gradients do not change, but h + b is then a small number that keeps all digits of a
        # float32: a lake at rest stays at rest bit for bit.
        surface = scene.initial(mesh.lon, mesh.lat)[2] + bottom
        level = float(np.float32(np.average(surface, weights=mesh.area)))
        parameters["bottom"] = on.scatter(bottom - level)
    if scene.coriolis:
        parameters["coriolis"] = on.scatter(scene.coriolis(mesh.lon, mesh.lat))
    if scene.wind:
        parameters["wind"] = on.upload(np.zeros(2 * size))
    if scene.forcing:
        parameters["forcing"] = on.upload(np.zeros((1 if scene.wind else 3) * size))
    if scene.base:
        parameters["base"] = on.scatter(np.concatenate(scene.base(mesh.lon, mesh.lat)))
    parameters["effects"] = own = {}
    for effect in scene.effects:
        mine = _coefficients(scene, effect, on)
        if isinstance(effect, PointwiseEffect):
            own[effect.name] = mine
        else:
            parameters |= mine
    return parameters


def _coefficients(scene: Scene, effect: Effect, on: DeviceMesh) -> dict[str, Any]:
    """Return the coefficients that the terms of an effect read, with fields on the device."""
    mesh, label = on.mesh, f"{scene.name}: coefficients of {effect.name}"
    found = call_custom(label, lambda: dict(effect.coefficients(mesh)))
    if isinstance(effect, PointwiseEffect) and effect.needs is not None:
        found[effect.needs] = getattr(scene, effect.needs)(mesh.lon, mesh.lat)
    for name, value in found.items():
        if np.ndim(value):
            found[name] = on.scatter(fitted(f"{label}: {name}", value, mesh.lon, mesh.lat))
        elif is_finite(number := value[()] if isinstance(value, np.ndarray) else value):
            found[name] = number
        else:
            raise ConfigError(f"{label}: {name} must be finite, got {shown(value)}")
    return found


class PrescribedFields:
    """Fields on the device that the host evaluates again only when the time changes."""

    def __init__(
        self, on: DeviceMesh, formula: Any, target: wp.array | None, blocks: Sequence[str],
        steady: bool, no_sources: str | None = None,
    ) -> None:  # fmt: skip
        """Prepare the fields of a function of the scene.

        formula: the function. target: device array for its results, None if the scene has no such
        function. blocks: names of the blocks (N,) of `target`. steady: evaluate only once.
        no_sources: message of a ConfigError for depth rates other than 0; None: they are permitted.
        """
        self._on, self._formula, self._target, self._blocks = on, formula, target, blocks
        self._no_sources = no_sources
        self.steady = steady or target is None
        """True if the fields are the same at all times."""
        self._time: float | None = None
        self.mean_source = 0.0
        """Mean over the sphere of the prescribed rate of the depth [m s-1]."""

    def set_time(self, t: float) -> None:
        """Update the fields to time t [s], unless they are current."""
        if self._target is None or t == self._time:
            return
        if self._time is None or not self.steady:
            mesh = self._on.mesh
            fields = dict(zip("uvh", self._formula(mesh.lon, mesh.lat, t), strict=False))
            if "h" in fields:
                if self._no_sources is not None and fields["h"].any():
                    raise ConfigError(self._no_sources)
                self.mean_source = float(np.average(fields["h"], weights=mesh.area))
            values = np.concatenate([fields[name] for name in self._blocks])
            wp.copy(self._target, self._on.scatter(values))
        self._time = t
