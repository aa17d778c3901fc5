"""The terms that kernels are compiled with for the effects of a scene."""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.equations.effects import Effect, PointwiseEffect
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import Terms
from swe_sphere.kernels.pointwise import PointTerm, Pointwise


def element_terms(scene: Scene, component: str) -> Terms:
    """Return the terms with derivatives, for the kernels over elements."""
    flags = _flags(scene, component)
    return Terms(**{field.name: True for field in fields(Terms) if field.name in flags})


def pointwise_terms(scene: Scene, component: str, parameters: Mapping[str, Any]) -> Pointwise:
    """Return the terms without derivatives, which are added by DSS.

    parameters: the coefficients of each effect, by its name.
    """
    flags = _flags(scene, component)
    tangent = "tangent" in flags
    effects = [e for e in _acting(scene, component) if isinstance(e, PointwiseEffect)]
    return Pointwise(
        rotation="rotation" in flags and "wind" not in flags,
        forcing="forcing" in flags,
        terms=tuple(_point_term(e, parameters[e.name], tangent) for e in effects),
        tangent=tangent,
    )


def _acting(scene: Scene, component: str) -> list[Effect]:
    """Return the effects in a component (see `RightHandSide`)."""
    if component == "all":
        return [*scene.effects]
    if component == "tangent":
        return [effect for effect in scene.effects if not effect.constant]
    if component == "diffusive":
        return [effect for effect in scene.effects if effect.diffuses]
    damps = component == "dissipative"
    return [effect for effect in scene.effects if effect.dissipation == damps]


def _flags(scene: Scene, component: str) -> set[str]:
    flags = {flag for effect in _acting(scene, component) for flag in effect.terms}
    flags |= {flag for effect in scene.effects for flag in effect.everywhere}
    own = {"dissipative": {"still"}, "diffusive": {"still"}, "tangent": {"tangent"}}
    return flags | own.get(component, set())


def _point_term(effect: PointwiseEffect, known: Mapping[str, Any], tangent: bool) -> PointTerm:
    """Return the formulas of an effect, with the names of the coefficients that they read."""
    wind, depth = effect.derivatives if tangent else effect.tendencies
    read = {name for f in (wind, depth) if f is not None for name in f.__code__.co_names}
    numbers = tuple(name for name in known if name in read and np.ndim(known[name]) == 0)
    arrays = tuple(name for name in known if name in read and name not in numbers)
    return PointTerm(effect.name, wind, depth, numbers, arrays, _read_around(wind, depth))


def _read_around(*formulas: Callable[..., Any] | None) -> tuple[object, ...]:
    """Return what formulas, and functions of Warp in them, read from the code around them."""
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
def compiling_formulas(scene: Scene, point: Pointwise) -> Iterator[None]:
    """Raise ConfigError for formulas of effects that Warp cannot compile."""
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
