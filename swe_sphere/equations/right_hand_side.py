"""Right-hand sides: fixed sequences of operators, built from a component, a stage and a base."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import warp as wp

from swe_sphere.equations.discrete_scene import DiscreteScene, PrescribedFields
from swe_sphere.equations.effect_terms import compiling_formulas, element_terms, pointwise_terms
from swe_sphere.equations.scene import Scene
from swe_sphere.kernels import Terms, combine_kernel
from swe_sphere.kernels.pointwise import NO_POINTWISE, Pointwise
from swe_sphere.operators import TendencyOperator
from swe_sphere.operators.replay import Replay
from swe_sphere.operators.tendency import pointwise_operator

Operator = Callable[[wp.array, wp.array], None]
"""operator(x, out) writes to `out`, another array, what it makes of the state x."""


class Operation(NamedTuple):
    """One operator of a right-hand side, with the arrays that it reads and writes."""

    operator: Operator
    source: wp.array | None = None
    """None: the state."""
    target: wp.array | None = None
    """None: the result."""


class Component(NamedTuple):
    """A component of right-hand sides: its counter, and the fields that it reads at the time t."""

    counter: str | None
    prescribed: tuple[str, ...]


_RATES = Component("rhs_evaluations", ("wind", "forcing"))

COMPONENTS: Mapping[str, Component] = {
    "all": _RATES,
    "conservative": _RATES,
    "dissipative": Component(None, ()),
    "diffusive": Component(None, ()),
    "tangent": Component("tangent_evaluations", ("wind",)),
}
"""The components by name.

"all" is the sum of "conservative" and "dissipative".  "diffusive" is the viscosity and the
hyperviscosity in "dissipative".  "tangent" is the derivative of "all" at a base along a direction.
"""


@dataclass(frozen=True, eq=False)
class RightHandSide:
    """rhs(x, t, out): out = F(x, t), or start + tau F(x, t) for a stage (start, tau) of a step.

    F is one of `COMPONENTS`.  In linearised dynamics all components are derivatives at the base of
    the scene, and are applied to the difference of x from that base.
    """

    operations: tuple[Operation, ...]
    """The operations in the order in which they are launched."""
    prescribed: tuple[PrescribedFields, ...]
    """The fields that have to be brought to the time t [s]."""
    counters: dict[str, int]
    counter: str | None
    """The counter that each evaluation adds 1 to; None where nothing is counted."""
    replay: Replay

    def __call__(self, x: wp.array, t: float, out: wp.array) -> None:
        """Evaluate at the state x and the time t [s]; `out` must be another array."""
        if self.counter is not None:
            self.counters[self.counter] += 1
        for fields in self.prescribed:
            fields.set_time(t)
        self.replay((x.ptr, out.ptr), self._operate, x, out)

    def _operate(self, x: wp.array, out: wp.array) -> None:
        for operator, source, target in self.operations:
            operator(x if source is None else source, out if target is None else target)

    def at_start(self, x: wp.array, out: wp.array) -> None:
        """Evaluate at the time 0: some components are the same at all times."""
        self(x, 0.0, out)


def fluid_operations(
    discrete: DiscreteScene, scene: Scene, component: str, base: wp.array | None, stage: Any
) -> list[Operation]:
    """Return the operations on wind and depth of a component.

    scene: the effects that act, of those of the discrete scene; base: of a tangent, as for
    `RightHandSide`; stage: a `stage_struct`, or None.
    """
    terms = element_terms(scene, component)
    point = pointwise_terms(scene, component, discrete.parameters)
    own_base = discrete.parameters.get("base")
    if own_base is None:
        given = {} if base is None else {"base": base}
        return term_operations(discrete, terms, point, given, stage)
    if component == "tangent":
        return term_operations(discrete, terms, point, {}, stage)
    difference = discrete.difference
    subtract = Operation(_difference_to(discrete, own_base), target=difference)
    return [subtract, *term_operations(discrete, terms, point, {}, stage, source=difference)]


def needs_base(discrete: DiscreteScene, scene: Scene) -> bool:
    """Whether the tangent depends on the state at which it is taken."""
    terms = element_terms(scene, "tangent")
    point = pointwise_terms(scene, "tangent", discrete.parameters)
    return "base" not in discrete.parameters and (terms.gradient or point.needs_base)


def term_operations(
    discrete: DiscreteScene,
    terms: Terms,
    point: Pointwise = NO_POINTWISE,
    given: Mapping[str, Any] | None = None,
    stage: Any = None,
    source: wp.array | None = None,
) -> list[Operation]:
    """Return the operations of compiled terms; hyperviscosity takes a Laplacian first.

    given: parameters in the place of those of the discrete scene.
    """
    mesh, launch = discrete.device_mesh, discrete.launch
    parameters = discrete.parameters | dict(given or {})
    operations: list[Operation] = []
    if terms.biharmonic:
        laplacian = parameters["laplacian"] = discrete.laplacian
        raised = terms.bottom and not terms.tangent
        once = Terms(wind=terms.wind, bottom=raised, diffusion=True, still=True)
        first = TendencyOperator(mesh, once, launch, discrete.parameters | {"nu": 1.0})
        operations.append(Operation(first, source, laplacian))
    operator: Operator
    with compiling_formulas(discrete.scene, point):
        if terms.dynamics or terms.diffuses:
            operator = TendencyOperator(mesh, terms, launch, parameters, point, stage)
        else:
            operator = pointwise_operator(mesh, terms.unknowns, launch, parameters, point, stage)
    return [*operations, Operation(operator, source)]


def _difference_to(discrete: DiscreteScene, base: wp.array) -> Operator:
    """Return what writes x - base."""
    launch, combine = discrete.launch, combine_kernel(discrete.device_mesh.real, 1)
    launch.load(combine)

    def subtract(x: wp.array, out: wp.array) -> None:
        launch(combine, out.size, x, base, -1.0, out)

    return subtract
