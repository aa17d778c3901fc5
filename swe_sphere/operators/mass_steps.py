"""Long steps of masses that a constant mass flux carries, on the device."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels import combine_kernel
from swe_sphere.kernels.simd.stages import stage_struct
from swe_sphere.kernels.tracers import crossings
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.tracers import MixingRatio, TracerTransport
from swe_sphere.ranks.limits import check_stop


class Crossings:
    """Measures how fast a mass flux crosses elements."""

    def __init__(self, mesh: DeviceMesh, launch: Launcher) -> None:
        self._mesh, self._launch, types = mesh, launch, mesh.types()
        self._symbol = symbol(mesh.mesh.derivative, mesh.mesh.gll_weights)
        (self._kernel,) = launch.compile(types, crossings)
        self._geometry = mesh.geometry(types.geometry)
        self._most = wp.zeros(mesh.groups, dtype=types.value, device=mesh.device)

    def bound(self, flux: wp.array, air: wp.array) -> float:
        """Bound the spectral radius [s-1] of q -> div(q flux) / air, to within about a third."""
        self._launch(self._kernel, self._mesh.groups, self._geometry, flux, air, self._most)
        return self._symbol * float(self._mesh.comm.of_each(self._most.numpy().max()).max())


class FluxSteps:
    """Solves dm/dt = -div(q F), q = m / h; h changes linearly to its new value: q = 1 stays 1.

    F is a mass flux, and dh/dt = -div(F). The `count` masses m are blocks (N,) from `first` on in
    states (size,); h starts at the offset `depth`.
    """

    def __init__(
        self, mesh: DeviceMesh, launch: Launcher, size: int, depth: int, first: int, count: int
    ) -> None:
        self._mesh, self._launch, self._first = mesh, launch, first
        self._transport, self._air_transport = (
            TracerTransport(mesh, launch, fields) for fields in (count, 1)
        )
        self._work = wp.zeros(size, dtype=mesh.real, device=mesh.device)
        self._stages: dict[tuple[int, float], Any] = {}
        self._ratio = MixingRatio(mesh, launch, count, depth, first)
        self._ones = mesh.upload(np.ones(mesh.size))
        self._old, self._rate = (wp.zeros_like(self._ones) for _ in "or")
        self._depth, self._add = slice(depth, depth + mesh.size), combine_kernel(mesh.real, 1)
        launch.load(self._add)

    def __call__(
        self, flux: wp.array, state: wp.array, tau: float, parts: int, fractions: Sequence[float]
    ) -> None:
        """Step the masses of a state by tau [s] in equal parts, by a flux in front of `flux`.

        In each part m_i = m_0 + fractions_i (tau / parts) dm/dt(m_(i-1)); the last fraction is 1.
        """
        wp.copy(self._old, state[self._depth])
        self._air_transport(flux, self._ones, 0, self._rate, 0)
        self._mix(state, 0.0)
        for part in range(parts):
            check_stop()
            for i, fraction in enumerate(fractions):
                out, step = self._work if i + 1 < len(fractions) else state, fraction * tau / parts
                stage = self._stage(state, step)
                self._transport(flux, self._ratio.values, 0, out, self._first, stage)
                self._mix(out, part * tau / parts + step)

    def _mix(self, state: wp.array, t: float) -> None:
        """Find the mixing ratios of a state t [s] after the beginning, and its depth."""
        depth = state[self._depth]
        self._launch(self._add, depth.size, self._old, self._rate, t, depth)
        self._ratio.set(state)

    def _stage(self, state: wp.array, tau: float) -> Any:
        if (state.ptr, tau) not in self._stages:
            stage = self._stages[state.ptr, tau] = stage_struct(self._mesh.real)()
            stage.on, stage.start, stage.tau = True, state, tau
        return self._stages[state.ptr, tau]


def symbol(derivative: Array, weights: Array) -> float:
    """Return the largest modulus of the eigenvalues of d/dxi after DSS, on equal elements.

    Elements have length 2; the maximum is over all waves exp(i phase) from one element to the next.
    """
    last, largest = len(weights) - 1, 0.0
    for phase in np.linspace(0.0, np.pi, 181):
        shift = np.eye(last + 1, last, dtype=complex)
        shift[last, 0] = np.exp(1j * phase)
        mass = (shift.conj().T * weights) @ shift
        matrix = np.linalg.solve(mass, shift.conj().T @ (weights[:, None] * derivative) @ shift)
        largest = max(largest, float(np.abs(np.linalg.eigvals(matrix)).max()))
    return largest
