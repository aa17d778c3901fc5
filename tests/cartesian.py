"""An independent formulation of the right-hand side, to check the kernels against.

Winds are three-dimensional vectors, gradients and curls come from cross products of tangents,
weak Laplacians from assembled sparse matrices, and DSS from the transpose of the gather matrix.
No covariant components, no adjugates, no loops: only the equations and the mesh are common ground.
Works for complex states, so that derivatives can be had by complex steps.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from swe_sphere.equations.scene import Scene
from swe_sphere.mesh import Mesh


class Cartesian:
    """Right-hand side of a scene; states are (u, v, h) stacked, or h alone, as in the model."""

    def __init__(self, mesh: Mesh, scene: Scene) -> None:
        self.mesh, self.scene = mesh, scene
        self.effects = {effect.name: effect for effect in scene.effects}
        frame = np.stack([mesh.east, mesh.north])  # (2, N, 3)
        self.frame, self.normal = frame, np.cross(mesh.east, mesh.north)
        self._differentiate()
        self._tangents()

    def _differentiate(self) -> None:
        """Gather to element nodes and derivatives along both coordinates, as matrices."""
        mesh = self.mesh
        self.nodes = mesh.nodes.ravel()
        count, eye = self.nodes.size, sp.identity(mesh.np)
        self.gather = sp.csr_matrix((np.ones(count), (np.arange(count), self.nodes)))
        elements = sp.identity(mesh.elements)
        self.d1 = sp.kron(elements, sp.kron(mesh.derivative, eye)).tocsr()
        self.d2 = sp.kron(elements, sp.kron(eye, mesh.derivative)).tocsr()

    def _tangents(self) -> None:
        """Tangent vectors along the coordinates, the same turned by a right angle, and masses."""
        mesh = self.mesh
        pairs = mesh.basis.reshape(-1, 2, 2)
        self.t1, self.t2 = np.einsum("pik,kpx->ipx", pairs, self.frame[:, self.nodes])
        self.up = self.normal[self.nodes]
        self.jacobian = np.einsum("px,px->p", np.cross(self.t1, self.t2), self.up)
        weights = np.outer(mesh.gll_weights, mesh.gll_weights).ravel()
        self.mass = np.tile(weights, mesh.elements) * self.jacobian
        self.nodal_mass = self.gather.T @ self.mass
        self.n1, self.n2 = np.cross(self.t2, self.up), np.cross(self.up, self.t1)
        self._matrices = {}

    # --- operators: nodal or local arrays in, local arrays out; dss makes them nodal

    def dss(self, local):
        """Mass-weighted mean of the local values (P, ...) at each node."""
        flat = local.reshape(len(self.mass), -1)
        mean = (self.gather.T @ (self.mass[:, None] * flat)) / self.nodal_mass[:, None]
        return mean.reshape(-1, *local.shape[1:])

    def gradient(self, s):
        """Surface gradient (P, 3) of a local scalar, which is d1 s n1 + d2 s n2 over J."""
        return (self._times(self.n1, self.d1 @ s) + self._times(self.n2, self.d2 @ s)) / self._j

    def divergence(self, f):
        """Divergence (P,) of a local vector (P, 3)."""
        return (self.d1 @ self._dot(self.n1, f) + self.d2 @ self._dot(self.n2, f)) / self.jacobian

    def vorticity(self, v):
        """Normal part of the curl (P,) of a local vector (P, 3)."""
        return (self.d1 @ self._dot(self.t2, v) - self.d2 @ self._dot(self.t1, v)) / self.jacobian

    def laplacian(self, wind, s):
        """Weak Hodge Laplacian of a nodal wind (N, 3), weak Laplacian of a nodal scalar (N,)."""
        g = [self._matrix(n, "gradient")[0] for n in range(3)]
        scalar = -sum(a.T @ (self.mass * (a @ s)) for a in g) / self.nodal_mass
        if wind is None:
            return None, scalar
        forms = 0.0
        for kind in ("divergence", "vorticity"):
            a = self._matrix(None, kind)
            form = sum(part @ wind[:, x] for x, part in enumerate(a))
            forms = forms - np.stack([part.T @ (self.mass * form) for part in a], axis=1)
        return self._tangent(forms / self.nodal_mass[:, None]), scalar

    def _matrix(self, component, kind):
        """Sparse matrices from nodal values to local ones, one a Cartesian component."""
        if (component, kind) not in self._matrices:
            self._matrices[component, kind] = self._made(component, kind)
        return self._matrices[component, kind]

    def _made(self, component, kind):
        left, right = {"vorticity": (self.t2, -self.t1)}.get(kind, (self.n1, self.n2))
        if kind == "gradient":
            parts = (left[:, component] / self.jacobian, right[:, component] / self.jacobian)
            return [(sp.diags(parts[0]) @ self.d1 + sp.diags(parts[1]) @ self.d2) @ self.gather]
        inverse = sp.diags(1.0 / self.jacobian)
        pairs = [(sp.diags(left[:, x]), sp.diags(right[:, x])) for x in range(3)]
        return [inverse @ (self.d1 @ a + self.d2 @ b) @ self.gather for a, b in pairs]

    # --- the equations

    def tendency(self, state, t=0.0):
        """d state / dt, stacked as the state."""
        if self.scene.base is not None:
            rate = self._linearised(state)
        elif self.scene.wind is None:
            rate = self._dynamics(state)
        else:
            rate = self._transport(state, t)
        return rate + self._forcing(t) if "forcing" in self.effects else rate

    def _linearised(self, state):
        """The derivative at the base along the rest of the state: complex steps, part by part."""
        base = np.concatenate(self.scene.base(self.mesh.lon, self.mesh.lat))
        parts = ((state - base).real, (state - base).imag)
        real, imaginary = (self._dynamics(base + 1e-30j * d).imag / 1e-30 for d in parts)
        return real + 1j * imaginary if np.iscomplexobj(state) else real

    def _forcing(self, t):
        rates = self.scene.forcing(self.mesh.lon, self.mesh.lat, t)
        return rates[2] if self.scene.wind is not None else np.concatenate(rates)

    def _dynamics(self, state):
        u, v, h = state.reshape(3, -1)
        wind = self._times(self.frame[0], u) + self._times(self.frame[1], v)
        local, depth, g = wind[self.nodes], h[self.nodes], self.scene.planet.gravity
        slope = np.zeros_like(local)
        if "momentum-advection" in self.effects:
            spin = self._times(np.cross(self.up, local), self.vorticity(local))
            slope = slope - spin - self.gradient(0.5 * self._dot(local, local))
        if "pressure-gradient" in self.effects:
            slope = slope - self.gradient(g * self._surface(h)[self.nodes])
        rate = self._tangent(self.dss(slope))
        height = 0.0 * h
        if {"momentum-advection", "pressure-gradient"} & self.effects.keys():
            height = -self.dss(self.divergence(self._times(local, depth)))
        if self.scene.coriolis is not None:
            f = self.scene.coriolis(self.mesh.lon, self.mesh.lat)
            rate = rate - self._times(np.cross(self.normal, wind), f)
        damp, smooth = self._dissipation(wind, self._surface(h))
        rate, height = rate + damp + self._drag(wind), height + smooth + self._relaxation(h)
        return np.concatenate(
            [self._dot(self.frame[0], rate), self._dot(self.frame[1], rate), height]
        )

    def _transport(self, h, t):
        u, v = self.scene.wind(self.mesh.lon, self.mesh.lat, t)
        wind = self._times(self.frame[0], u) + self._times(self.frame[1], v)
        rate = -self.dss(self.divergence(self._times(wind, h)[self.nodes]))
        return rate + self._dissipation(None, self._surface(h))[1] + self._relaxation(h)

    def _drag(self, wind):
        drag = self.effects.get("drag")
        if drag is None:
            return 0.0
        return -self._times(wind, drag.linear + drag.quadratic * np.sqrt(self._dot(wind, wind)))

    def _relaxation(self, h):
        if "relaxation" not in self.effects:
            return 0.0
        goal = self.scene.equilibrium(self.mesh.lon, self.mesh.lat)
        return (goal - h) / self.effects["relaxation"].time

    def _surface(self, h):
        return (
            h if self.scene.bottom is None else h + self.scene.bottom(self.mesh.lon, self.mesh.lat)
        )

    def _dissipation(self, wind, s):
        once = twice = (0.0, 0.0)
        nu = getattr(self.effects.get("viscosity"), "nu", 0.0)
        strong = self.effects.get("hyperviscosity")
        if nu or strong:
            once = self.laplacian(wind, s)
        total = [nu * (0.0 if part is None else part) for part in once]
        if strong:
            twice = self.laplacian(*once)
            nu4 = strong.coefficients(self.mesh)["nu4"]
            total = [a - nu4 * (0.0 if b is None else b) for a, b in zip(total, twice, strict=True)]
        return total

    # --- small algebra

    @property
    def _j(self):
        return self.jacobian[:, None]

    def _tangent(self, vectors):
        return vectors - self._times(self.normal, self._dot(self.normal, vectors))

    @staticmethod
    def _dot(a, b):
        return np.sum(a * b, axis=-1)

    @staticmethod
    def _times(vectors, factor):
        return vectors * np.asarray(factor)[:, None]
