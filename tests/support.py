"""What several tests share: scenes made of any set of effects, and random continuous states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp

from swe_sphere.equations.effects import (
    Drag,
    Forcing,
    Hyperviscosity,
    LinearisedDynamics,
    MomentumAdvection,
    Orography,
    PointwiseEffect,
    PrescribedWind,
    PressureGradient,
    Relaxation,
    Rotation,
    Viscosity,
)
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene
from swe_sphere.io.runfile import Nodal
from swe_sphere.mesh import Mesh
from swe_sphere.operators.sparse import ElementSpace
from swe_sphere.steppers import STEPPERS, Stepper

EXPLICIT, IMEX, EXPONENTIAL, IMPLICIT = (
    tuple(name for name, cls in STEPPERS.items() if cls.family == family)
    for family in ("explicit", "imex", "exponential", "implicit")
)

EFFECTS = {
    "advection": MomentumAdvection(),
    "pressure": PressureGradient(),
    "rotation": Rotation(),
    "orography": Orography(),
    "wind": PrescribedWind(),
    "forcing": Forcing(),
    "drag": Drag(linear=2e-5),
    "quadratic-drag": Drag(linear=1e-5, quadratic=3e-6),
    "linearised": LinearisedDynamics(),
    "relaxation": Relaxation(time=3e4),
    "viscosity": Viscosity(1e6),
    "hyperviscosity": Hyperviscosity(1e18),
}


QUICK = (
    "semi-implicit", "bdf2", "tr-bdf2", "gauss-legendre", "average-vector-field", "epi2",
)  # fmt: skip
"""One of each class of implementation; the thorough tests take all others too."""


@dataclass(frozen=True)
class Leak(PointwiseEffect):
    """A loss of depth at a rate [s-1]."""

    name = "leak"
    rate: float = 1e-6

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return -c.rate * h


def thorough(*values):
    """A case for the thorough tests only."""
    return pytest.param(*values, marks=pytest.mark.thorough)


def some(names):
    """Names as cases: those that are not in `QUICK` for the thorough tests."""
    return [name if name in QUICK else thorough(name) for name in names]


def make_scene(*names: str) -> Scene:
    """A scene with just these effects over rough fields without any symmetry."""
    effects = tuple(EFFECTS[name] for name in names)
    return Scene(
        name="+".join(names) or "nothing",
        title="a test",
        reference="none",
        effects=effects,
        initial=lambda lon, lat: (np.cos(lat), 0.0 * lat, 1000.0 + 0.0 * lat),
        bottom=(lambda lon, lat: 300.0 * np.cos(3.0 * lon + lat)) if "orography" in names else None,
        coriolis=(lambda lon, lat: 1e-4 * np.sin(2.0 * lat + lon)) if "rotation" in names else None,
        wind=_wind if "wind" in names else None,
        base=_base if "linearised" in names else None,
        equilibrium=_equilibrium if "relaxation" in names else None,
        forcing=_forcing if "forcing" in names else None,
        ne=2,
        np=4,
        days=1.0,
    )


def _wind(lon, lat, t):
    return 20.0 * np.cos(lat + t) + 5.0 * np.sin(2.0 * lon), 10.0 * np.cos(lon - t)


def _base(lon, lat):
    u, v = 20.0 * np.cos(lat) ** 2, 5.0 * np.cos(lat) * np.sin(3.0 * lon)
    return u, v, 1200.0 + 100.0 * np.sin(lat) * np.cos(lon)


def _equilibrium(lon, lat):
    return 1100.0 + 200.0 * np.cos(lat) * np.sin(2.0 * lon)


def _forcing(lon, lat, t):
    slow = 1e-3 * t
    u, v = 1e-3 * np.cos(lat + slow) * np.sin(lon), 2e-3 * np.cos(2.0 * lon - slow) * np.cos(lat)
    return u, v, 3e-2 * np.cos(lat) * np.sin(lon + slow) + 1e-2


SMOOTH = {
    "xyz": (3, lambda x, y, z: (x * y * z, y * z, x * z, x * y)),
    "tall": (
        5,
        lambda x, y, z: (_four(x, y) * z, _four_x(x, y) * z, _four_x(y, x) * z, _four(x, y)),
    ),
}
"""Spherical harmonics as polynomials: degree, and (value, three partial derivatives)."""


def _four(x, y):
    return x**4 - 6.0 * x**2 * y**2 + y**4


def _four_x(x, y):
    return 4.0 * x**3 - 12.0 * x * y**2


def harmonic(mesh: Mesh, name: str) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Degree l, spherical harmonic Y (N,), and its gradient (2, N) [m-1] and k x gradient."""
    degree, formula = SMOOTH[name]
    value, *partial = formula(*mesh.xyz.T)
    slope = np.stack(partial, axis=1) / mesh.radius
    gradient = np.stack([np.sum(slope * unit, axis=1) for unit in (mesh.east, mesh.north)])
    return degree, value, gradient, np.stack([-gradient[1], gradient[0]])


def random_state(model: Model, seed: int = 1) -> np.ndarray:
    """Rough winds and depths, continuous by construction: one value a unique node."""
    rng = np.random.default_rng(seed)
    n = model.mesh.size
    parts = {"u": 20.0 * rng.standard_normal(n), "v": 20.0 * rng.standard_normal(n)}
    parts["h"] = 1000.0 + 100.0 * rng.standard_normal(n)
    return np.concatenate([parts[name] for name in model.names])


def tendency(model: Model, state: np.ndarray, t: float = 0.0) -> np.ndarray:
    """The model's right-hand side for a numpy state, as float64."""
    out = model.zeros()
    model.tendency(model.device_mesh.upload(state), t, out)
    return out.numpy().astype(np.float64)


def tangent(model: Model, state: np.ndarray, direction: np.ndarray, t: float = 0.0) -> np.ndarray:
    """The model's Jacobian at a state times a direction, as float64."""
    out = model.zeros()
    jacobian = model.jacobian().update(model.device_mesh.upload(state), t)
    jacobian(model.device_mesh.upload(direction), out)
    return out.numpy().astype(np.float64)


def advance(name: str, model: Model, state, dt: float, duration: float, **options) -> Stepper:
    """A stepper that began from a state, after `duration` [s]."""
    stepper = STEPPERS[name](model, dt, **options)
    stepper.start(state)
    for _ in range(round(duration / dt)):
        stepper.step()
    return stepper


def relative(ours: np.ndarray, theirs: np.ndarray, blocks: int = 1) -> float:
    """Largest difference in any block (u, v or h), over the largest value in that block."""
    pairs = zip(np.split(ours, blocks), np.split(theirs, blocks), strict=True)
    return max(float(np.abs(a - b).max() / (np.abs(b).max() or 1.0)) for a, b in pairs)


class Frame(Nodal):
    """State at the nodes of a mesh at a time [s]: fields (N,), including the bottom b."""

    def __init__(self, mesh: Mesh, fields: dict, time: float, attributes: dict) -> None:
        self.mesh, self.fields, self.attributes, self.about = mesh, fields, attributes, {}
        self.bottom, self.times = fields["b"], np.array([time])

    def frame(self, time: float | None = None) -> dict:
        return self.fields


def nodal_values(mesh: Mesh, space: ElementSpace) -> sp.csr_array:
    """Nodal values (N, V) of the functions of a space, the same from all elements of a node."""
    total = space.matrix(mesh.nodes.reshape(mesh.elements, -1), space.values).tocsr()
    total.data *= np.repeat(1.0 / np.diff(mesh.gather_offsets), np.diff(total.indptr))
    return total
