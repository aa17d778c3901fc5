"""The limiter of tracers on the device."""

from functools import partial

import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.limiter import element_limiter, sphere_limiter
from swe_sphere.kernels.tracers import blocks_kernel
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher, in_runs
from swe_sphere.operators.replay import Replay


class Limiter:
    """Brings mixing ratios back into their bounds in place, each tracer keeping its mass.

    The depth has to be positive.  Where the bounds cannot hold the mass (which takes sources of
    fluid) they are kept and the mass is not.
    """

    def __init__(
        self, mesh: DeviceMesh, launch: Launcher, depth: int, first: int, lower: Array, upper: Array
    ) -> None:
        """depth, first: offsets of the depth and of the first tracer; bounds: one a tracer."""
        self._mesh, self._launch, self._count = mesh, launch, lower.size
        self._offsets = (depth, first)
        self._bounds = (mesh.upload(lower), mesh.upload(upper))
        self._inside = element_limiter(mesh.mesh.np, mesh.real, mesh.shape)
        self._across = sphere_limiter(mesh.real, mesh.lanes)
        self._limits = in_runs(self._across.limit_of, mesh.lanes, 0, mesh.size)
        self._geometry = mesh.geometry(self._inside.geometry)
        self._local = mesh.scratch(self._count, self._inside.value)
        self._sweep = mesh.sweep_of(launch, self._local.flat)
        self._places = mesh.places(self._count)
        self._add = in_runs(partial(blocks_kernel, mesh.real, True), mesh.lanes, 0, mesh.size)
        area = mesh.restrict(mesh.mesh.area)
        self._area = wp.array(area, dtype=wp.float64, device=mesh.device)
        chunks, count = mesh.chunks, self._count
        self._partial = wp.zeros((chunks.count, count), dtype=wp.vec3d, device=mesh.device)
        self._everything = self._partial
        """The partial sums, or of several ranks their sum."""
        if mesh.comm.shared:
            self._everything = wp.zeros((1, count), dtype=wp.vec3d, device=mesh.device)
        self._part = wp.zeros(self._count, dtype=wp.vec2d, device=mesh.device)
        kernels = [kernel for kernel, _, _ in (*self._add, *self._limits)]
        launch.load(self._inside.limit, self._across.sums, self._across.parts, *kernels)
        self._replay = Replay(launch)

    def __call__(self, state: wp.array) -> None:
        """Limit the tracers of a state."""
        if self._mesh.comm.shared:  # it adds up on the host
            self._limit(state)
        elif not self._replay(state.ptr):
            with self._replay.record(state.ptr):
                self._limit(state)

    def _limit(self, state: wp.array) -> None:
        self._within_elements(state)
        self._over_the_sphere(state)

    def _within_elements(self, state: wp.array) -> None:
        mesh, size, (_, first) = self._mesh, self._mesh.size, self._offsets
        self._sweep(
            self._inside.limit, mesh.groups, self._geometry, state, *self._offsets, self._count,
            *self._bounds, self._local.values,
        )  # fmt: skip
        for add, threads, begin in self._add:
            self._launch(
                add, threads, self._places, mesh.inverse_area, mesh.lanes, begin, size,
                self._count, first, self._local.flat, mesh.stage, state,
            )  # fmt: skip

    def _over_the_sphere(self, state: wp.array) -> None:
        size, across, chunks = self._mesh.size, self._across, self._mesh.chunks
        self._launch(
            across.sums, (self._count, chunks.count), self._area, state, *self._offsets, size,
            chunks.spans, *self._bounds, self._partial,
        )  # fmt: skip
        if self._everything is not self._partial:
            room = chunks.room(3 * self._count)
            room[:] = self._partial.numpy().reshape(room.shape)
            self._everything.assign(chunks.total(3 * self._count).reshape(1, -1, 3))
        blocks = self._everything.shape[0]
        self._launch(across.parts, self._count, self._everything, blocks, self._part)
        for limit, threads, begin in self._limits:
            self._launch(
                limit, threads, begin, *self._offsets, size, self._count, *self._bounds,
                self._part, state,
            )  # fmt: skip
