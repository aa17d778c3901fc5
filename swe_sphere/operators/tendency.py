"""Compiled terms as operators on state vectors, and the penalty at the edges of elements."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels import Terms, specialise, tendency_kernels
from swe_sphere.kernels.assembly import assemble_blocks, assembly_kernels, finish_rates
from swe_sphere.kernels.diffusion import derivatives, weak_form
from swe_sphere.kernels.local import field_kernel
from swe_sphere.kernels.pointwise import NO_POINTWISE, Pointwise, pointwise_sum
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.diagnose import assemble
from swe_sphere.operators.launch import MOST_CACHED


class TendencyOperator:
    """Sets out = DSS of the terms at x, for state vectors of shape (unknowns*N,).

    `parameters` holds the terms' coefficients and fields: gravity [m s-2], nu [m2 s-1], nu4 [m4
    s-1] and the device arrays bottom (N,) [m], wind (2N,) [m s-1], base, laplacian and forcing
    (unknowns*N,) and coriolis (N,) [s-1]; "effects" holds the numbers and fields (N,) of each term
    of `point`, by its name. With `Terms.skew` (skew form) `Pointwise.rotation` turns the wind of
    `base`. With a `stage` (a `stage_struct`), `out` is the result of the stage instead of the rate.
    """

    def __init__(
        self, mesh: DeviceMesh, terms: Terms, parameters: Mapping[str, Any],
        point: Pointwise = NO_POINTWISE, stage: Any = None,
    ) -> None:  # fmt: skip
        self.mesh, self._stage = mesh, mesh.stage if stage is None else stage
        inside = terms.dynamics
        if terms.diffuses:
            inside = not terms.dynamics and replace(point, tangent=False) == NO_POINTWISE
        direct = mesh.lanes > 1 and inside
        unknowns, added = terms.unknowns, pointwise_sum(terms.unknowns, point)
        types = mesh.types(terms=terms, point=added if direct else None)
        *self._fluxes, self._kernel = tendency_kernels(types)
        parameters = {"base": None, **parameters, "stage": self._stage}
        assembly, _ = assembly_kernels(unknowns, point)
        self._own = fill(specialise(added.structure, mesh.real), parameters, point)
        self.geometry = mesh.geometry(types.geometry, parameters | {"point": self._own})
        self._turned = self.geometry.base if terms.skew else None
        self.local, self._places = mesh.scratch(unknowns, types.value), mesh.places(unknowns)
        begin, lanes = (mesh.inner, mesh.lanes) if direct else (0, 1)
        self._assemble = mesh.over_nodes(assembly, begin, lanes)
        """Launches of DSS at the nodes that the kernel over elements has not finished."""
        mesh.launch.load(self._kernel, *self._fluxes)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """Evaluate at the state x; `out` must be another array."""
        mesh, local = self.mesh, self.local
        for flux in self._fluxes:
            mesh.launch(flux, mesh.threads(), self.geometry, x)
        arguments = self.geometry, x, local.values, out
        mesh.over_elements(local, self._kernel, mesh.threads(), *arguments, wait=False)
        wind = x if self._turned is None else self._turned
        inputs = mesh.inverse_area, mesh.lanes, mesh.size, local.flat, self._own, wind
        self._assemble(self._places, *inputs, self._stage, out)


def pointwise_operator(
    mesh: DeviceMesh, unknowns: int, parameters: Mapping[str, Any], point: Pointwise, stage: Any
) -> Callable[[wp.array, wp.array], None]:
    """Return the function (x, out) of the pointwise terms for a model without derivatives.

    Arguments are those of `TendencyOperator`.
    """
    (alone,) = mesh.launch.compile(mesh.real, assembly_kernels(unknowns, point)[1])
    structure = specialise(pointwise_sum(unknowns, point).structure, mesh.real)
    own, stage = fill(structure, {"base": None, **parameters}, point), stage or mesh.stage
    return lambda x, out: mesh.launch(alone, mesh.size, mesh.size, own, x, stage, out)


def fill(structure: Any, parameters: Mapping[str, Any], point: Pointwise) -> Any:
    """Return an instance of the structure, each member set to the parameter of its name.

    The parameter "effects" holds the coefficients of each term, by its name.
    """
    terms: dict[str, Any] = {}
    for term in reversed(point.terms):
        terms = {"mine": parameters["effects"][term.name], "others": terms}
    return filled(structure, {**parameters, "terms": terms})


def filled(structure: Any, given: Mapping[str, Any]) -> Any:
    """Return an instance of the structure with members by name, structures in it from mappings."""
    made = structure()
    for name, member in structure.vars.items():
        value = given.get(name)
        setattr(made, name, filled(member.type, value) if isinstance(value, Mapping) else value)
    return made


class EdgePenaltyOperator:
    """Adds the penalty on jumps of vorticity and divergence in a wind to another wind.

    The coefficient gamma of an element is `strength` (E,) [m2 s-1], see `kernels/diffusion.py`.
    """

    def __init__(self, mesh: DeviceMesh, strength: Array) -> None:
        self._mesh, terms, direct = mesh, Terms(jumps=True), mesh.lanes > 1
        types = mesh.types(terms=terms, point=pointwise_sum(2, NO_POINTWISE) if direct else None)
        self._derivatives = field_kernel(types, derivatives)
        self._weak_form = field_kernel(types, weak_form, finish_rates(types, 2) if direct else None)
        mesh.launch.load(self._derivatives, self._weak_form)
        at_edge = np.pad(np.zeros((mesh.mesh.np - 2,) * 2), 1, constant_values=1.0)
        gamma = strength[:, None, None] * at_edge
        weight = assemble(mesh.mesh, gamma * mesh.mesh.quadrature * mesh.mesh.jacobian)
        total, none = weight * mesh.mesh.area, np.zeros_like(weight)
        self._mean_scale = mesh.scatter(np.divide(1.0, total, where=weight > 0.0, out=none))
        self._values, self._weak = mesh.local(2, types.value), mesh.local(2, types.value)
        self._means = wp.zeros(2 * mesh.size, dtype=mesh.real, device=mesh.device)
        given = {
            "strength": mesh.on_elements(gamma[mesh.part.element_numbers]),
            "values": self._values.values,
            "point": types.point and types.point.structure.find(types)(), "stage": mesh.stage,
        }  # fmt: skip
        self._geometry = mesh.geometry(types.geometry, given)
        given = given | {"derivative": mesh.upload(np.ascontiguousarray(mesh.mesh.derivative.T))}
        self._geometry_of = functools.lru_cache(MOST_CACHED)(
            lambda stage: mesh.geometry(types.geometry, given | {"stage": stage})
        )
        """Function from a stage to the geometry that contains it, the same object each time."""
        self._sum_means = mesh.over_nodes(assemble_blocks, int(np.sum(mesh.part.counts == 1)))
        self._sum = mesh.over_nodes(assemble_blocks, mesh.inner if direct else 0)

    def __call__(self, x: wp.array, factor: float, out: wp.array, start: wp.array) -> None:
        """Set the wind of `out` to start's wind plus `factor` [s] times the penalty of x's wind.

        All three may be the same array.
        """
        mesh, means = self._mesh, self._means
        threads, values, weak = mesh.threads(1), self._values, self._weak
        places, layout = mesh.places(2), (mesh.lanes, mesh.size, 2, 0)
        stage = mesh.stage_at(start, factor)
        inputs = self._geometry, x, x, 0, 1, values.values, x
        mesh.over_elements(values, self._derivatives, threads, *inputs, wait=False)
        self._sum_means(places, self._mean_scale, *layout, values.flat, mesh.stage, means)
        inputs = self._geometry_of(stage), means, means, 0, 1, weak.values, out
        mesh.over_elements(weak, self._weak_form, threads, *inputs, wait=False)
        self._sum(places, mesh.inverse_area, *layout, weak.flat, stage, out)
