"""Gravity waves alone, linear on a fluid at rest, in sub-steps below their stability limit."""

import warp as wp

from swe_sphere.equations.model import Model
from swe_sphere.kernels.assembly import drift, kick
from swe_sphere.kernels.dynamics import gradient, transport
from swe_sphere.kernels.local import field_kernel
from swe_sphere.kernels.vectors import combine_kernel


class FastWaves:
    """Solves dV/dt = -g grad h + rate, dh/dt = -div(H V) + rate by Störmer-Verlet sub-steps.

    H is the depth of a state, held constant. Tracers have the flux of their masses at that state,
    so that a constant mixing ratio stays constant: only the time-integrated flux counts, so they
    move along the total displacement of the fluid in one step.
    """

    def __init__(self, model: Model) -> None:
        self._model, mesh = model, model.device_mesh
        n = mesh.size
        self.state = model.zeros()
        """State that is stepped: wind and depth, then tracers or mass flux."""
        self._winds, self._depth = 2 * n, self.state[2 * n : 3 * n]
        types, self._carries = mesh.types(), int(model.carried is not None)
        self._transport, self._slope = kernels = [
            field_kernel(types, formula) for formula in (transport(), gradient)
        ]
        self._geometry = mesh.geometry(types.geometry)
        self._divergence = mesh.scratch(1, types.value)
        self._gradient = mesh.scratch(2, types.value)
        self._drift_kernel, self._kick_kernel = model.launch.compile(mesh.real, drift, kick)
        self._add = combine_kernel(mesh.real, 2)
        model.launch.load(*kernels)
        self._path, self._crossed, self._behind = self.state, self.state, slice(0, 0)
        if model.carried is not None:
            model.launch.load(self._add)
            self._path = wp.zeros(2 * n, dtype=mesh.real, device=model.device)
            self._crossed, self._behind = model.zeros(), slice(3 * n, model.size)

    def move(
        self, rest: wp.array, rate: wp.array, duration: float, steps: int, carrier: wp.array
    ) -> None:
        """Advance `state` by a duration [s] in `steps` sub-steps.

        rest: the state whose depth is H; rate: rate of change of all fields apart from the waves;
        carrier: the state that holds the masses of tracers.
        """
        tau = duration / steps
        self._kick(rate, 0.5 * tau)
        for step in range(steps):
            self._drift(rest, rate, tau, float(step > 0))
            self._kick(rate, tau if step + 1 < steps else 0.5 * tau)
        if self._model.carried is not None:
            behind, crossed = self._behind, self._crossed
            self._model.carried.carry(self._path, carrier, crossed)
            moved = self.state[behind]
            self._model.launch(
                self._add, moved.size, moved, rate[behind], duration, crossed[behind], 1.0, moved
            )

    def _drift(self, rest: wp.array, rate: wp.array, tau: float, kept: float) -> None:
        launch, mesh, s = self._model.launch, self._model.device_mesh, self.state
        mesh.sweep(launch, self._divergence)(
            self._transport, mesh.threads(1), 0, self._geometry, s, rest, self._winds, 1,
            self._divergence.values, s,
        )  # fmt: skip
        launch(
            self._drift_kernel, mesh.size, mesh.places(1), mesh.inverse_area, mesh.size,
            self._divergence.flat, tau, rate, s, self._carries, kept,
            self._path,
        )  # fmt: skip

    def _kick(self, rate: wp.array, tau: float) -> None:
        launch, mesh, s = self._model.launch, self._model.device_mesh, self.state
        mesh.sweep(launch, self._gradient)(
            self._slope, mesh.threads(1), 0, self._geometry, s, self._depth, 0, 1,
            self._gradient.values, s,
        )  # fmt: skip
        launch(
            self._kick_kernel, mesh.size, mesh.places(2), mesh.inverse_area, mesh.lanes,
            mesh.size, self._gradient.flat, self._model.scene.planet.gravity, tau, rate, s,
        )  # fmt: skip
