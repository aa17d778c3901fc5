"""The effects that a scene may declare: small frozen dataclasses.

An effect defines *what* acts on the fluid and with which coefficients. Most effects name the terms
of the kernels that they enable. A `PointwiseEffect` contains formulas at a node, without
derivatives in space; a scene may define custom effects of this type.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, ClassVar, Self, no_type_check

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH

Formula = Callable[..., Any]
Formulas = tuple[Formula | None, Formula | None]
"""Formulas of the rates of the wind and of the depth by an effect; None stands for zero."""

MASSES = frozenset({"mass", "tracers"})
"""Names of conserved masses: the total mass of the fluid, and the masses of its tracers."""


def as_float(value: object) -> float:
    """Return a real number as a float, infinite if it is too large, and NaN for anything else."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


@dataclass(frozen=True)
class Effect:
    """Base of all effects; the fields of a subclass are its parameters."""

    name: ClassVar[str]
    """The name used on the command line and in files."""

    needs: ClassVar[str | None] = None
    """Function of the `Scene` that this effect requires; other effects may require it too."""

    terms: ClassVar[frozenset[str]] = frozenset()
    """Flags of `swe_sphere.kernels.Terms` (with derivatives) or `Pointwise`, or "edge-penalty",
    with its own operator; in the dissipative component if the effect damps, else conservative."""

    everywhere: ClassVar[frozenset[str]] = frozenset()
    """Flags set in all components, because they determine which arrays the kernels read."""

    constant: ClassVar[bool] = False
    """True if the rate of change is the same for all states, so that its derivative is zero."""

    excludes: ClassVar[Mapping[str, str]] = {}
    """Names of effects that cannot be combined with this one, each with an error message."""

    conserves: ClassVar[frozenset[str]] = MASSES
    """The `MASSES` that the effect conserves. Implicit steppers restore the masses that all effects
    of a scene conserve, apart from the mass that forcing adds (`Model.mean_source`); other masses
    are as accurate as the solver."""

    degree: ClassVar[int | None] = 1
    """Degree of the rate in the state and its derivatives; 1 if constant, None if no polynomial."""

    differentiable: ClassVar[bool] = True
    """True if the kernels contain the derivative of the effect with respect to the state."""

    dissipation: ClassVar[bool] = False
    """True if the effect damps: any scene may add it; leapfrog evaluates it at the past level."""

    strengths: ClassVar[tuple[str, ...]] = ()
    """Parameters that must be finite and >= 0; by default the effect is `absent` if one is zero."""

    def __new__(cls, *_: object, **__: object) -> Self:
        """Raise ConfigError for a class without a name, or with parameters but no `@dataclass`."""
        own = [str(kind) for kind in vars(cls).get("__annotations__", {}).values()]
        parameters = [kind for kind in own if "ClassVar" not in kind]
        if parameters and "__dataclass_fields__" not in vars(cls):
            raise ConfigError(f"the effect {cls.__name__} needs @dataclass(frozen=True) above it")
        if not isinstance(getattr(cls, "name", None), str):
            raise ConfigError(f"give the effect {cls.__name__} a name: name = ...")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for each in fields(self):
            if isinstance(value := getattr(self, each.name, None), np.generic):
                object.__setattr__(self, each.name, value.item())
        for name in self.strengths:
            value = getattr(self, name)
            if value is None and getattr(type(self), name, None) is None:
                continue
            if not 0.0 <= (number := as_float(value)) < math.inf:
                label = f"{self.name}.{name}"
                raise ConfigError(f"{label} must be finite and not negative, got {value}")
            object.__setattr__(self, name, number)

    @property
    def diffuses(self) -> bool:
        """True for a weak Laplacian, which explicit steppers apply separately."""
        return bool(self.terms & {"diffusion", "biharmonic"})

    @property
    def absent(self) -> bool:
        """True if the parameters make the effect vanish, so that it need not be computed."""
        return any(getattr(self, name) == 0.0 for name in self.strengths)

    def coefficients(self, mesh: Mesh) -> Mapping[str, float | Array]:
        """Return the numbers, and for pointwise effects fields (N,), that its terms read."""
        return {}

    def damping(self, mesh: Mesh, squares: Array) -> Array | float:
        """Return the rate [s-1] at which the effect damps waves; squares: k^2 [m-2] of each wave.

        Only the preconditioners `helmholtz` and `helmholtz-direct` use this rate.
        """
        return 0.0

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(field.name for field in fields(cls))


