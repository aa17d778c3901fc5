"""The components a right-hand side is made of, each compiled with the terms of its effects."""

import copy
import inspect
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Self

import numpy as np
import warp as wp

from swe_sphere.equations.discrete_scene import DiscreteScene
from swe_sphere.equations.effects import Effect, PointwiseEffect
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import Terms, combine_kernel
from swe_sphere.kernels.pointwise import NO_POINTWISE, PointTerm, Pointwise
from swe_sphere.operators import PointwiseOperator, TendencyOperator


def element_terms(scene: Scene, component: str) -> Terms:
    """The terms with derivatives, for the kernels over elements."""
    flags = _flags(scene, component)
    return Terms(**{field.name: True for field in fields(Terms) if field.name in flags})


def pointwise_terms(discrete: DiscreteScene, component: str) -> Pointwise:
    """The terms without derivatives, which are added as DSS is made."""
    scene, flags = discrete.scene, _flags(discrete.scene, component)
    tangent = "tangent" in flags
    effects = [e for e in acting(scene, component) if isinstance(e, PointwiseEffect)]
    return Pointwise(
        rotation="rotation" in flags and "wind" not in flags,
        forcing="forcing" in flags,
        terms=tuple(_point_term(effect, discrete, tangent) for effect in effects),
        tangent=tangent,
    )


def acting(scene: Scene, component: str) -> list[Effect]:
    """The effects that a component takes in."""
    if component == "all":
        return [*scene.effects]
    if component == "tangent":
        return [effect for effect in scene.effects if not effect.constant]
    if component == "diffusive":
        return [effect for effect in scene.effects if effect.diffuses]
    damps = component == "dissipative"
    return [effect for effect in scene.effects if effect.dissipation == damps]


def _flags(scene: Scene, component: str) -> set[str]:
    flags = {flag for effect in acting(scene, component) for flag in effect.terms}
    flags |= {flag for effect in scene.effects for flag in effect.everywhere}
    own = {"dissipative": {"still"}, "diffusive": {"still"}, "tangent": {"tangent"}}
    return flags | own.get(component, set())


def _point_term(effect: PointwiseEffect, discrete: DiscreteScene, tangent: bool) -> PointTerm:
    """The formulas of an effect, with those of its coefficients that they read."""
    wind, depth = effect.derivatives if tangent else effect.tendencies
    known = discrete.parameters[effect.name]
    read = {name for f in (wind, depth) if f is not None for name in f.__code__.co_names}
    numbers = tuple(name for name in known if name in read and np.ndim(known[name]) == 0)
    arrays = tuple(name for name in known if name in read and name not in numbers)
    return PointTerm(effect.name, wind, depth, numbers, arrays, _read_around(wind, depth))


def _read_around(*formulas: Callable[..., Any] | None) -> tuple[object, ...]:
    """Constants and functions around formulas that they read, and what functions of Warp read."""
    found: dict[tuple[str, str], object] = {}
    waiting = [formula for formula in formulas if formula is not None]
    while waiting:
        formula = waiting.pop()
        around = inspect.getclosurevars(formula)
        for name, value in {**around.globals, **around.nonlocals}.items():
            place = formula.__module__, name
            if isinstance(value, wp.Function) and value.func is not None and place not in found:
                waiting.append(value.func)
            found[place] = value
    return tuple((*place, type(found[place]), _hashable(found[place])) for place in sorted(found))


def _hashable(value: object) -> object:
    try:
        hash(value)
    except TypeError:
        return str(value)  # of vectors and matrices of Warp: their numbers
    return value


@contextmanager
def _compiling(scene: Scene, point: Pointwise) -> Iterator[None]:
    """Turns what Warp cannot compile of the effects' formulas into a ConfigError."""
    try:
        yield
    except Exception as error:
        if not point.terms:
            raise
        names = ", ".join(term.name for term in point.terms)
        *_, cause = str(error).strip("'").replace("\\n", "\n").splitlines()
        places = re.findall(r'function "\w+" at (.*?):(\d+)', str(error))
        where = "".join(f" ({Path(file).name}, line {line})" for file, line in places[-1:])
        raise ConfigError(
            f"{scene.name}: the formulas of {names} cannot be compiled: {cause.lstrip(';')}{where}"
        ) from error


class Perturbation:
    """What a state has more than the base flow."""

    def __init__(self, discrete: DiscreteScene, base: wp.array) -> None:
        self._launch, self._base = discrete.launch, base
        self._difference = discrete.zeros()
        self._combine = combine_kernel(discrete.device_mesh.real, 1)
        self._launch.load(self._combine)

    def __call__(self, x: wp.array) -> wp.array:
        """x - base, until the next call."""
        self._launch(self._combine, x.size, x, self._base, -1.0, self._difference)
        return self._difference


class TermsOperator:
    """out = compiled terms at x; with hyperviscosity, of the Laplacian that is taken before."""

    def __init__(
        self, discrete: DiscreteScene, terms: Terms, point: Pointwise = NO_POINTWISE
    ) -> None:
        mesh, launch, parameters = discrete.device_mesh, discrete.launch, discrete.parameters
        self._laplacian, self._first = None, None
        if terms.biharmonic:
            size = terms.unknowns * mesh.size
            self._laplacian = wp.zeros(size, dtype=mesh.real, device=mesh.device)
            raised = terms.bottom and not terms.tangent
            once = Terms(wind=terms.wind, bottom=raised, diffusion=True, still=True)
            self._first = TendencyOperator(mesh, once, launch, parameters | {"nu": 1.0})
        mine = {"base": None, **parameters, "laplacian": self._laplacian}
        self.operator: Any
        """What is launched: its kernels, with their arguments."""
        with _compiling(discrete.scene, point):
            if terms.dynamics or terms.diffuses:
                self.operator = TendencyOperator(mesh, terms, launch, mine, point)
            else:
                self.operator = PointwiseOperator(mesh, terms.unknowns, point, launch, mine)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """Evaluate at the state (or direction) x; `out` must be another array."""
        if self._first is not None:
            self._first(x, self._laplacian)
        self.operator(x, out)


class TendencyComponent(TermsOperator):
    """One component of a right-hand side, by name.

    "all", "conservative" and "dissipative", which add up to all, "diffusive", what has weak
    Laplacians of the latter, and "tangent", the derivative of all at the state it is put `at`.  Of
    linearised dynamics all components are such derivatives, at one base, and what they are applied
    to is the difference of the state to it.
    """

    def __init__(self, discrete: DiscreteScene, name: str) -> None:
        terms, point = element_terms(discrete.scene, name), pointwise_terms(discrete, name)
        super().__init__(discrete, terms, point)
        base: wp.array | None = discrete.parameters.get("base")
        derived = (terms.tangent and terms.gradient) or point.needs_base
        self.needs_base = base is None and derived
        """Whether this is a derivative that has to be put `at` a state before it is called."""
        apart = base is not None and name != "tangent"
        self._perturbation = Perturbation(discrete, base) if apart else None

    def at(self, base: wp.array) -> Self:
        """This derivative at a state, whose array is kept; kernels and work arrays are shared."""
        other = copy.copy(self)
        other.operator = self.operator.at(base)
        return other

    def stepping(self, stage: Any) -> Self:
        """This component, whose result is what the stage makes of the rate."""
        other = copy.copy(self)
        other.operator = self.operator.stepping(stage)
        return other

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """out = this component at the state (or direction) x."""
        super().__call__(x if self._perturbation is None else self._perturbation(x), out)
