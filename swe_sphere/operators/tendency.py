"""A compiled set of terms: local tendencies of the elements, then DSS."""

from typing import Any

import warp as wp

from ..kernels import Terms, assembly_kernel, element_kernel, node_kernel
from .device_mesh import DeviceMesh
from .launch import Launcher


class TendencyOperator:
    """out = DSS of the terms at x, for state vectors of shape (unknowns*N,).

    `parameters` holds what the terms need beside the mesh: gravity [m s-2], nu [m2 s-1], nu4
    [m4 s-1] and the device arrays bottom (N,) [m], wind (2N,) [m s-1], base and laplacian
    (unknowns*N,).  `coriolis` (N,) [s-1], if given, adds -f k x V, V being the wind of `base` in
    the skew form.
    """

    def __init__(
        self,
        mesh: DeviceMesh,
        terms: Terms,
        launch: Launcher,
        parameters: dict[str, Any],
        coriolis: wp.array | None = None,
    ) -> None:
        self.mesh, self.terms, self._launch = mesh, terms, launch
        build = element_kernel if mesh.shape == "element" else node_kernel
        self.compiled = build(terms, mesh.mesh.np, mesh.real)
        self.assembly = assembly_kernel(terms.unknowns, mesh.real, coriolis is not None)
        self.geometry = self._fill_geometry(parameters)
        self.local, self._flat = mesh.local(terms.unknowns, self.compiled.value)
        self._coriolis = coriolis
        self._places = mesh.places(terms.unknowns)
        launch.load(self.compiled.kernel, self.assembly, *self._flux_kernels)

    def __call__(self, x: wp.array, out: wp.array) -> None:
        """Evaluate at the state x; `out` must be another array."""
        for flux in self._flux_kernels:
            self._launch(flux, self.mesh.dim, self.geometry, x)
        self._launch(self.compiled.kernel, self.mesh.dim, self.geometry, x, self.local)
        self._assemble(x, out)

    def _assemble(self, x: wp.array, out: wp.array) -> None:
        """DSS, and the Coriolis force of the wind if there is one."""
        mesh, size = self.mesh, self.mesh.mesh.size
        wind = self.geometry.base if self.terms.poisson else x
        turned = () if self._coriolis is None else (self._coriolis, wind)
        self._launch(
            self.assembly, size, self._places, mesh.inverse_area, mesh.lanes, size, self._flat,
            *turned, out,
        )  # fmt: skip

    @property
    def _flux_kernels(self) -> list[Any]:
        flux = getattr(self.compiled, "flux_kernel", None)
        return [] if flux is None else [flux]

    def _fill_geometry(self, parameters: dict[str, Any]) -> Any:
        geometry = self.compiled.geometry()
        for name in self.compiled.geometry.vars:
            if name == "size":
                value = self.mesh.mesh.size
            elif name == "fluxes":
                value, _ = self.mesh.local(4, self.compiled.value)
            elif name in parameters:
                value = parameters[name]
            else:
                value = getattr(self.mesh, name)
            setattr(geometry, name, value)
        return geometry
