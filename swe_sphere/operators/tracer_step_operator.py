"""Long steps of tracers, which a mass flux that is fixed in time carries, on the device."""

from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.tracer_step import (
    LANES,
    crossing_kernels,
    divergence_kernel,
    stage_kernels,
)
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.tracers import TracerTransport

Air = tuple[wp.array, wp.array]
"""(start, rate), both (N,), [m] and [m s-1], of the depth start + t rate at a time t of a step."""


class Crossings:
    """How fast a mass flux carries things across elements."""

    def __init__(self, mesh: DeviceMesh, launch: Launcher) -> None:
        self.mesh = mesh.like(mesh.real, "node")
        """The mesh with one element in each group."""
        self._launch, self._symbol = launch, symbol(mesh.mesh.derivative, mesh.mesh.gll_weights)
        self._contravariant, self._crossings, kind = crossing_kernels(mesh.mesh.np, mesh.real)
        self._geometry = self.mesh.geometry(kind)
        elements, real, device = mesh.elements, mesh.real, mesh.device
        self.across = wp.zeros((elements, self.mesh.points, 2), dtype=real, device=device)
        """The flux across lines of the reference coordinates, times the area element."""
        self._most = wp.zeros(elements, dtype=real, device=device)
        launch.load(self._contravariant, self._crossings)

    def take(self, flux: wp.array) -> None:
        """Make `across` of a mass flux (2N, ...) [m2 s-1]."""
        self._launch(self._contravariant, self.mesh.elements, self._geometry, flux, self.across)

    def bound(self, flux: wp.array, air: wp.array) -> float:
        """About the spectral radius [s-1], or up to a third more, of q -> div(q flux) / air."""
        mesh, launch = self.mesh, self._launch
        launch(self._crossings, mesh.elements, self._geometry, flux, air, self._most)
        return self._symbol * float(mesh.comm.of_each(self._most.numpy().max()).max())


class TracerStep:
    """dm/dt = -div(m F / h) for `count` masses m, whose blocks (N,) stand in a state from `first`.

    F (2N,) is a mass flux and h the depth of some `Air` whose rate is -div(F).
    """

    def __init__(
        self, mesh: DeviceMesh, launch: Launcher, crossings: Crossings, count: int, first: int
    ) -> None:
        self._launch, self._count, self._first = launch, count, first
        self._crossings = crossings
        self._mesh, real = crossings.mesh, mesh.real
        lanes = (LANES[0] if count <= LANES[0] else LANES[1]) if mesh.lanes > 1 else 1
        self._blocks, size = -(-count // lanes), mesh.size
        self._divergence = divergence_kernel(mesh.mesh.np, real, lanes)
        self._kernels = stage_kernels(real, lanes)
        value, count = self._kernels.value, self._blocks * size
        self._mass, self._q = (wp.zeros(count, dtype=value, device=mesh.device) for _ in "mq")
        self._field = self._mesh.local(1, value, self._blocks)
        self._local = self._field.values.reshape((self._blocks, self._mesh.rows))
        self._air_transport, ones = TracerTransport(mesh, launch, 1), np.ones(size)
        self._ones = mesh.upload(ones)
        made = self._kernels
        launch.load(self._divergence, made.begin, made.stage, made.finish)

    def rate_of_air(self, flux: wp.array, out: wp.array) -> None:
        """out (N,) = -div(F)."""
        self._air_transport(flux, self._ones, 0, out, 0)

    def __call__(
        self,
        flux: wp.array,
        air: Air,
        state: wp.array,
        tau: float,
        parts: int,
        fractions: Sequence[float],
    ) -> None:
        """Step the masses of a state by tau [s], in equal parts.

        In each m_i = m_0 + fractions_i (tau / parts) dm/dt(m_(i-1)); the last fraction is 1.
        """
        launch, mesh, size, kernels = self._launch, self._mesh, self._mesh.size, self._kernels
        dim, tracers = (size, self._blocks), (self._first, self._count, size)
        self._crossings.take(flux)
        launch(kernels.begin, dim, state, *tracers, *air, 0.0, self._mass, self._q)
        for part in range(parts):
            for i, fraction in enumerate(fractions):
                launch(
                    self._divergence, (mesh.elements, self._blocks), mesh.nodes, mesh.derivative,
                    mesh.weight, self._crossings.across, size, self._q, self._local,
                )  # fmt: skip
                mesh.exchange(self._field)
                step, keep = fraction * tau / parts, int(i + 1 == len(fractions))
                launch(
                    kernels.stage, dim, mesh.places(1), mesh.inverse_area, size, self._local, step,
                    *air, part * tau / parts + step, keep, self._mass, self._q,
                )  # fmt: skip
        launch(kernels.finish, dim, self._mass, *tracers, state)


def symbol(derivative: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Largest modulus of the eigenvalues of d/dxi after DSS, on equal elements of length 2.

    Over all waves exp(i phase) from one element to the next.
    """
    last, largest = len(weights) - 1, 0.0
    for phase in np.linspace(0.0, np.pi, 181):
        shift = np.eye(last + 1, last, dtype=complex)
        shift[last, 0] = np.exp(1j * phase)
        mass = (shift.conj().T * weights) @ shift
        matrix = np.linalg.solve(mass, shift.conj().T @ (weights[:, None] * derivative) @ shift)
        largest = max(largest, float(np.abs(np.linalg.eigvals(matrix)).max()))
    return largest
