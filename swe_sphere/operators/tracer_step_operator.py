"""Long steps of tracers, which a mass flux that is fixed in time carries, on the device."""

from collections.abc import Sequence
from dataclasses import dataclass

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
from swe_sphere.operators.transport_operator import TracerTransport


@dataclass(frozen=True)
class Air:
    """The depth at a time t during a step, start + t rate: both (N,), [m] and [m s-1]."""

    start: wp.array
    rate: wp.array


class Crossings:
    """How fast a mass flux carries things across elements."""

    def __init__(self, mesh: DeviceMesh, launch: Launcher) -> None:
        self.mesh = scalar_mesh(mesh)
        self._launch, self._symbol = launch, symbol(mesh.mesh.derivative, mesh.mesh.gll_weights)
        self._kernels = crossing_kernels(mesh.mesh.np, mesh.real)
        self._geometry = self.mesh.geometry(self._kernels.geometry)
        elements, real, device = mesh.elements, mesh.real, mesh.device
        self.across = wp.zeros((elements, self.mesh.points, 2), dtype=real, device=device)
        """The flux across lines of the reference coordinates, times the area element."""
        self._most = wp.zeros(elements, dtype=real, device=device)
        launch.load(self._kernels.contravariant, self._kernels.crossings)

    def take(self, flux: wp.array) -> None:
        """Make `across` of a mass flux (2N, ...) [m2 s-1]."""
        kernel, elements = self._kernels.contravariant, self.mesh.elements
        self._launch(kernel, elements, self._geometry, flux, self.across)

    def bound(self, flux: wp.array, air: wp.array) -> float:
        """About the spectral radius [s-1], or up to a third more, of q -> div(q flux) / air."""
        kernel, mesh, elements = self._kernels.crossings, self.mesh, self.mesh.elements
        self._launch(kernel, elements, self._geometry, flux, air, self._most)
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
        self._mesh, real, device = crossings.mesh, mesh.real, mesh.device
        lanes = (LANES[0] if count <= LANES[0] else LANES[1]) if mesh.lanes > 1 else 1
        self._blocks, size = -(-count // lanes), mesh.size
        self._divergence = divergence_kernel(mesh.mesh.np, real, lanes)
        self._kernels = stage_kernels(real, lanes)
        self._mass, self._q = (
            wp.zeros(self._blocks * size, dtype=self._kernels.value, device=device) for _ in "mq"
        )
        scalar, value = self._mesh, self._kernels.value
        self._local = wp.zeros((self._blocks, scalar.rows), dtype=value, device=device)
        self._flat = scalar.share_blocks(self._local, lanes)
        self._air_transport, self._ones = (
            TracerTransport(mesh, launch, 1),
            mesh.upload(np.ones(size)),
        )
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
        launch, size, kernels = self._launch, self._mesh.size, self._kernels
        dim, tracers = (size, self._blocks), (self._first, self._count, size)
        self._crossings.take(flux)
        depth = air.start, air.rate
        launch(kernels.begin, dim, state, *tracers, *depth, 0.0, self._mass, self._q)
        for part in range(parts):
            for i, fraction in enumerate(fractions):
                self._tendency()
                step, keep = fraction * tau / parts, int(i + 1 == len(fractions))
                launch(
                    kernels.stage, dim, self._mesh.places(1), self._mesh.inverse_area, size,
                    self._local, step, *depth, part * tau / parts + step, keep, self._mass, self._q,
                )  # fmt: skip
        launch(kernels.finish, dim, self._mass, *tracers, state)

    def _tendency(self) -> None:
        mesh = self._mesh
        self._launch(
            self._divergence, (mesh.elements, self._blocks), mesh.nodes, mesh.derivative,
            mesh.weight, self._crossings.across, mesh.size, self._q, self._local,
        )  # fmt: skip
        mesh.exchange(self._flat)


def scalar_mesh(mesh: DeviceMesh) -> DeviceMesh:
    """The mesh with one element in each group."""
    return mesh if mesh.lanes == 1 else mesh.like(mesh.real, "node")


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
