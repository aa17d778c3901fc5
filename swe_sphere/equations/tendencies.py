"""The components a right-hand side is made of, each compiled with the terms of its effects."""

import copy
from dataclasses import replace
from typing import Any, Self

import warp as wp

from swe_sphere.equations.discretisation import Discretisation
from swe_sphere.equations.effects import Drag
from swe_sphere.equations.scene import Scene
from swe_sphere.kernels import Terms, combine_kernel
from swe_sphere.kernels.pointwise import Pointwise
from swe_sphere.operators import PointwiseOperator, TendencyOperator

__all__ = ["TendencyComponent", "element_terms"]


def element_terms(scene: Scene, component: str) -> Terms:
    """The terms with derivatives, for the kernels over elements."""
    has = {effect.name for effect in scene.effects}
    terms = Terms(
        advection="momentum-advection" in has and component != "dissipative",
        pressure="pressure-gradient" in has and component != "dissipative",
        bottom="orography" in has,
        wind="prescribed-wind" in has,
        diffusion="viscosity" in has,
        biharmonic="hyperviscosity" in has,
        tangent=component == "tangent" or "linearised" in has,
    )
    if component == "conservative":
        return replace(terms, diffusion=False, biharmonic=False)
    return replace(terms, still=True) if component == "dissipative" else terms


def pointwise_terms(scene: Scene, component: str) -> Pointwise:
    """The terms without derivatives, which are added as DSS is made."""
    has = {effect.name for effect in scene.effects}
    drag = next((e for e in scene.effects if isinstance(e, Drag)), Drag())
    point = Pointwise(
        rotation="rotation" in has and "prescribed-wind" not in has and component != "dissipative",
        forcing="forcing" in has and component in ("all", "conservative"),
        linear_drag=drag.linear > 0.0,
        quadratic_drag=drag.quadratic > 0.0,
        relaxation="relaxation" in has,
        tangent=component == "tangent" or "linearised" in has,
    )
    if component == "conservative":
        return replace(point, linear_drag=False, quadratic_drag=False, relaxation=False)
    return point


class Perturbation:
    """What a state has more than the base flow."""

    def __init__(self, discretisation: Discretisation, base: wp.array) -> None:
        self._launch, self._base = discretisation.launch, base
        self._difference = discretisation.zeros()
        self._combine = combine_kernel(discretisation.device_mesh.real, 1)
        self._launch.load(self._combine)

    def __call__(self, x: wp.array) -> wp.array:
        """x - base, until the next call."""
        self._launch(self._combine, x.size, x, self._base, -1.0, self._difference)
        return self._difference


class TendencyComponent:
    """One component of a right-hand side, by name.

    "all", "conservative" and "dissipative", which add up to all, and "tangent", the derivative of
    all at the state it is put `at`.  With the Laplacian that hyperviscosity applies its own
    Laplacian to.  Of linearised dynamics all components are such derivatives, at one base, and what
    they are applied to is the difference of the state to it.
    """

    def __init__(self, discretisation: Discretisation, name: str) -> None:
        mesh, launch = discretisation.device_mesh, discretisation.launch
        scene, parameters = discretisation.scene, discretisation.parameters
        terms, point = element_terms(scene, name), pointwise_terms(scene, name)
        base: wp.array | None = parameters.get("base")
        derived = (terms.tangent and terms.gradient) or point.speed
        self.needs_base = base is None and derived
        """Whether this is a derivative that has to be put `at` a state before it is called."""
        self._perturbation = None
        if base is not None and name != "tangent":
            self._perturbation = Perturbation(discretisation, base)
        self._laplacian, self._first = None, None
        if terms.biharmonic:
            self._laplacian = discretisation.zeros()
            raised = terms.bottom and not terms.tangent
            once = Terms(wind=terms.wind, bottom=raised, diffusion=True, still=True)
            self._first = TendencyOperator(mesh, once, launch, parameters | {"nu": 1.0})
        mine = parameters | {"base": base, "laplacian": self._laplacian}
        self.operator: Any
        """What is launched: its kernels, with their arguments."""
        if point.plain or terms.dynamics or terms.diffuses:
            self.operator = TendencyOperator(mesh, terms, launch, mine, point)
        else:
            self.operator = PointwiseOperator(mesh, terms.unknowns, point, launch, mine)

    def at(self, base: wp.array) -> Self:
        """This derivative at a state, whose array is kept; kernels and work arrays are shared."""
        other = copy.copy(self)
        other.operator = self.operator.at(base)
        return other

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """out = this component at the state (or direction) x."""
        if self._perturbation is not None:
            x = self._perturbation(x)
        if self._first is not None:
            self._first(x, self._laplacian)
        self.operator(x, out)