@dataclass(frozen=True)
class MomentumAdvection(Effect):
    """-ζ k×v - ∇|v|²/2: the wind carries itself (vector-invariant form) and the depth."""

    name = "momentum-advection"
    terms = frozenset({"advection"})
    degree = 2


@dataclass(frozen=True)
class PressureGradient(Effect):
    """-g ∇(h + b), with b = 0 unless the scene has orography; the flow carries the depth."""

    name = "pressure-gradient"
    terms = frozenset({"pressure"})
    degree = 2


@dataclass(frozen=True)
class Rotation(Effect):
    """-f k×v with the Coriolis parameter f [s-1] given by `Scene.coriolis`."""

    name = "rotation"
    terms = frozenset({"rotation"})
    needs = "coriolis"


@dataclass(frozen=True)
class Orography(Effect):
    """A bottom b [m], given by `Scene.bottom`, below the fluid of depth h."""

    name = "orography"
    everywhere = frozenset({"bottom"})
    needs = "bottom"


@dataclass(frozen=True)
class PrescribedWind(Effect):
    """The wind is given by `Scene.wind`; only the depth h is stepped."""

    name = "prescribed-wind"
    everywhere = frozenset({"passive"})
    needs = "wind"
    excludes: ClassVar[Mapping[str, str]] = {
        "momentum-advection": "a prescribed wind cannot also be stepped",
        "drag": "a prescribed wind cannot be slowed down; leave out drag",
        "linearised": "a prescribed wind acts linearly; leave out linearised",
        "pressure-gradient": "a prescribed wind is not accelerated; leave out pressure-gradient",
    }


@dataclass(frozen=True)
class Forcing(Effect):
    """Prescribed rates of change of wind [m s-2] and depth [m s-1], independent of the state."""

    name = "forcing"
    terms = frozenset({"forcing"})
    constant = True
    needs = "forcing"


@dataclass(frozen=True)
class Tracers(Effect):
    """Passive tracers with the mixing ratios of `Scene.tracers`, carried by wind and depth.

    With `limiter` each step ends by limiting mixing ratios to the range of their initial values.
    """

    name = "tracers"
    needs = "tracers"
    limiter: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.limiter, bool):
            raise ConfigError(f"{self.name}.limiter must be True or False, got {self.limiter!r}")


@dataclass(frozen=True)
class LinearisedDynamics(Effect):
    """The derivative of all effects but forcing at the flow `Scene.base` replaces the effects.

    d state/dt = F'(base) (state - base) + forcing. The state remains the whole flow, and the base
    is treated as steady even if F(base) is not zero.
    """

    name = "linearised"
    everywhere = frozenset({"tangent"})
    needs = "base"
    excludes: ClassVar[Mapping[str, str]] = {
        "tracers": "tracers need the whole dynamics; leave out linearised"
    }


@dataclass(frozen=True)
class Viscosity(Effect):
    """ν ∇² with `nu` [m2 s-1] on the wind, the surface height h + b, and q (h + b) of tracers.

    Raises ConfigError if `nu` is negative or not finite.
    """

    name = "viscosity"
    dissipation = True
    terms = frozenset({"diffusion"})
    strengths = ("nu",)
    nu: float

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """Return ν [m2 s-1]."""
        return {"nu": self.nu}

    def damping(self, mesh: Mesh, squares: Array) -> Array:
        """Return ν k²."""
        return self.nu * squares


@dataclass(frozen=True)
class Hyperviscosity(Effect):
    """-ν ∇⁴ on the fields of `Viscosity`, with one coefficient for the whole mesh.

    Args:
        nu: coefficient [m4 s-1]; None, on the command line "default": `factor` times
            `hyperviscosity_default` of the mesh.
        factor: multiple of the default coefficient; 30 is the rule of CAM-SE.

    Raises ConfigError if `nu` or `factor` is negative or not finite.
    """

    name = "hyperviscosity"
    dissipation = True
    terms = frozenset({"biharmonic"})
    strengths = ("nu", "factor")
    nu: float | None = None
    factor: float = 1.0

    @property
    def absent(self) -> bool:
        """True if the coefficient is 0."""
        return (self.factor if self.nu is None else self.nu) == 0.0

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """Return ν [m4 s-1], by default that of the mesh."""
        if self.nu is not None:
            return {"nu4": self.nu}
        refinement = 1.0
        if mesh.stretch != 1.0:
            refinement = Mesh.build(mesh.ne, mesh.np, mesh.radius).spacing()[0] / mesh.spacing()[0]
        default = hyperviscosity_default(mesh.ne, mesh.np, mesh.radius, refinement)
        return {"nu4": self.factor * default}

    def damping(self, mesh: Mesh, squares: Array) -> Array:
        """Return ν k⁴."""
        return self.coefficients(mesh)["nu4"] * squares**2


