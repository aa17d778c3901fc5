"""How tracers take part in the linear gravity waves of semi-implicit steppers."""

import numpy as np
import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.equations.tracer_equations import TracerEquations
from swe_sphere.kernels.tracers import flux_kernel
from swe_sphere.operators.tracers import TracerTransport
from swe_sphere.solvers.vector_space import VectorSpace


class TracerWaves:
    """L_hq(V) = -div(q H V), the tracers' rows of L, with the mixing ratios q of one state.

    Nothing depends on tracers, so that (I - tau L)^-1 needs no solve for them; but they have to
    follow the depth: where its waves are implicit and those of hq explicit, a constant q would not
    stay constant.  What the solver leaves as residual of the depth is taken over times q.
    """

    def __init__(self, model: Model, tracers: TracerEquations, rest: wp.array) -> None:
        """rest: wind and depth without motion, the reference depth H [m]."""
        mesh, count, n = model.device_mesh, tracers.count, model.device_mesh.size
        self._rest, self._depth, self._first = rest, tracers.depth, tracers.first
        self._launch, self._carry = model.launch, flux_kernel(mesh.real)
        self._launch.load(self._carry)
        self._flow = mesh.upload(np.zeros(2 * n))
        self._ratio = tracers.mixing_ratio()
        self._transport = TracerTransport(mesh, model.launch, count)
        self._air_transport = TracerTransport(mesh, model.launch, 1)
        self._flux, self._air = mesh.upload(np.zeros(count * n)), mesh.upload(np.zeros(n))
        self._ones = mesh.upload(np.ones(n))
        self._units = [model.zeros() for _ in range(count)]
        for unit, begin in zip(self._units, range(self._first, model.size, n), strict=True):
            unit[begin : begin + n].fill_(1.0)
        area = np.tile(model.mesh.area / model.mesh.area.sum(), len(model.names))
        self._space = VectorSpace(area, mesh=mesh)

    def linearise(self, state: wp.array) -> None:
        """Take the mixing ratios of a state."""
        self._ratio.set(state)

    def apply(self, d: wp.array, out: wp.array) -> None:
        """out_hq = L_hq d."""
        self._carry_rest(d)
        self._transport(self._flow, self._ratio.values, 0, out, self._first)

    def solve(self, tau: float, r: wp.array, x: wp.array) -> None:
        """x_hq = r_hq + tau L_hq x + q (residual of x_h), with the mass of r_hq."""
        self._carry_rest(x)
        self._transport(self._flow, self._ratio.values, 0, self._flux, 0)
        self._air_transport(self._flow, self._ones, 0, self._air, 0)
        self._ratio.correct(self._flux, self._air, tau, r, x)
        for unit in self._units:
            self._space.match_mean(r, x, unit)

    def _carry_rest(self, d: wp.array) -> None:
        """flow = H V."""
        n = self._ones.size
        self._launch(self._carry, n, d, self._rest, self._depth, n, self._flow)
