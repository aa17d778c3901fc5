"""Block elimination of the linearised shallow-water equations, on the device and as matrices.

For A = I - tau L with L(V, h) = (-f k x V - g G h, -D H V), elimination of the wind leads to S dh =
r_h - tau D H T r_V with S = I - tau^2 g D H T G and T = (I + tau f k x)^-1, and then dV = T (r_V -
tau g G dh). Some effects damp wind and depth at a rate R that depends on the wavenumber. With F =
(I + tau R)^-1 and S = I - tau^2 g D H T G F^2, the solution is then approximated as if F commuted
with all operators and (F^-1 + tau f k x)^-1 were T F: S dk = r_h - tau D H T F r_V, dh = F dk, dV =
T (F r_V - tau g G F^2 dk).

G and D are the model's operators after DSS: a compact Laplacian instead is a bad preconditioner,
because it differs on the grid-scale modes. `SchurMatrix` holds S as sparse matrices on the host,
for diagonals, coarse levels and patches.
"""

from __future__ import annotations  # scipy.sparse is loaded where it is used

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
import warp as wp

from swe_sphere.arrays import Array
from swe_sphere.kernels import Terms, helmholtz
from swe_sphere.kernels.damping import covariant, damp, joined_kernel, physical
from swe_sphere.mesh import Mesh
from swe_sphere.operators import sparse
from swe_sphere.operators.device_mesh import DeviceMesh, Field
from swe_sphere.operators.sparse import column_squares

MOST_DAMPING = 5.0
"""Largest product of tau and the damping rate R; in longer steps R is reduced.  F does not commute
with G and D, and the multilevel cycle diverges if F removes almost all of the shortest waves."""

Rate = Callable[[Array], Array]
"""Function from squared wavenumbers k^2 [m-2] to damping rates [s-1] of these waves."""


class Damping:
    """F = (I + tau R)^-1 on fields, and on wind and depth of states of the number type `given`.

    R damps waves of wavenumber k at the `rate` R(k^2). F is applied element by element, in the
    eigenfunctions of the weak Laplacian without flux through the boundary. For this purpose an
    element is a rectangle of its mean size.
    """

    def __init__(self, mesh: DeviceMesh, rate: Rate, given: Any) -> None:
        self._mesh, self._launch = mesh, mesh.launch
        types = mesh.types(given=given)
        self._dim = types.threads(mesh.groups)
        kernels = mesh.launch.compile(types, damp, covariant, physical)
        self._filter, self._covariant, self._physical = kernels
        self._joined = mesh.over_nodes(joined_kernel(given))
        d, weights, basis = mesh.mesh.derivative, mesh.mesh.gll_weights, mesh.mesh.basis
        squares, vectors = scipy.linalg.eigh(d.T @ np.diag(weights) @ d, np.diag(weights))
        squares = np.maximum(squares, 0.0)  # eigenvalues of the weak Laplacian on [-1, 1]
        self._to_modes = mesh.upload(vectors.T * weights)
        self._to_nodes = mesh.upload(vectors)
        inverse = sparse.inverse_metric(basis, mesh.mesh.jacobian).mean(axis=(1, 2))
        along_1, along_2 = inverse[:, 0, 0, None, None], inverse[:, 1, 1, None, None]
        rates = rate(along_1 * squares[:, None] + along_2 * squares)  # of products of the modes
        self._rates: Array = rates[mesh.part.element_numbers]
        """R (e, np, np) [s-1] of the products of the modes of an element."""
        strongest = float(rates.max())
        self._longest = MOST_DAMPING / strongest if strongest > 0.0 else math.inf
        jacobian = mesh.mesh.jacobian[mesh.part.element_numbers]
        self._mass = mesh.on_elements(mesh.mesh.quadrature * jacobian)
        ones = np.ones_like(jacobian)
        self._ones, self._once, self._twice = (mesh.on_elements(ones) for _ in range(3))
        self._first, self._east, self._north = (mesh.local(1, self._mass.dtype) for _ in range(3))
        self._second = mesh.unshared(1, self._mass.dtype)
        self.state = wp.zeros(3 * mesh.size, dtype=given, device=mesh.device)
        """State of the last call of `damp_wind`."""

    def configure(self, tau: float) -> None:
        """Set the implicit step tau [s]."""
        factor = 1.0 / (1.0 + min(tau, self._longest) * self._rates)
        wp.copy(self._once, self._mesh.on_elements(factor))
        wp.copy(self._twice, self._mesh.on_elements(factor**2))

    def damp_twice(self, x: Field) -> Field:
        """Return F^2 x by element, valid until the next call of `damp_twice` or `damp_wind`."""
        self._damp(self._twice, self._ones, x, self._second)
        return self._second

    def damp_depth(self, h: Field, out: wp.array) -> None:
        """Set the depth of the state `out` to F h, after DSS."""
        self._damp(self._once, self._mass, h, self._first)
        self._join(self._first, 2, out)

    def damp_wind(self, r: wp.array) -> wp.array:
        """Return a state with the wind F V of r, after DSS, and the depth of r."""
        mesh, one, two, size = self._mesh, self._first, self._second, self._mesh.size
        values = one.values, two.values
        self._launch(self._covariant, self._dim, mesh.nodes, mesh.basis, size, r, *values)
        for each in (one, two):
            self._damp(self._once, self._ones, each, each)
        inputs = mesh.weight, mesh.basis, *values, self._east.values, self._north.values
        self._launch(self._physical, self._dim, *inputs)
        self._join(self._east, 0, self.state)
        self._join(self._north, 1, self.state)
        wp.copy(self.state, r, 2 * size, 2 * size, size)
        return self.state

    def _damp(self, factor: wp.array, scale: wp.array, x: Field, out: Field) -> None:
        inputs = self._to_modes, self._to_nodes, factor, scale, x.values, out.values
        self._launch(self._filter, self._mesh.groups, *inputs)

    def _join(self, local: Field, block: int, out: wp.array) -> None:
        mesh = self._mesh
        mesh.exchange(local)
        self._joined(mesh.places(1), mesh.inverse_area, local.flat, block * mesh.size, out)


