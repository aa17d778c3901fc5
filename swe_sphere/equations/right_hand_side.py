"""Right-hand sides: each is a fixed sequence of operators that computes one component.

The kernels of the operators are compiled with the terms of the effects of a scene.
"""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from swe_sphere.equations.discrete_scene import DiscreteScene, PrescribedFields
from swe_sphere.equations.effects import Effect, PointwiseEffect
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.kernels import Terms
from swe_sphere.kernels.pointwise import NO_POINTWISE, PointTerm, Pointwise
from swe_sphere.operators import TendencyOperator
from swe_sphere.operators.replay import Replay
from swe_sphere.operators.tendency import pointwise_operator

Operator = Callable[[wp.array, wp.array], None]
"""Function operator(x, out) that writes its result at the state x to `out`, another array."""


class Operation(NamedTuple):
    """One operator of a right-hand side, with the arrays that it reads and writes."""

    operator: Operator
    source: wp.array | None = None
    """Array to read; None for the state."""
    target: wp.array | None = None
    """Array to write; None for the result."""


class Component(NamedTuple):
    """A part of the right-hand side."""

    acts: Callable[[Effect], bool]
    """Function that returns whether an effect acts in the component."""
    counter: str | None = None
    """Counter that each evaluation increases by 1; None if there is none."""
    flags: frozenset[str] = frozenset()
    """Terms of kernels that the component has besides those of its effects."""


NO_TRANSPORT = frozenset({"no_transport"})
"""Flag of components in which a prescribed wind does not carry the depth."""
COMPONENTS: Mapping[str, Component] = {
    "all": Component(lambda effect: True, "rhs_evaluations"),
    "conservative": Component(lambda effect: not effect.dissipation, "rhs_evaluations"),
    "dissipative": Component(lambda effect: effect.dissipation, flags=NO_TRANSPORT),
    "diffusive": Component(lambda effect: effect.diffuses, flags=NO_TRANSPORT),
    "penalising": Component(lambda effect: effect.name == "edge-penalty", flags=NO_TRANSPORT),
    "tangent": Component(
        lambda effect: not effect.constant, "tangent_evaluations", frozenset({"tangent"})
    ),
}
"""The components by name.

"all" is the sum of "conservative" and "dissipative". Parts of "dissipative" are "diffusive"
(viscosity, hyperviscosity) and "penalising" (edge penalty). "tangent" is the derivative of "all".
"""


@dataclass(frozen=True, eq=False)
class RightHandSide:
    """Computes out = F(x, t), or start + tau F(x, t) for a stage (start, tau) of a step.

    F is one of `COMPONENTS`. In linearised dynamics all but "tangent", which takes a direction, are
    derivatives at the scene's base, applied to x minus it, plus forcing. Call it as rhs(x, t, out).
    """

    operations: tuple[Operation, ...]
    """The operations in the order in which they are launched."""
    prescribed: tuple[PrescribedFields, ...]
    """The fields to update to the time t [s]."""
    counters: dict[str, float]
    counter: str | None
    """Counter that each evaluation increases by 1; None if there is none."""
    replay: Replay

    def __call__(self, x: wp.array, t: float, out: wp.array) -> None:
        """Evaluate at the state x and the time t [s]; `out` must be another array."""
        if self.counter is not None:
            self.counters[self.counter] += 1
        for prescribed in self.prescribed:
            prescribed.set_time(t)
        if not self.replay.launch(key := (x.ptr, out.ptr)):
            with self.replay.record(key):
                for operator, source, target in self.operations:
                    operator(x if source is None else source, out if target is None else target)

    def without_time(self, x: wp.array, out: wp.array) -> None:
        """Evaluate a component that sets no time: a prescribed wind is the one set last."""
        self(x, 0.0, out)


def fluid_operations(
    model: DiscreteScene, component: str, base: wp.array | None, stage: Any
) -> list[Operation]:
    """Return the operations on wind and depth of a component.

    base: the state at which a tangent is taken. stage: a `stage_struct`, or None for the rates.
    """
    terms = element_terms(model.scene, component)
    point = pointwise_terms(model.scene, component, model.parameters)
    steady = model.parameters.get("base")
    given = {} if base is None or steady is not None else {"base": base}
    combine, held, source = model.launch.combine, model.held, None
    operations: list[Operation] = []
    if steady is not None and component != "tangent":
        source = model.scratch("difference")
        operations += [Operation(lambda x, out: combine(x, steady, -1.0, out=out), target=source)]
    operations += term_operations(model, terms, point, given, stage, source)
    tau = 1.0 if stage is None else stage.tau
    if held is not None and component in ("all", "dissipative"):
        n = held.size
        operations += [Operation(lambda x, out: combine(out[:n], held, tau, out=out[:n]), source)]
    if "edge-penalty" in _flags(model.scene, component):
        penalty = model.edge_penalty
        operations.append(Operation(lambda x, out: penalty(x, tau, out, out), source))
    return operations


