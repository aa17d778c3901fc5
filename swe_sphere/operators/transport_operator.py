"""Flux-form transport of tracers on the device, DSS included, and their mixing ratios."""

from functools import partial
from typing import Any

import warp as wp

from swe_sphere.kernels.local import field_kernels
from swe_sphere.kernels.tracers import blocks_kernel, pointwise_kernels
from swe_sphere.operators.device_mesh import DeviceMesh
from swe_sphere.operators.launch import Launcher, in_runs


class TracerTransport:
    """-div(hq V) of `count` tracers, whose blocks (N,) follow each other in a vector."""

    def __init__(self, mesh: DeviceMesh, launch: Launcher, count: int) -> None:
        self.mesh, self.count, self._launch = mesh, count, launch
        self._kernels = field_kernels(mesh.mesh.np, mesh.real, mesh.shape)
        assembly_of = partial(blocks_kernel, mesh.real, False)
        self._assembly = in_runs(assembly_of, mesh.lanes, 0, mesh.size)
        self._geometry = mesh.geometry(self._kernels.geometry)
        self._local, self._places = mesh.scratch(count, self._kernels.value), mesh.places(count)
        self._sweep = mesh.sweep_of(launch, self._local.flat)
        launch.load(self._kernels.transport, *(kernel for kernel, _, _ in self._assembly))
        self._has_tangent = False

    def __call__(
        self, wind: wp.array, x: wp.array, first: int, out: wp.array, to: int, stage: Any = None,
        kernel: Any = None,
    ) -> None:  # fmt: skip
        """out[to:] = -div(m V) for the masses m in x[first:] and the wind V in front of `wind`.

        With a `stage` (a `stage_struct`), out[to:] is the result of the stage instead of the rate.
        """
        mesh, local, count = self.mesh, self._local, self.count
        kernel, stage = kernel or self._kernels.transport, mesh.stage if stage is None else stage
        dim, geometry = mesh.dim_of(count), self._geometry
        self._sweep(kernel, dim, geometry, wind, x, first, count, local.values)
        for assemble, threads, begin in self._assembly:
            self._launch(
                assemble, threads, self._places, mesh.inverse_area, mesh.lanes, begin, mesh.size,
                count, to, local.flat, stage, out,
            )  # fmt: skip

    def tangent(self, base: wp.array, x: wp.array, first: int, out: wp.array) -> None:
        """out[first:] = -div(m' V + m V') for (V, m) of the state `base` and (V', m') of x."""
        if not self._has_tangent:  # explicit steppers never compile it
            self._launch.load(self._kernels.tangent)
            self._has_tangent = True
        self(base, x, first, out, first, kernel=self._kernels.tangent)


class MixingRatio:
    """q = hq/h of `count` tracers at a state, and vectors that follow the depth with it.

    `depth` and `first`: offsets of the depth and of the first tracer in a state vector.
    """

    def __init__(
        self, mesh: DeviceMesh, launch: Launcher, count: int, depth: int, first: int
    ) -> None:
        self._launch, self._offsets = launch, (depth, first, mesh.size)
        self._dim = (count, mesh.size)
        self._kernels = pointwise_kernels(mesh.real)
        self.values = wp.zeros(count * mesh.size, dtype=mesh.real, device=mesh.device)
        """(count*N,)"""
        kernels = self._kernels
        launch.load(kernels.mixing_ratio, kernels.follow, kernels.correct)

    def set(self, state: wp.array) -> None:
        """Take the mixing ratios of a state."""
        self._launch(self._kernels.mixing_ratio, self._dim, state, *self._offsets, self.values)

    def follow(self, r: wp.array, x: wp.array) -> None:
        """x_hq = r_hq + q (x_h - r_h): what changed the depth changes the tracers with it."""
        self._launch(self._kernels.follow, self._dim, r, x, self.values, *self._offsets)

    def correct(
        self, flux: wp.array, air: wp.array, factor: float, r: wp.array, x: wp.array
    ) -> None:
        """x_hq = r_hq + factor flux + q (x_h - r_h - factor air)."""
        self._launch(
            self._kernels.correct, self._dim, self.values, flux, air, factor, *self._offsets, r, x
        )
