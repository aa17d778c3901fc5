"""Damping factor of implicit diffusion, applied to the modes of each element.

The factor is (I + tau D)^-1 for effects that damp waves of wavenumber k at a rate D(k). It is
applied element by element, in the eigenfunctions of the weak Laplacian of an element without flux
through its boundary, which is treated as a rectangle of its mean size.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels.damping import covariant, damp, joined, physical
from swe_sphere.operators.device_mesh import DeviceMesh, Field
from swe_sphere.operators.launch import Launcher

MOST = 5.0
"""Upper bound on tau D of the shortest waves, also in longer steps.  F does not commute with G and
D, and the multilevel cycle diverges if F removes almost all of the shortest waves."""

Rate = Callable[[Array], Array]
"""Function from squared wavenumbers k^2 [m-2] to damping rates [s-1] of these waves."""


class Damping:
    """F = (I + tau D)^-1 on fields, and on wind and depth of states of the number type `given`."""

    def __init__(self, mesh: DeviceMesh, launch: Launcher, rate: Rate, given: Any) -> None:
        self._mesh, self._launch, self._rate = mesh, launch, rate
        types = mesh.types(given=given)
        self._dim = mesh.groups, mesh.points // types.share
        self._filter, self._covariant, self._physical, self._joined = launch.compile(
            types, damp, covariant, physical, joined
        )
        d, weights, basis = mesh.mesh.derivative, mesh.mesh.gll_weights, mesh.mesh.basis
        squares, vectors = scipy.linalg.eigh(d.T @ np.diag(weights) @ d, np.diag(weights))
        squares = np.maximum(squares, 0.0)  # eigenvalues of the weak Laplacian on [-1, 1]
        self._to_modes = mesh.upload(vectors.T * weights)
        self._to_nodes = mesh.upload(vectors)
        inverse = np.linalg.inv(np.einsum("eijak,eijbk->eijab", basis, basis)).mean(axis=(1, 2))
        along_1, along_2 = inverse[:, 0, 0, None, None], inverse[:, 1, 1, None, None]
        self._wavenumbers: Array = along_1 * squares[:, None] + along_2 * squares
        """k^2 (E, np, np) [m-2] of the products of the modes of an element."""
        jacobian = mesh.mesh.jacobian[mesh.part.elements]
        self._mass = mesh.on_elements(mesh.mesh.quadrature * jacobian)
        self._ones = mesh.on_elements(np.ones_like(jacobian))
        self._once, self._twice = (mesh.on_elements(np.ones_like(jacobian)) for _ in range(2))
        dtype = self._mass.dtype
        self._first, self._east, self._north = (mesh.local(1, dtype) for _ in range(3))
        self._second = mesh.unshared(1, dtype)
        self.state = wp.zeros(3 * mesh.size, dtype=given, device=mesh.device)
        """State of the last call of `damp_wind`."""

    def configure(self, tau: float) -> None:
        """Set the implicit step [s]."""
        strongest = tau * float(self._rate(self._wavenumbers).max())
        rate = self._rate(self._wavenumbers[self._mesh.part.elements])
        factor = 1.0 / (1.0 + tau * min(1.0, MOST / max(strongest, MOST)) * rate)
        wp.copy(self._once, self._mesh.on_elements(factor))
        wp.copy(self._twice, self._mesh.on_elements(factor**2))

    def damp_twice(self, x: Field, out: Field) -> None:
        """Set out = F^2 x in each element separately."""
        self._damp(self._twice, self._ones, x, out)

    def damp_depth(self, h: Field, out: wp.array) -> None:
        """Set the depth of the state `out` to F h, after DSS."""
        self._damp(self._once, self._mass, h, self._first)
        self._join(self._first, 2, out)

    def damp_wind(self, r: wp.array) -> wp.array:
        """Return a state with the wind F V of r, after DSS, and the depth of r."""
        mesh, one, two, size = self._mesh, self._first, self._second, self._mesh.size
        self._launch(
            self._covariant, self._dim, mesh.nodes, mesh.basis, size, r, one.values, two.values
        )
        for each in (one, two):
            self._damp(self._once, self._ones, each, each)
        self._launch(
            self._physical, self._dim, mesh.weight, mesh.basis, one.values, two.values,
            self._east.values, self._north.values,
        )  # fmt: skip
        self._join(self._east, 0, self.state)
        self._join(self._north, 1, self.state)
        wp.copy(self.state, r, 2 * size, 2 * size, size)
        return self.state

    def _damp(self, factor: wp.array, scale: wp.array, x: Field, out: Field) -> None:
        self._launch(
            self._filter, self._mesh.groups, self._to_modes, self._to_nodes, factor, scale,
            x.values, out.values,
        )  # fmt: skip

    def _join(self, local: Field, block: int, out: wp.array) -> None:
        mesh = self._mesh
        mesh.exchange(local)
        self._launch(
            self._joined, mesh.size, mesh.places(1), mesh.inverse_area, local.flat,
            block * mesh.size, out,
        )  # fmt: skip