@dataclass(frozen=True)
class EdgePenalty(Effect):
    """Penalty on the jumps of vorticity and divergence at the edges of elements.

    The penalty damps winds whose vorticity or divergence is discontinuous there. Its coefficient is
    gamma = `c` `speed` dx [m2 s-1], with dx [m] the square root of the area of an element. The
    order of accuracy of smooth winds is kept; mass and depth are not changed.

    Args:
        c: strength; None, on the command line "default": `penalty_default` of the mesh, which
            removes the computational modes that grow in flows across the edges of cube faces.
        speed: wind speed [m s-1]; by default the largest of the initial wind, or of the base.

    Raises ConfigError if `c` or `speed` is negative or not finite.
    """

    name = "edge-penalty"
    dissipation = True
    terms = frozenset({"edge-penalty"})
    excludes: ClassVar[Mapping[str, str]] = {
        "prescribed-wind": "a prescribed wind has no jumps to damp; leave out edge-penalty"
    }
    strengths = ("c", "speed")
    c: float | None = None
    speed: float | None = None

    def strength(self, mesh: Mesh, speed: float) -> Array:
        """Return gamma (E,) [m2 s-1] of each element for a wind speed [m s-1]."""
        areas = np.einsum("ij,eij->e", mesh.quadrature, mesh.jacobian)
        c = penalty_default(mesh.np) if self.c is None else self.c
        return np.asarray(c * speed * np.sqrt(areas))


def penalty_default(np: int) -> float:
    """Return the default strength of the edge penalty for np nodes along the edge of an element.

    In winds of a quarter of the wave speed, its largest rate is 4 to 6 % of that of gravity waves.
    """
    return 0.16 / np**2


def hyperviscosity_default(
    ne: int, np: int, radius: float = EARTH.radius, refinement: float = 1.0
) -> float:
    """Return the default hyperviscosity [m4 s-1]; on one planet half the spacing needs a tenth.

    On the Earth this is one thirtieth of the rule of CAM-SE (ESCOMP/CAM, global_norms_mod, after
    Boville 1991 and Takahashi et al. 2006), 1e15 (30 / ne)^(1 / log10 2) at np = 4. Other np are
    compared at equal mean node spacing, which is proportional to 1 / (ne (np - 1)). The cube of the
    radius makes flows of equal Rossby and Froude numbers similar. On a stretched mesh the
    coefficient is that of the finest spacing, everywhere.

    Args:
        ne: number of elements along the edge of a cube face.
        np: number of nodes along the edge of an element.
        radius: radius of the planet [m].
        refinement: finest node spacing without stretching over that with stretching.
    """
    spacing = (30.0 * 3.0) / (ne * (np - 1) * refinement)
    return float(1.0e15 / 30.0 * (radius / EARTH.radius) ** 3 * spacing ** (1.0 / math.log10(2.0)))


@dataclass(frozen=True)
class PointwiseEffect(Effect):
    """Base of effects whose tendency at a node depends only on the wind and depth there.

    The formulas are static methods of `(c, i, u, v, h)`, with the coefficients c, the number i of
    the node, the winds u, v [m s-1] and the depth h [m]. A formula of the wind returns two rates [m
    s-2], a formula of the depth one [m s-1]. It reads a number as c.name and a field (N,) as
    c.name[i]. Warp treats a bare constant as a float32: make constants coefficients instead.

    The derivatives are static methods of `(c, i, u, v, h, du, dv, dh)`, linear in the last three.
    If one is missing, all products with the Jacobian are differences of right-hand sides.

    `conserves` states whether the total mass is conserved: `MASSES` if it is; with the default the
    effect may change it. `dissipation` states whether leapfrog evaluates it at the past level.
    """

    conserves = frozenset({"tracers"})
    degree: ClassVar[int | None] = None  # the rate may be any function of the state
    wind_tendency: ClassVar[Formula | None] = None
    depth_tendency: ClassVar[Formula | None] = None
    wind_derivative: ClassVar[Formula | None] = None
    depth_derivative: ClassVar[Formula | None] = None

    @property
    def tendencies(self) -> Formulas:
        """The formulas of the rates of wind and depth."""
        return type(self).wind_tendency, type(self).depth_tendency

    @property
    def derivatives(self) -> Formulas:
        """The formulas of the derivatives of both rates."""
        return type(self).wind_derivative, type(self).depth_derivative

    @property
    def differentiable(self) -> bool:  # type: ignore[override]
        """True if each formula has its derivative."""
        pairs = zip(self.tendencies, self.derivatives, strict=True)
        return all(formula is None or derivative is not None for formula, derivative in pairs)

    def coefficients(self, mesh: Mesh) -> Mapping[str, float | Array]:
        """Return the numbers and fields (N,) that the formulas read: by default the parameters."""
        return {name: float(getattr(self, name)) for name in self.parameters()}


