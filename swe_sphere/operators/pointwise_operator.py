"""Terms that act at a point, where there is nothing to differentiate and so nothing to assemble."""

import copy
from collections.abc import Mapping
from typing import Any, Self

import warp as wp

from swe_sphere.kernels.pointwise import PointTerm, Pointwise
from swe_sphere.kernels.pointwise_assembly import pointwise_kernel
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher


class PointwiseOperator:
    """out = the pointwise terms at x, for state vectors of shape (unknowns*N,).

    `parameters` as for `TendencyOperator`.
    """

    def __init__(
        self,
        mesh: DeviceMesh,
        unknowns: int,
        point: Pointwise,
        launch: Launcher,
        parameters: dict[str, Any],
    ) -> None:
        self.point, self._launch, self._size = point, launch, mesh.size
        made = pointwise_kernel(unknowns, mesh.real, point)
        self._kind, self._parameters = made.structure, parameters
        self.kernel, self.structure = made.alone, fill(made.structure, parameters, point)
        self._stage = mesh.stage
        launch.load(self.kernel)

    def at(self, base: wp.array) -> Self:
        """This derivative at another state (unknowns*N,), whose array is kept."""
        other = copy.copy(self)
        other.structure = fill(self._kind, self._parameters | {"base": base}, self.point)
        return other

    def stepping(self, stage: Any) -> Self:
        """This operator, whose result is what the stage makes of the rate."""
        other = copy.copy(self)
        other._stage = stage
        return other

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """Evaluate at the state x; `out` must be another array."""
        self._launch(self.kernel, self._size, self._size, self.structure, x, self._stage, out)


def fill(structure: Any, parameters: Mapping[str, Any], point: Pointwise) -> Any:
    """An instance of the structure, each member the parameter of its name.

    The coefficients of a term are in the parameter that has the name of the term.
    """
    filled = structure()
    for name, member in structure.vars.items():
        given = parameters.get(name)
        if name == "terms":
            given = _fill_terms(member.type, parameters, point.terms)
        setattr(filled, name, given)
    return filled


def _fill_terms(structure: Any, parameters: Mapping[str, Any], terms: tuple[PointTerm, ...]) -> Any:
    filled = structure()
    filled.mine = structure.vars["mine"].type()
    for name in structure.vars["mine"].type.vars:
        setattr(filled.mine, name, parameters[terms[0].name][name])
    if terms[1:]:
        filled.others = _fill_terms(structure.vars["others"].type, parameters, terms[1:])
    return filled
