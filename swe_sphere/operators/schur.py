"""Block elimination of the linearised shallow-water equations on the device.

For A = I - tau L with L(V, h) = (-f k x V - g G h, -D H V), elimination of the wind leaves
S dh = r_h - tau D H T r_V with S = I - tau^2 g D H T G and T = (I + tau f k x)^-1, and then
dV = T (r_V - tau g G dh).  G and D are the DSS'd operators of the model: a compact Laplacian in
their place is a bad preconditioner, as it differs on the grid-scale modes.
"""

from typing import Any

import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.helmholtz import elimination_kernels
from swe_sphere.kernels.local import field_kernels
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher


class SchurOperator:
    """The eliminated system in the number type of `mesh`, for state vectors of type `given`.

    Call `configure` before anything else, and again when tau [s] or the depth [m] changes.
    """

    def __init__(
        self, mesh: DeviceMesh, launch: Launcher, gravity: float, coriolis: Array, given: Any
    ) -> None:
        self.mesh, self.launch, self.gravity, self.coriolis = mesh, launch, gravity, coriolis
        self.size, self.tau = mesh.size, 0.0
        self._derivatives = field_kernels(mesh.mesh.np, mesh.real, mesh.shape)
        self._steps = elimination_kernels(mesh.real, given)
        self._geometry = mesh.geometry(self._derivatives.geometry)
        self._places_1, self._places_2 = mesh.places(1), mesh.places(2)
        self._local_1, self._flat_1 = mesh.local(1, self._derivatives.value)
        self._local_2, self._flat_2 = mesh.local(2, self._derivatives.value)
        self._flux, self._depth, self._inverse_diagonal = (self.vector(k) for k in (2, 1, 1))
        self._turn = self.vector(), self.vector()
        launch.load(self._derivatives.gradient, self._derivatives.divergence)
        launch.load(*vars(self._steps).values())

    def vector(self, fields: int = 1) -> wp.array:
        """Zeros for that many nodal fields."""
        return wp.zeros(fields * self.size, dtype=self.mesh.real, device=self.mesh.device)

    def configure(self, tau: float, depth: Array, inverse_diagonal: Array) -> None:
        """Set the implicit step [s], the depth (N,) [m] and one over the diagonal of S (N,)."""
        self.tau, angle = tau, tau * self.coriolis
        same, cross = self._turn
        for target, values in (
            (self._depth, depth),
            (same, 1.0 / (1.0 + angle**2)),
            (cross, angle / (1.0 + angle**2)),
            (self._inverse_diagonal, inverse_diagonal),
        ):
            wp.copy(target, self.mesh.scatter(values))

    def eliminate(self, r: wp.array, b: wp.array) -> None:
        """b (N,) = r_h - tau D H T r_V for r (3N,)."""
        self.launch(
            self._steps.turned_flux, self.size, self._depth, *self._turn, self.size, r, self._flux
        )
        self._diverge()
        self._nodal_1(self._steps.eliminated, self.size, self._flat_1, r, self.tau, b)

    def substitute(self, r: wp.array, h: wp.array, out: wp.array) -> None:
        """out (3N,) = (T (r_V - tau g G h), h)."""
        self._differentiate(h)
        self._nodal_2(
            self._steps.substituted, *self._turn, self.mesh.lanes, self.size, self._flat_2, r, h,
            self.tau * self.gravity, out,
        )  # fmt: skip

    def apply(self, d: wp.array, out: wp.array) -> None:
        """out (N,) = S d."""
        self._second_derivative(d)
        self._nodal_1(self._steps.schur, self._flat_1, self._factor, d, out)

    def residual(self, b: wp.array, x: wp.array, out: wp.array) -> None:
        """out (N,) = b - S x."""
        wp.copy(out, b)
        self.chebyshev_step((1.0, 0.0, 0.0), out, x, self._flux)

    def chebyshev_step(
        self, coefficients: tuple[float, float, float], r: wp.array, d: wp.array, x: wp.array
    ) -> None:
        """r -= S d; d = keep d + take r/diag S; x += beta d, with (keep, take, beta) given."""
        self._second_derivative(d)
        self._nodal_1(
            self._steps.chebyshev, self._inverse_diagonal, self._flat_1, self._factor,
            *coefficients, r, d, x,
        )  # fmt: skip

    def chebyshev_start(
        self, coefficients: tuple[float, float, float], r: wp.array, d: wp.array, x: wp.array
    ) -> None:
        """That step from d = x = 0, whatever they hold: d = take r/diag S; x = beta d."""
        _, take, beta = coefficients
        kernel, inverse = self._steps.chebyshev_start, self._inverse_diagonal
        self.launch(kernel, self.size, inverse, take, beta, r, d, x)

    @property
    def _factor(self) -> float:
        return self.tau**2 * self.gravity

    def _second_derivative(self, d: wp.array) -> None:
        """Local tendencies of D H T G d."""
        self._differentiate(d)
        self._nodal_2(
            self._steps.gradient_flux, self._depth, *self._turn, self.mesh.lanes, self.size,
            self._flat_2, self._flux,
        )  # fmt: skip
        self._diverge()

    def _differentiate(self, s: wp.array) -> None:
        self._over_elements(self._derivatives.gradient, s, self._local_2, self._flat_2)

    def _diverge(self) -> None:
        self._over_elements(self._derivatives.divergence, self._flux, self._local_1, self._flat_1)

    def _over_elements(self, kernel: Any, x: wp.array, local: wp.array, flat: wp.array) -> None:
        self.launch(kernel, self.mesh.dim, self._geometry, x, x, 0, 1, local)
        self.mesh.exchange(flat)

    def _nodal_1(self, kernel: Any, *arguments: Any) -> None:
        """A nodal step that gathers one field."""
        self.launch(kernel, self.size, self._places_1, self.mesh.inverse_area, *arguments)

    def _nodal_2(self, kernel: Any, *arguments: Any) -> None:
        """A nodal step that gathers two fields."""
        self.launch(kernel, self.size, self._places_2, self.mesh.inverse_area, *arguments)
