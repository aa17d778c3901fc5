"""Block elimination of the linearised shallow-water equations on the device.

For A = I - tau L with L(V, h) = (-f k x V - g G h, -D H V), elimination of the wind leaves
S dh = r_h - tau D H T r_V with S = I - tau^2 g D H T G and T = (I + tau f k x)^-1, and then
dV = T (r_V - tau g G dh).  G and D are the DSS'd operators of the model: a compact Laplacian in
their place is a bad preconditioner, as it differs on the grid-scale modes.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.gradient import derivative_kernels
from ..kernels.helmholtz import elimination_kernels
from .device_mesh import DeviceMesh
from .launch import Launcher

Array = NDArray[np.float64]


class SchurOperator:
    """The eliminated system in the number type of `mesh`, for vectors of number type `outer`.

    Call `configure` before anything else, and again when tau [s] or the depth [m] changes.
    """

    def __init__(
        self, mesh: DeviceMesh, launch: Launcher, gravity: float, coriolis: Array, outer: Any
    ) -> None:
        self.mesh, self.launch, self.gravity, self.coriolis = mesh, launch, gravity, coriolis
        self.size, self.tau = mesh.mesh.size, 0.0
        self._derivatives = derivative_kernels(mesh.mesh.np, mesh.real, mesh.shape)
        self._steps = elimination_kernels(mesh.real, outer)
        self._geometry = self._derivatives.geometry()
        for name in ("nodes", "basis", "derivative", "weight"):
            setattr(self._geometry, name, getattr(mesh, name))
        self._geometry.size = self.size
        self._nodal = self._fill_nodal()
        self._flux = self.vector(2)
        self._local_1, self._flat_1 = self._room(1)
        self._local_2, self._flat_2 = self._room(2)
        launch.load(self._derivatives.gradient, self._derivatives.divergence)
        launch.load(self._steps.turned_flux, self._steps.eliminated, self._steps.gradient_flux)
        launch.load(self._steps.substituted, self._steps.chebyshev, self._steps.schur)

    def vector(self, fields: int = 1) -> wp.array:
        """Zeros for that many nodal fields."""
        return wp.zeros(fields * self.size, dtype=self.mesh.real, device=self.mesh.device)

    def configure(self, tau: float, depth: Array, inverse_diagonal: Array) -> None:
        """Set the implicit step [s], the depth (N,) [m] and one over the diagonal of S (N,)."""
        self.tau, angle = tau, tau * self.coriolis
        values = {
            "depth": depth,
            "turn_same": 1.0 / (1.0 + angle**2),
            "turn_cross": angle / (1.0 + angle**2),
            "inverse_diagonal": inverse_diagonal,
        }
        for name, array in values.items():
            wp.copy(getattr(self._nodal, name), self.mesh.upload(array))

    def eliminate(self, r: wp.array, b: wp.array) -> None:
        """b (N,) = r_h - tau D H T r_V for r (3N,)."""
        self.launch(self._steps.turned_flux, self.size, self._nodal, r, self._flux)
        self._diverge()
        self.launch(self._steps.eliminated, self.size, self._nodal, self._flat_1, r, self.tau, b)

    def substitute(self, r: wp.array, h: wp.array, out: wp.array) -> None:
        """out (3N,) = (T (r_V - tau g G h), h)."""
        self.launch(self._derivatives.gradient, self.mesh.dim, self._geometry, h, self._local_2)
        self.launch(
            self._steps.substituted, self.size, self._nodal, self._flat_2, r, h,
            self.tau * self.gravity, out,
        )  # fmt: skip

    def apply(self, d: wp.array, out: wp.array) -> None:
        """out (N,) = S d."""
        self._second_derivative(d)
        self.launch(self._steps.schur, self.size, self._nodal, self._flat_1, self._factor, d, out)

    def residual(self, b: wp.array, x: wp.array, out: wp.array) -> None:
        """out (N,) = b - S x."""
        wp.copy(out, b)
        self._second_derivative(x)
        self.launch(
            self._steps.chebyshev, self.size, self._nodal, self._flat_1, self._factor,
            1.0, 0.0, 0.0, out, x, self._flux,
        )  # fmt: skip

    def chebyshev_step(
        self, coefficients: tuple[float, float, float], r: wp.array, d: wp.array, x: wp.array
    ) -> None:
        """r -= S d; d = keep d + take r/diag S; x += beta d, with (keep, take, beta) given."""
        self._second_derivative(d)
        self.launch(
            self._steps.chebyshev, self.size, self._nodal, self._flat_1, self._factor,
            *coefficients, r, d, x,
        )  # fmt: skip

    def _fill_nodal(self) -> Any:
        nodal = self._steps.nodal()
        nodal.offsets, nodal.stride, nodal.size = self.mesh.offsets, self.mesh.lanes, self.size
        nodal.entries_1, nodal.entries_2 = self.mesh.entries(1), self.mesh.entries(2)
        nodal.inverse_area = self.mesh.inverse_area
        for name in ("depth", "turn_same", "turn_cross", "inverse_diagonal"):
            setattr(nodal, name, self.vector())
        return nodal

    @property
    def _factor(self) -> float:
        return self.tau**2 * self.gravity

    def _second_derivative(self, d: wp.array) -> None:
        """Local tendencies of D H T G d."""
        self.launch(self._derivatives.gradient, self.mesh.dim, self._geometry, d, self._local_2)
        self.launch(self._steps.gradient_flux, self.size, self._nodal, self._flat_2, self._flux)
        self._diverge()

    def _diverge(self) -> None:
        self.launch(
            self._derivatives.divergence, self.mesh.dim, self._geometry, self._flux, self._local_1
        )

    def _room(self, fields: int) -> tuple[wp.array, wp.array]:
        """Local tendencies as the element kernels and as the assembly kernels see them."""
        local = self.mesh.local(fields, self._derivatives.value)
        count = self.mesh.groups * self.mesh.points * fields * self.mesh.lanes
        flat = wp.array(
            ptr=local.ptr, shape=(count,), dtype=self.mesh.real, device=self.mesh.device
        )
        return local, flat
