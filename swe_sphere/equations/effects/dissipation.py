"""Effects that damp the smallest scales: weak Laplacians and the edge penalty."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.equations.effects.effect import MASSES, Effect, check_coefficient
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH


@dataclass(frozen=True)
class Viscosity(Effect):
    """ν ∇² with the coefficient `nu` [m2 s-1] on the prognostic fields.

    Raises:
        ConfigError: `nu` is negative or not finite.
    """

    name = "viscosity"
    conserves = MASSES
    dissipation = True
    terms = frozenset({"diffusion"})
    nu: float

    def __post_init__(self) -> None:
        check_coefficient(f"{self.name}.nu", self.nu)

    @property
    def absent(self) -> bool:
        """True where ν = 0."""
        return self.nu == 0.0

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """ν [m2 s-1]."""
        return {"nu": self.nu}

    def damping(self, mesh: Mesh, squares: Array) -> Array:
        """ν k²."""
        return self.nu * squares


@dataclass(frozen=True)
class Hyperviscosity(Effect):
    """-ν ∇⁴ with the coefficient `nu` [m4 s-1]; None: `hyperviscosity_default` of the mesh;
    users say "default" for it.

    Raises:
        ConfigError: `nu` is negative or not finite.
    """

    name = "hyperviscosity"
    conserves = MASSES
    dissipation = True
    terms = frozenset({"biharmonic"})
    nu: float | None = None

    def __post_init__(self) -> None:
        if self.nu is not None:
            check_coefficient(f"{self.name}.nu", self.nu)

    @property
    def absent(self) -> bool:
        """True where ν = 0."""
        return self.nu == 0.0

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """ν [m4 s-1], by default that of the mesh."""
        if self.nu is not None:
            return {"nu4": self.nu}
        return {"nu4": hyperviscosity_default(mesh.ne, mesh.np, mesh.radius, _refinement(mesh))}

    def damping(self, mesh: Mesh, squares: Array) -> Array:
        """ν k⁴."""
        return self.coefficients(mesh)["nu4"] * squares**2


@dataclass(frozen=True)
class EdgePenalty(Effect):
    """Penalty on the jumps of vorticity and divergence at the edges of elements.

    It damps winds whose vorticity or divergence is discontinuous there, at the rate
    gamma = `c` `speed` dx [m2 s-1] times squared jumps, with dx [m] the root of the area of an
    element. Smooth winds keep their order of accuracy; mass and depth are not changed.

    Args:
        c: Strength; 0.01 removes the computational modes that grow in flows across the edges of
            the cube's faces.
        speed: Wind speed [m s-1]; by default the largest of the initial wind, or of the base.

    Raises:
        ConfigError: `c` or `speed` is negative or not finite.
    """

    name = "edge-penalty"
    conserves = MASSES
    dissipation = True
    terms = frozenset({"edge-penalty"})
    excludes: ClassVar[Mapping[str, str]] = {
        "prescribed-wind": "a prescribed wind has no jumps to damp; leave out edge-penalty"
    }
    c: float = 0.01
    speed: float | None = None

    def __post_init__(self) -> None:
        check_coefficient(f"{self.name}.c", self.c)
        if self.speed is not None:
            check_coefficient(f"{self.name}.speed", self.speed)

    @property
    def absent(self) -> bool:
        """True where the strength is zero."""
        return self.c == 0.0 or self.speed == 0.0

    def strength(self, mesh: Mesh, speed: float) -> Array:
        """Return gamma (E,) [m2 s-1] of each element for a wind speed [m s-1]."""
        areas = np.einsum("ij,eij->e", mesh.quadrature, mesh.jacobian)
        gamma: Array = self.c * speed * np.sqrt(areas)
        return gamma


def hyperviscosity_default(
    ne: int, np: int, radius: float = EARTH.radius, refinement: float = 1.0
) -> float:
    """Hyperviscosity [m4 s-1] that goes with a mesh: ten times less for half the node spacing.

    The rule of CAM-SE (ESCOMP/CAM, global_norms_mod, after Boville 1991 and Takahashi et al.
    2006): 1e15 (a / 6.37122e6 m) (30 / ne)^(1 / log10 2) at np = 4.
    Other np are compared at equal mean node spacing, which goes as 1 / (ne (np - 1)), and a
    stretched mesh has the one coefficient that goes with its finest part.

    Args:
        ne: elements along the edge of a cube face.
        np: nodes along the edge of an element.
        radius: of the planet [m].
        refinement: how many times finer than without stretching the finest part of the mesh is.
    """
    spacing = (30.0 * 3.0) / (ne * (np - 1) * refinement)
    return float(1.0e15 * (radius / EARTH.radius) * spacing ** (1.0 / math.log10(2.0)))


def _refinement(mesh: Mesh) -> float:
    """Smallest node spacing of the mesh without stretching, over that of the mesh; at least 1."""
    if mesh.stretch == 1.0:
        return 1.0
    plain = Mesh.build(mesh.ne, mesh.np, mesh.radius)
    return plain.spacing()[0] / mesh.spacing()[0]