class SchurOperator:
    """The eliminated system in the number type of `mesh`, for state vectors (3N,) of type `given`.

    gravity [m s-2], coriolis (N,) [s-1]. Call `configure` first. With `damping`, formulas contain F
    as in the module's docstring, but not in diag S. Numpy arrays span the mesh, vectors this rank.
    """

    def __init__(
        self, mesh: DeviceMesh, gravity: float, coriolis: Array, given: Any,
        damping: Rate | None = None,
    ) -> None:  # fmt: skip
        self.mesh, self.gravity, self.size, self.tau = mesh, gravity, mesh.size, 0.0
        self.matrix = SchurMatrix(mesh.mesh, gravity, coriolis)
        """S without the damping F, on the host."""
        types = mesh.types(terms=Terms(waves=True), given=given, whole=False)
        self._value, self._together = types.value, mesh.shape == "element"
        self._nodes = mesh.mesh.nodes[mesh.part.element_numbers]
        """(e, np, np) number in the whole mesh of each element node."""
        self.dim = types.threads(mesh.groups)
        """Threads of a launch over the elements."""
        shape = mesh.groups, mesh.points
        per_area = mesh.on_elements(1.0 / mesh.mesh.area[self._nodes])
        arrays = {"per_area": per_area, **mesh.contributors}
        for name, size in (("flux_matrix", (*shape, 4)), ("per_diagonal", shape)):
            arrays[name] = wp.zeros(size, dtype=self._value, device=mesh.device)
        self._geometry = mesh.geometry(types.geometry, arrays)
        self._to_nodes = functools.cache(lambda g: mesh.over_nodes(helmholtz.to_nodes_kernel(g)))
        """Function of a number type that returns the function that copies fields to nodes."""
        self._to_field = functools.cache(
            lambda g: mesh.launch.compile(mesh.types(given=g, whole=False), helmholtz.to_field)[0]
        )
        """Function of a number type that returns the kernel that copies nodal vectors to fields."""
        self._f1, self._f2 = self.field(), self.field()
        self._local = mesh.local(1, self._value)
        self._slopes, rows = mesh.local(1, self._value, 2), mesh.rows // mesh.points
        self._east, self._north = (mesh.field(self._slopes.values[i : i + rows]) for i in (0, rows))
        fields = (wp.zeros(self.size, dtype=mesh.real, device=mesh.device) for _ in range(3))
        self._same, self._cross, self._nodal = fields
        self.damping = None if damping is None else Damping(mesh, damping, given)
        """Operator F of implicit diffusion; None without diffusion."""
        self._gradient, self._wind_fluxes, self._slope_fluxes, *others = mesh.launch.compile(
            types, helmholtz.gradient, helmholtz.wind_fluxes, helmholtz.slope_fluxes,
            helmholtz.eliminate, helmholtz.chebyshev_step, helmholtz.chebyshev_start,
            helmholtz.product,
        )  # fmt: skip
        self._eliminated, self._stepped, self._started, self._multiplied = others
        self._substituted = mesh.over_nodes(helmholtz.substitute_kernel(given))
        if not self._together:
            (self._divergence,) = mesh.launch.compile(types, helmholtz.divergence)

    def field(self) -> Field:
        return self.mesh.unshared(1, self._value)

    def to_field(self, x: wp.array, out: Field) -> None:
        """Copy a nodal vector (N,) of any number type to a field."""
        kernel = self._to_field(x.dtype)
        self.mesh.over_elements(None, kernel, self.dim, self.mesh.nodes, x, out.values)

    def to_nodes(self, x: Field, out: wp.array) -> None:
        """Copy a field, with the same bits in all elements of a node, to a nodal vector (N,)."""
        self._to_nodes(out.dtype)(self.mesh.first_copies, x.flat, out)

    def put(self, values: Array, x: Field) -> None:
        """Copy values (N,) from the host to a field."""
        self.to_field(self.mesh.scatter(values), x)

    def fetch(self, x: Field) -> Array:
        """Return a field as float64 values (N,) on the host."""
        self.to_nodes(x, self._nodal)
        return self.mesh.collect(self._nodal).astype(np.float64)

    def configure(self, tau: float, depth: Array) -> None:
        """Set the implicit step tau [s] and the depth (N,) [m]."""
        mesh, nodes, angle = self.mesh, self._nodes, tau * self.matrix.coriolis
        self.diagonal = self.matrix.diagonal(tau, depth)
        if self.damping is not None:
            self.damping.configure(tau)
        self.tau, same, cross = tau, 1.0 / (1.0 + angle**2), angle / (1.0 + angle**2)
        turn = np.stack([same, cross, -cross, same], axis=-1).reshape(-1, 2, 2)
        b = mesh.mesh.basis[mesh.part.element_numbers]
        adjugate = np.stack([b[..., 1, 1], -b[..., 1, 0], -b[..., 0, 1], b[..., 0, 0]], axis=-1)
        fluxes = adjugate.reshape(b.shape) @ (depth[:, None, None] * turn)[nodes]
        for target, values in (
            (self._same, mesh.scatter(same)),
            (self._cross, mesh.scatter(cross)),
            (self._geometry.flux_matrix, mesh.on_elements(fluxes, (4,))),
            (self._geometry.per_diagonal, mesh.on_elements(1.0 / self.diagonal[nodes])),
        ):
            wp.copy(target, values)

    def eliminate(self, r: wp.array, b: Field) -> None:
        """Set b = r_h - tau D H T r_V for r (3N,)."""
        if self.damping is not None:
            r = self.damping.damp_wind(r)
        self._diverge(self._wind_fluxes, r)
        local = self._local.values, self._local.flat
        self._over_elements(self._eliminated, *local, r, self.tau, b.values)

    def substitute(self, r: wp.array, h: Field, out: wp.array) -> None:
        """Set out (3N,) = (T (r_V - tau g G h), h); r must be that of the last `eliminate`."""
        if self.damping is not None:
            r = self.damping.state
        self._differentiate(h)
        self._substituted(
            self.mesh.places(1), self.mesh.first_copies, self.mesh.inverse_area, self._same,
            self._cross, self.size, self._east.flat, self._north.flat, h.flat, r,
            self.tau * self.gravity, out,
        )  # fmt: skip
        if self.damping is not None:
            self.damping.damp_depth(h, out)

    def apply(self, d: Field, out: Field) -> None:
        """Set out = S d."""
        inputs = d.values, 0.0, d.values, 1.0, out.values
        self._over_elements(self._multiplied, *self._waves(d), *inputs)

    def residual(self, b: Field, x: Field, out: Field) -> None:
        """Set out = b - S x."""
        inputs = x.values, 1.0, b.values, -1.0, out.values
        self._over_elements(self._multiplied, *self._waves(x), *inputs)

    def chebyshev_step(self, size: float, b: Field, x: Field) -> None:
        """Set x += size (b - S x)/diag S."""
        self._over_elements(self._stepped, *self._waves(x), size, b.values, x.values)

    def chebyshev_start(self, size: float, b: Field, x: Field) -> None:
        """Set x = size b/diag S: a step from x = 0, which needs no product with S."""
        self._over_elements(self._started, size, b.values, x.values)

    def _waves(self, d: Field) -> tuple[Any, ...]:
        """Return D H T G d before DSS, twice, and its factor in S d."""
        self._differentiate(d)
        east, north = self._east, self._north
        self._diverge(self._slope_fluxes, east.values, east.flat, north.values, north.flat)
        return self._local.values, self._local.flat, self.tau**2 * self.gravity

    def _differentiate(self, x: Field) -> None:
        if self.damping is not None:
            x = self.damping.damp_twice(x)  # not in _f1: later strips store fluxes there
        inputs = self._geometry, x.values, self._east.values, self._north.values
        self.mesh.over_elements(self._slopes, self._gradient, self.dim, *inputs)

    def _diverge(self, of_fluxes: Any, *arguments: Any) -> None:
        results = self._f1.values, self._f2.values, self._local.values
        arguments, last = (*arguments, *results), of_fluxes
        if not self._together:
            self._over_elements(of_fluxes, *arguments)
            arguments, last = results, self._divergence
        self.mesh.over_elements(self._local, last, self.dim, self._geometry, *arguments)

    def _over_elements(self, kernel: Any, *arguments: Any) -> None:
        self.mesh.over_elements(None, kernel, self.dim, self._geometry, *arguments)


