"""The parts a right-hand side is made of, each compiled with the terms of its effects."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from swe_sphere.equations.effects import Drag, Effect, Hyperviscosity, Relaxation, Viscosity
from swe_sphere.equations.scene import Scene
from swe_sphere.kernels import Terms, combine_kernel
from swe_sphere.kernels.pointwise import Pointwise
from swe_sphere.operators import PointwiseOperator, TendencyOperator

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model

__all__ = ["Part", "device_parameters"]


TANGENTS = ("tangent", "dissipative-tangent")
DISSIPATIVE = ("dissipative", "dissipative-tangent")


def element_terms(scene: Scene, part: str) -> Terms:
    """The terms with derivatives, for the kernels over elements."""
    has = {effect.name for effect in scene.effects}
    terms = Terms(
        advection="momentum-advection" in has and part not in DISSIPATIVE,
        pressure="pressure-gradient" in has and part not in DISSIPATIVE,
        bottom="orography" in has,
        wind="prescribed-wind" in has,
        diffusion="viscosity" in has,
        biharmonic="hyperviscosity" in has,
        tangent=part in TANGENTS or "linearised" in has,
    )
    if part == "conservative":
        return replace(terms, diffusion=False, biharmonic=False)
    return replace(terms, still=True) if part in DISSIPATIVE else terms


def pointwise_terms(scene: Scene, part: str) -> Pointwise:
    """The terms without derivatives, which are added as DSS is made."""
    has = {effect.name for effect in scene.effects}
    drag = next((e for e in scene.effects if isinstance(e, Drag)), Drag())
    point = Pointwise(
        rotation="rotation" in has and "prescribed-wind" not in has and part not in DISSIPATIVE,
        forcing="forcing" in has and part in ("all", "conservative"),
        linear_drag=drag.linear > 0.0,
        quadratic_drag=drag.quadratic > 0.0,
        relaxation="relaxation" in has,
        tangent=part in TANGENTS or "linearised" in has,
    )
    if part == "conservative":
        return replace(point, linear_drag=False, quadratic_drag=False, relaxation=False)
    return point


def _surface_level(model: "Model") -> float:
    """Mean surface height of the initial state [m], exact in float32.

    Bottoms are measured from there.  Gradients do not notice, but h + b is then a small number that
    does not lose the digits of a float32: a lake at rest stays at rest bit for bit.
    """
    mesh = model.mesh
    _, _, depth = model.scene.initial(mesh.lon, mesh.lat)
    return float(np.float32(np.average(depth + model.bottom, weights=mesh.area)))


def device_parameters(model: "Model") -> dict[str, Any]:
    """Coefficients and fields of the effects, on the device."""
    scene, upload = model.scene, model.device_mesh.upload
    parameters: dict[str, Any] = {"gravity": scene.planet.gravity}
    if scene.bottom:
        parameters["bottom"] = upload(model.bottom - _surface_level(model))
    if scene.coriolis:
        parameters["coriolis"] = upload(model.coriolis)
    if scene.wind:
        parameters["wind"] = upload(np.zeros(2 * model.mesh.size))
    if scene.forcing:
        parameters["forcing"] = upload(np.zeros(model.fluid_size))
    if scene.equilibrium:
        parameters["equilibrium"] = upload(scene.equilibrium(model.mesh.lon, model.mesh.lat))
    if scene.base:
        parameters["base"] = upload(np.concatenate(scene.base(model.mesh.lon, model.mesh.lat)))
    for effect in scene.effects:
        parameters |= _coefficients(effect, model)
    return parameters


def _coefficients(effect: Effect, model: "Model") -> dict[str, float]:
    """The numbers a kernel needs of an effect, by the names they have there."""
    if isinstance(effect, Viscosity):
        return {"nu": effect.nu}
    if isinstance(effect, Hyperviscosity):
        return {"nu4": effect.coefficient(model.mesh)}
    if isinstance(effect, Drag):
        return {"linear_drag": effect.linear, "quadratic_drag": effect.quadratic}
    if isinstance(effect, Relaxation):
        return {"relaxation_rate": 1.0 / effect.time}
    return {}


class Perturbation:
    """What a state has more than the base flow."""

    def __init__(self, model: "Model", base: wp.array) -> None:
        self._launch, self._base, self._difference = model.launch, base, model.zeros()
        self._combine = combine_kernel(model.device_mesh.real, 1)
        self._launch.load(self._combine)

    def __call__(self, x: wp.array) -> wp.array:
        """x - base, until the next call."""
        self._launch(self._combine, x.size, x, self._base, -1.0, self._difference)
        return self._difference


class Part:
    """One part of a model's right-hand side, by name.

    "all", "conservative" and "dissipative", which add up to all, "tangent" and
    "dissipative-tangent", which are derivatives at `base`.  With the Laplacian that hyperviscosity
    applies its own Laplacian to.  Of linearised dynamics all parts are such derivatives, at one
    base, and what they are applied to is the difference of the state to it.
    """

    def __init__(self, model: "Model", name: str) -> None:
        mesh, launch, parameters = model.device_mesh, model.launch, model.parameters
        terms, point = element_terms(model.scene, name), pointwise_terms(model.scene, name)
        self.affine = point.tangent or not point.quadratic_drag
        """Whether the dissipation of the state is linear in it, but for a constant."""
        self.base: wp.array | None = parameters.get("base")
        if self.base is None and ((terms.tangent and terms.gradient) or point.speed):
            self.base = model.zeros()
        self._perturbation = None
        if model.scene.base is not None and name not in TANGENTS:
            self._perturbation = Perturbation(model, parameters["base"])
        self._laplacian, self._first = model.zeros() if terms.biharmonic else None, None
        if terms.biharmonic:
            raised = terms.bottom and not terms.tangent
            once = Terms(wind=terms.wind, bottom=raised, diffusion=True, still=True)
            self._first = TendencyOperator(mesh, once, launch, parameters | {"nu": 1.0})
        mine = parameters | {"base": self.base, "laplacian": self._laplacian}
        self._operator: Any
        if point.plain or terms.dynamics or terms.diffuses:
            self._operator = TendencyOperator(mesh, terms, launch, mine, point)
        else:
            self._operator = PointwiseOperator(mesh, terms.unknowns, point, launch, mine)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """out = this part at the state (or direction) x."""
        if self._perturbation is not None:
            x = self._perturbation(x)
        if self._first is not None:
            self._first(x, self._laplacian)
        self._operator(x, out)
