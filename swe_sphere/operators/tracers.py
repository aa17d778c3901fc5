"""Flux-form transport of tracers on the device, their mixing ratios, limiter and long steps."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.assembly import assemble_blocks
from swe_sphere.kernels.dynamics import transport
from swe_sphere.kernels.limiter import limit_elements, limit_sphere, room_parts, sum_rooms
from swe_sphere.kernels.local import field_kernel
from swe_sphere.kernels.tracers import correct, courant_rates, follow, mixing_ratio
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.replay import Replay
from swe_sphere.ranks.limits import check_stop


class TracerTransport:
    """Transport -div(hq V) of `count` tracers, whose blocks (N,) are consecutive in a vector."""

    def __init__(self, mesh: DeviceMesh, count: int) -> None:
        self.mesh, self.count = mesh, count
        types = mesh.types()
        self._kernel = field_kernel(types, transport(alone=count == 1))
        self._assemble = mesh.over_nodes(assemble_blocks)
        self._geometry = mesh.geometry(types.geometry)
        self._local, self._places = mesh.scratch(count, types.value), mesh.places(count)
        mesh.launch.load(self._kernel)

    def __call__(
        self, wind: wp.array, x: wp.array, first: int, out: wp.array, to: int, stage: Any = None,
        kernel: Any = None,
    ) -> None:  # fmt: skip
        """Set out[to:] = -div(m V) for masses m in x[first:] and the wind V = wind[:2N].

        With a `stage` (a `stage_struct`), out[to:] is the result of the stage instead of the rate.
        """
        mesh, local, count = self.mesh, self._local, self.count
        kernel, stage = kernel or self._kernel, mesh.stage if stage is None else stage
        arguments = self._geometry, wind, x, first, count, local.values, x
        mesh.over_elements(local, kernel, mesh.threads(count), *arguments, wait=False)
        numbers = mesh.lanes, mesh.size, count, to
        self._assemble(self._places, mesh.inverse_area, *numbers, local.flat, stage, out)

    def tangent(self, base: wp.array, x: wp.array, first: int, out: wp.array) -> None:
        """Set out[first:] = -div(m' V + m V') for (V, m) of the state `base` and (V', m') of x."""
        self(base, x, first, out, first, kernel=self._tangent)

    @cached_property
    def _tangent(self) -> Any:  # explicit steppers never compile it
        kernel = field_kernel(self.mesh.types(), transport(True))
        self.mesh.launch.load(kernel)
        return kernel


class MixingRatio:
    """Mixing ratios q = hq/h of `count` tracers, and tracer increments, q times those of depth.

    `depth` and `first`: offsets of the depth and of the first tracer in a state vector.
    """

    def __init__(self, mesh: DeviceMesh, count: int, depth: int, first: int) -> None:
        self._launch, self._offsets = mesh.launch, (depth, first, mesh.size)
        self._dim = (count, mesh.size)
        self.values = wp.zeros(count * mesh.size, dtype=mesh.real, device=mesh.device)
        """(count*N,) mixing ratios of the last `set`."""
        kernels = mesh.launch.compile(mesh.real, mixing_ratio, follow, correct)
        self._ratio, self._follow, self._correct = kernels

    def set(self, state: wp.array) -> None:
        """Store the mixing ratios of a state."""
        self._launch(self._ratio, self._dim, state, *self._offsets, self.values)

    def follow(self, r: wp.array, x: wp.array) -> None:
        """Set x_hq = r_hq + q (x_h - r_h): tracers change in proportion to the depth."""
        self._launch(self._follow, self._dim, r, x, self.values, *self._offsets)

    def correct(
        self, rates: wp.array, depth_rate: wp.array, factor: float, r: wp.array, x: wp.array
    ) -> None:
        """Set x_hq = r_hq + factor rates + q (x_h - r_h - factor depth_rate)."""
        inputs = self.values, rates, depth_rate, factor
        self._launch(self._correct, self._dim, *inputs, *self._offsets, r, x)


class Limiter:
    """Brings mixing ratios back into their bounds in place and conserves each tracer's mass.

    The depth must be positive. If the bounds cannot hold the mass (which requires sources of
    fluid), the limiter keeps the bounds and not the mass.
    """

    def __init__(self, mesh: DeviceMesh, depth: int, first: int, low: Array, high: Array) -> None:
        """Prepare for the offsets `depth` and `first` in states, and bounds for each tracer."""
        types, launch, chunks, count = mesh.types(), mesh.launch, mesh.chunks, low.size
        self._mesh, self._launch, self._count = mesh, launch, count
        self._offsets, self._bounds = (depth, first), (mesh.upload(low), mesh.upload(high))
        kernels = launch.compile(types, limit_elements, sum_rooms, room_parts)
        self._inside, self._sums, self._parts = kernels
        self._fill = mesh.over_nodes(limit_sphere)
        self._geometry = mesh.geometry(types.geometry)
        self._local, self._places = mesh.scratch(count, types.value), mesh.places(count)
        self._add = mesh.over_nodes(assemble_blocks)
        self._area = wp.array(mesh.on_rank(mesh.mesh.area), dtype=wp.float64, device=mesh.device)
        self._partial = wp.zeros((chunks.count, count), dtype=wp.vec3d, device=mesh.device)
        self._everything = self._partial
        """The partial sums; with several ranks, their total."""
        if mesh.comm.shared:
            self._everything = wp.zeros((1, count), dtype=wp.vec3d, device=mesh.device)
        self._part = wp.zeros(count, dtype=wp.vec2d, device=mesh.device)
        self._replay = Replay(launch)

    def __call__(self, state: wp.array) -> None:
        if self._mesh.comm.shared:  # ranks add on the host
            self._limit(state)
        else:
            self._replay(state.ptr, self._limit, state)

    def _limit(self, state: wp.array) -> None:
        mesh, chunks, (_, first), local = self._mesh, self._mesh.chunks, self._offsets, self._local
        inputs = self._geometry, state, *self._offsets, self._count, *self._bounds
        mesh.over_elements(local, self._inside, mesh.groups, *inputs, local.values, wait=False)
        parts = mesh.inverse_area, mesh.lanes, mesh.size, self._count, first, local.flat
        self._add(self._places, *parts, mesh.stage_at(state, 1.0), state)
        # the excess of the elements fills the room over the sphere
        whole = self._area, state, *self._offsets, mesh.size, chunks.spans, *self._bounds
        self._launch(self._sums, (self._count, chunks.count), *whole, self._partial)
        if self._everything is not self._partial:
            sums = chunks.partial_sums(3 * self._count)
            sums[:] = self._partial.numpy().reshape(sums.shape)
            self._everything.assign(chunks.total(3 * self._count).reshape(1, -1, 3))
        blocks = self._everything.shape[0]
        self._launch(self._parts, self._count, self._everything, blocks, self._part)
        self._fill(*self._offsets, mesh.size, self._count, *self._bounds, self._part, state)


class CourantRate:
    """Measures how fast a mass flux crosses elements."""

    def __init__(self, mesh: DeviceMesh) -> None:
        self._mesh, types = mesh, mesh.types()
        self._symbol = symbol(mesh.mesh.derivative, mesh.mesh.gll_weights)
        (self._kernel,) = mesh.launch.compile(types, courant_rates)
        self._geometry = mesh.geometry(types.geometry)
        self._max = wp.zeros(mesh.groups, dtype=types.value, device=mesh.device)

    def bound(self, flux: wp.array, depth: wp.array) -> float:
        """Return an upper estimate [s-1] of the spectral radius of q -> div(q flux) / depth."""
        self._mesh.launch(self._kernel, self._mesh.groups, self._geometry, flux, depth, self._max)
        return float(self._symbol * self._mesh.comm.allgather_number(self._max.numpy().max()).max())


class MassSteps:
    """Solves dm/dt = -div(m V) for `count` masses m, blocks (N,) from `first` on in states (size,).

    With the offset `depth` of h, the flow is a mass flux F: dm/dt = -div(q F) with q = m / h, and
    dh/dt = -div(F). h changes linearly in time, so that q = 1 stays 1.
    """

    def __init__(
        self, mesh: DeviceMesh, size: int, first: int, count: int, depth: int | None = None
    ) -> None:
        self._mesh, self._first = mesh, first
        self._transport = TracerTransport(mesh, count)
        self._work = wp.zeros(size, dtype=mesh.real, device=mesh.device)
        self._ratio: MixingRatio | None = None
        if depth is not None:
            self._ratio = MixingRatio(mesh, count, depth, first)
            self._depth_transport = TracerTransport(mesh, 1)
            self._ones = mesh.upload(np.ones(mesh.size))
            self._old, self._depth_rate = (wp.zeros_like(self._ones) for _ in "or")
            self._depth = slice(depth, depth + mesh.size)

    def __call__(
        self, flow: wp.array, state: wp.array, tau: float, parts: int, fractions: Sequence[float]
    ) -> None:
        """Step the masses of a state by tau [s] in `parts` equal sub-steps with the flow[:2N].

        A sub-step is m_i = m_0 + fractions_i (tau / parts) dm/dt(m_(i-1)); the last fraction is 1.
        """
        if self._ratio is not None:
            wp.copy(self._old, state[self._depth])
            self._depth_transport(flow, self._ones, 0, self._depth_rate, 0)
        carried, at = self._carried(state, 0.0)
        for part in range(parts):
            check_stop()
            for i, fraction in enumerate(fractions):
                out, step = self._work if i + 1 < len(fractions) else state, fraction * tau / parts
                stage = self._mesh.stage_at(state, step)
                self._transport(flow, carried, at, out, self._first, stage)
                carried, at = self._carried(out, part * tau / parts + step)

    def _carried(self, state: wp.array, t: float) -> tuple[wp.array, int]:
        """Return the array that the flow carries t [s] after the beginning, and its offset."""
        if self._ratio is None:
            return state, self._first
        self._mesh.launch.combine(self._old, self._depth_rate, t, out=state[self._depth])
        self._ratio.set(state)
        return self._ratio.values, 0


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