class SchurMatrix:
    """S = I - tau^2 g D H T G as sparse matrices; gravity [m s-2], coriolis (N,) [s-1]."""

    def __init__(self, mesh: Mesh, gravity: float, coriolis: Array) -> None:
        self.mesh, self.gravity, self.coriolis = mesh, gravity, coriolis

    def weight(self, tau: float, depth: Array) -> Array:
        """Return H/(1 + tau^2 f^2) (N,) [m]: the symmetric part of H T."""
        return depth / (1.0 + (tau * self.coriolis) ** 2)

    def diagonal(self, tau: float, depth: Array) -> Array:
        """Return the diagonal of S (N,)."""
        squares = column_squares(self.mesh, self.mesh.area * self.weight(tau, depth))
        return 1.0 + tau**2 * self.gravity * squares / self.mesh.area

    def matrix(self, tau: float, depth: Array) -> scipy.sparse.csr_array:
        """Return S (N, N)."""
        angle = tau * self.coriolis
        same = scipy.sparse.diags_array(depth / (1.0 + angle**2))
        cross = scipy.sparse.diags_array(depth * angle / (1.0 + angle**2))
        turn = scipy.sparse.block_array([[same, cross], [-cross, same]], format="csr")
        product = sparse.divergence(self.mesh) @ (turn @ sparse.gradient(self.mesh))
        return (scipy.sparse.eye_array(self.mesh.size) - tau**2 * self.gravity * product).tocsr()

    def galerkin(
        self, mass: scipy.sparse.csr_array, gradients: scipy.sparse.csr_array, tau: float,
        depth: Array,
    ) -> scipy.sparse.csr_array:  # fmt: skip
        """Return B^T M S B for a basis B, with the symmetric part of S and the nodal areas M.

        Arguments: mass = B^T M B (V, V) [m2], gradients = G B (2N, V) [m-1], tau [s], depth (N,).
        """
        weight = (self.mesh.area * self.weight(tau, depth)).astype(gradients.dtype)
        stiffness = gradients.T @ (scipy.sparse.diags_array(np.tile(weight, 2)) @ gradients)
        return (mass + tau**2 * self.gravity * stiffness).tocsr()