@dataclass(frozen=True)
class Drag(PointwiseEffect):
    """-(linear + quadratic |v|) v on the wind, with `linear` [s-1] and `quadratic` [m-1].

    Raises ConfigError if a coefficient is negative or not finite.
    """

    name = "drag"
    conserves = MASSES
    dissipation = True
    strengths = ("linear", "quadratic")
    linear: float = 0.0
    quadratic: float = 0.0

    @property
    def absent(self) -> bool:
        """True if both coefficients are 0."""
        return self.linear == 0.0 and self.quadratic == 0.0

    @property
    def degree(self) -> int | None:  # type: ignore[override]
        """1 for linear drag; None with quadratic drag, which contains the modulus of the wind."""
        return 1 if self.quadratic == 0.0 else None

    @property
    def tendencies(self) -> Formulas:
        """The formula of the rate of the wind; for linear drag it does not compute the modulus."""
        return self._linear if self.quadratic == 0.0 else self._both, None

    @property
    def derivatives(self) -> Formulas:
        """The formula of the derivative of the drag; the depth has none."""
        linear, both = self._linear_derivative, self._derivative_of_both
        return linear if self.quadratic == 0.0 else both, None

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """Return both coefficients, and a wind speed [m s-1] that counts as still air."""
        return {"linear": self.linear, "quadratic": self.quadratic, "still": 1e-30}

    @staticmethod
    @no_type_check
    def _linear(c, i, u, v, h):
        return -c.linear * u, -c.linear * v

    @staticmethod
    @no_type_check
    def _linear_derivative(c, i, u, v, h, du, dv, dh):
        return -c.linear * du, -c.linear * dv

    @staticmethod
    @no_type_check
    def _both(c, i, u, v, h):
        rate = c.linear + c.quadratic * math.sqrt(u * u + v * v)
        return -rate * u, -rate * v

    @staticmethod
    @no_type_check
    def _derivative_of_both(c, i, u, v, h, du, dv, dh):
        speed = math.sqrt(u * u + v * v)
        rate = c.linear + c.quadratic * speed
        # still air has no direction, and no derivative either
        along = c.quadratic * (u * du + v * dv) / max(speed, c.still)
        return -rate * du - along * u, -rate * dv - along * v


@dataclass(frozen=True)
class Relaxation(PointwiseEffect):
    """-(h - h_eq) / time on the depth, `time` in [s], with h_eq [m] from `Scene.equilibrium`.

    This is Newtonian cooling in a shallow layer. If `Scene.with_effect` or a setting adds it to a
    scene without an equilibrium, h_eq is the depth of `Scene.initial`; a scene that lists it itself
    must define `equilibrium`. Raises ConfigError if `time` is not positive.
    """

    name = "relaxation"
    needs = "equilibrium"
    dissipation = True
    degree = 1
    time: float

    def __post_init__(self) -> None:
        if not as_float(self.time) > 0.0:
            raise ConfigError(f"{self.name}.time must be positive, got {self.time}")
        object.__setattr__(self, "time", as_float(self.time))

    @property
    def absent(self) -> bool:
        """True if the time is infinite."""
        return math.isinf(self.time)

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """Return one over the time [s-1]; the equilibrium is a function of the scene."""
        return {"rate": 1.0 / self.time}

    @staticmethod
    @no_type_check
    def depth_tendency(c, i, u, v, h):
        """Return the rate at which the depth approaches its equilibrium."""
        return c.rate * (c.equilibrium[i] - h)

    @staticmethod
    @no_type_check
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        """Return the derivative of this rate, which does not depend on the equilibrium."""
        return -c.rate * dh


DYNAMICS: tuple[Effect, ...] = (MomentumAdvection(), PressureGradient())
"""The nonlinear dynamics without rotation and bottom; a scene may have fewer effects."""

EFFECTS: dict[str, type[Effect]] = {
    each.name: each
    for each in [*vars().values()]
    if isinstance(each, type) and issubclass(each, Effect) and hasattr(each, "name")
}
"""All effects of the package by name."""
