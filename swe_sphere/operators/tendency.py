"""A compiled set of terms: local tendencies of the elements, then DSS."""

import copy
from dataclasses import replace
from typing import Any, Self

import warp as wp

from swe_sphere.kernels import Terms, tendency_kernel
from swe_sphere.kernels.pointwise import NO_POINTWISE, Pointwise
from swe_sphere.kernels.pointwise_assembly import pointwise_kernel
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher, in_runs
from swe_sphere.operators.pointwise_operator import fill
from swe_sphere.operators.replay import recorded


class TendencyOperator:
    """out = DSS of the terms at x, for state vectors of shape (unknowns*N,).

    `parameters` holds what the terms need beside the mesh: gravity [m s-2], nu [m2 s-1], nu4
    [m4 s-1] and the device arrays bottom (N,) [m], wind (2N,) [m s-1], base, laplacian and forcing
    (unknowns*N,) and coriolis (N,) [s-1]; for each term of `point` a dictionary of its numbers and
    fields (N,) by the name of the term.  The wind that `Pointwise.rotation` turns is that of `base`
    in the skew form.
    """

    def __init__(
        self,
        mesh: DeviceMesh,
        terms: Terms,
        launch: Launcher,
        parameters: dict[str, Any],
        point: Pointwise = NO_POINTWISE,
    ) -> None:
        self.mesh, self.terms, self.point, self._launch = mesh, terms, point, launch
        inside = terms.dynamics
        if terms.diffuses:
            inside = not terms.dynamics and replace(point, tangent=False) == NO_POINTWISE
        direct = mesh.lanes > 1 and inside
        self.compiled = tendency_kernel(terms, mesh.mesh.np, mesh.real, mesh.shape, direct, point)
        self._runs = self._made(mesh.lanes).assembly if direct else None
        """DSS of what elements have not finished, as many nodes at once as a register holds."""
        if "fluxes" in self.compiled.geometry.vars:
            parameters = parameters | {"fluxes": mesh.unshared(4, self.compiled.value)[0]}
        self._fill(parameters)
        self._recorded = recorded(launch, self._evaluate)
        self.local, self._flat = mesh.local(terms.unknowns, self.compiled.value)
        self._places = mesh.places(terms.unknowns)
        runs = () if self._runs is None else (self._runs,)
        launch.load(self.compiled.kernel, self.assembly, *runs, *self._flux_kernels)

    def at(self, base: wp.array) -> Self:
        """This derivative at another state (unknowns*N,), whose array is kept.

        Kernels and work arrays are shared with it.
        """
        return self._with(base=base)

    def stepping(self, stage: Any) -> Self:
        """This operator, whose result is what the stage makes of the rate."""
        return self._with(stage=stage)

    def _with(self, **parameters: Any) -> Self:
        other = copy.copy(self)
        other._fill(self._parameters | parameters)
        other._recorded = recorded(self._launch, other._evaluate)
        return other

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """Evaluate at the state x; `out` must be another array."""
        self._recorded(x, out)

    def _evaluate(self, x: wp.array, out: wp.array) -> None:
        for flux in self._flux_kernels:
            self._launch(flux, self.mesh.dim, self.geometry, x)
        self.mesh.sweep(
            self._launch, self.compiled.kernel, self.mesh.dim, self._flat, self.geometry, x,
            self.local, out,
        )  # fmt: skip
        self._assemble(x, out)

    def _fill(self, parameters: dict[str, Any]) -> None:
        """Put the parameters into the arguments of the kernels."""
        self._parameters, made = parameters, self._made(1)
        self.assembly, self._own = made.assembly, fill(made.structure, parameters, self.point)
        self.geometry = self.mesh.geometry(
            self.compiled.geometry, parameters | {"point": self._own}
        )

    def _made(self, lanes: int) -> Any:
        """The kernel for DSS and pointwise terms, and the structure of what these read."""
        return pointwise_kernel(self.terms.unknowns, self.mesh.real, self.point, lanes)

    def _assemble(self, x: wp.array, out: wp.array) -> None:
        """DSS, and what acts at a point."""
        mesh, size = self.mesh, self.mesh.size
        wind = self.geometry.base if self.terms.poisson else x
        stage = self._parameters.get("stage", mesh.stage)
        parts = [(self.assembly, size, 0)]
        if self._runs is not None:
            either = {mesh.lanes: self._runs, 1: self.assembly}
            parts = in_runs(either.__getitem__, mesh.lanes, mesh.inner, size)
        for kernel, threads, begin in parts:
            self._launch(
                kernel, threads, self._places, mesh.inverse_area, mesh.lanes, begin, size,
                self._flat, self._own, wind, stage, out,
            )  # fmt: skip

    @property
    def _flux_kernels(self) -> list[Any]:
        return [] if self.compiled.flux_kernel is None else [self.compiled.flux_kernel]