def term_operations(
    model: DiscreteScene, terms: Terms, point: Pointwise = NO_POINTWISE,
    given: Mapping[str, Any] | None = None, stage: Any = None, source: wp.array | None = None,
) -> list[Operation]:  # fmt: skip
    """Return the operations of compiled terms; hyperviscosity computes a Laplacian first.

    given: parameters that replace those of the model.
    """
    mesh, parameters = model.device_mesh, model.parameters | dict(given or {})
    operations: list[Operation] = []
    if terms.biharmonic:
        laplacian = parameters["laplacian"] = model.scratch("laplacian")
        over_bottom = terms.bottom and not terms.tangent
        once = Terms(passive=terms.passive, bottom=over_bottom, diffusion=True, no_transport=True)
        first = TendencyOperator(mesh, once, model.parameters | {"nu": 1.0})
        operations.append(Operation(first, source, laplacian))
    operator: Operator
    with compiling_formulas(model.scene, point):
        if terms.dynamics or terms.diffuses:
            operator = TendencyOperator(mesh, terms, parameters, point, stage)
        else:
            operator = pointwise_operator(mesh, terms.unknowns, parameters, point, stage)
    return [*operations, Operation(operator, source)]


def element_terms(scene: Scene, component: str) -> Terms:
    """Return the terms with derivatives, for the kernels over elements."""
    flags = _flags(scene, component)
    return Terms(**{field.name: True for field in fields(Terms) if field.name in flags})


def pointwise_terms(scene: Scene, component: str, parameters: Mapping[str, Any]) -> Pointwise:
    """Return the terms without derivatives, which the assembly kernel adds at each node.

    parameters: those of the model; `parameters["effects"]` holds coefficients by effect.
    """
    flags = _flags(scene, component)
    tangent = "tangent" in flags
    effects = [e for e in acting(scene, component) if isinstance(e, PointwiseEffect)]
    return Pointwise(
        rotation="rotation" in flags and "passive" not in flags,
        forcing="forcing" in flags,
        terms=tuple(_point_term(e, parameters["effects"][e.name], tangent) for e in effects),
        tangent=tangent,
    )


def acting(scene: Scene, component: str) -> list[Effect]:
    """Return the effects in a component (see `COMPONENTS`)."""
    return [*filter(COMPONENTS[component].acts, scene.effects)]


def _flags(scene: Scene, component: str) -> set[str]:
    flags = {flag for effect in acting(scene, component) for flag in effect.terms}
    flags |= {flag for effect in scene.effects for flag in effect.everywhere}
    return flags | COMPONENTS[component].flags


def _point_term(effect: PointwiseEffect, known: Mapping[str, Any], tangent: bool) -> PointTerm:
    """Return the formulas of an effect, with the names of the coefficients that they read."""
    wind, depth = effect.derivatives if tangent else effect.tendencies
    read = {name for f in (wind, depth) if f is not None for name in f.__code__.co_names}
    numbers = tuple(name for name in known if name in read and np.ndim(known[name]) == 0)
    arrays = tuple(name for name in known if name in read and name not in numbers)
    around = tuple(_read_around(f) for f in (wind, depth) if f is not None)
    return PointTerm(effect.name, wind, depth, numbers, arrays, around)


def _read_around(formula: Callable[..., Any], *callers: Any) -> tuple[object, ...]:
    """Return the outside values that a formula, and the Warp functions it calls, read, by name."""
    around, known = inspect.getclosurevars(formula), (None, formula, *callers)
    return tuple(
        (name, value.func.__code__, _read_around(value.func, formula, *callers))
        if isinstance(value, wp.Function) and value.func not in known
        else (name, type(value), str(value))
        for name, value in sorted({**around.globals, **around.nonlocals}.items())
    )


@contextmanager
def compiling_formulas(scene: Scene, point: Pointwise) -> Iterator[None]:
    """Raise ConfigError for formulas of effects that Warp cannot compile."""
    try:
        yield
    except Exception as error:
        if not point.terms or isinstance(error, ConfigError):
            raise
        names = ", ".join(term.name for term in point.terms)
        text = str(error) or type(error).__name__
        text = text[1:-1] if text[0] == text[-1] == "'" else text
        cause = text.replace("\\n", "\n").splitlines()[-1]
        places = re.findall(r'function "\w+" at (.*?):(\d+)', str(error))
        where = "".join(f" ({Path(file).name}, line {line})" for file, line in places[-1:])
        raise ConfigError(
            f"{scene.name}: the formulas of {names} cannot be compiled: {cause.lstrip(';')}{where}"
            " (a wind formula returns two rates, a depth formula one; constants are coefficients)"
        ) from error
