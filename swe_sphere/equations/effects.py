"""The effects a scene may call for: small frozen dataclasses.

An effect says *what* acts on the fluid and with which coefficients.  Those with derivatives name
the terms of the kernels that they switch on; those without (`PointwiseEffect`) bring their formulas
along, and a scene may define such of its own.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self, no_type_check

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH

Formula = Callable[..., Any]
Formulas = tuple[Formula | None, Formula | None]
"""Rates of change of the wind and of the depth by an effect; None stands for zero."""

MASSES = frozenset({"mass", "tracers"})
"""The total mass of the fluid, and those of its tracers."""


@dataclass(frozen=True)
class Effect:
    """Base of all effects; the fields of a subclass are its parameters."""

    name: ClassVar[str]
    """The name used on the command line and in files."""

    needs: ClassVar[str | None] = None
    """The function of the `Scene` that this effect, and only this effect, calls for."""

    terms: ClassVar[frozenset[str]] = frozenset()
    """Flags of `swe_sphere.kernels.Terms` (with derivatives) and `Pointwise` that it switches on:
    in the dissipation if it damps, else in the rest."""

    everywhere: ClassVar[frozenset[str]] = frozenset()
    """Flags that hold in all components of the right-hand side, as they say what the fields are."""

    constant: ClassVar[bool] = False
    """True if the rate of change is the same for all states, so that its derivative is zero."""

    excludes: ClassVar[Mapping[str, str]] = {}
    """Names of effects that cannot act beside this one, and what to say then."""

    conserves: ClassVar[frozenset[str]] = MASSES
    """The `MASSES` that the effect conserves: implicit steppers restore the masses that all effects
    of a scene conserve, and leave the others to their solver.  (The mass that forcing adds is
    known: see `Model.mean_source`.)"""

    dissipation: ClassVar[bool] = False
    """True if the effect damps: the user may switch it on for any scene, and leapfrog schemes
    evaluate it at the past level."""

    strengths: ClassVar[tuple[str, ...]] = ()
    """Parameters that must be finite and not negative; where one is zero, the effect vanishes."""

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
        for name in self.strengths:
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                label = f"{self.name}.{name}"
                raise ConfigError(f"{label} must be finite and not negative, not {value}")

    @property
    def diffuses(self) -> bool:
        """True for a weak Laplacian, which explicit steppers apply separately."""
        return bool(self.terms & {"diffusion", "biharmonic"})

    @property
    def degree(self) -> int | None:
        """Degree of the rate of change as a polynomial of the state and its derivatives in space;
        None if it is no polynomial."""
        return 1

    @property
    def differentiable(self) -> bool:
        """True if the kernels have the derivative of the effect along any change of the state."""
        return True

    @property
    def absent(self) -> bool:
        """True if the parameters make the effect vanish, so that it need not be computed."""
        return any(getattr(self, name) == 0.0 for name in self.strengths)

    def coefficients(self, mesh: Mesh) -> Mapping[str, float | Array]:
        """The numbers, and for point-wise effects fields (N,), that its terms read, by name."""
        return {}

    def damping(self, mesh: Mesh, squares: Array) -> Array | float:
        """Rate [s-1] at which it damps waves of the squared wavenumbers k^2 [m-2], if it does.

        What preconditioners of implicit steps know of it.
        """
        return 0.0

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(field.name for field in fields(cls))


@dataclass(frozen=True)
class MomentumAdvection(Effect):
    """-ζ k×v - ∇|v|²/2: the wind carries itself (vector-invariant form)."""

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
    everywhere = frozenset({"wind"})
    needs = "wind"
    excludes: ClassVar[Mapping[str, str]] = {
        "momentum-advection": "a prescribed wind cannot also be stepped",
        "drag": "a prescribed wind cannot be slowed down; leave out drag",
        "linearised": "a prescribed wind acts linearly; leave out linearised",
    }


@dataclass(frozen=True)
class Forcing(Effect):
    """Prescribed rates of change of wind [m s-2] and depth [m s-1], whatever the state is."""

    name = "forcing"
    terms = frozenset({"forcing"})
    constant = True
    needs = "forcing"


@dataclass(frozen=True)
class Tracers(Effect):
    """Passive tracers with the mixing ratios of `Scene.tracers`, carried by wind and depth.

    With `limiter` every step ends with mixing ratios within the bounds of the initial ones.
    """

    name = "tracers"
    needs = "tracers"
    limiter: bool = False


@dataclass(frozen=True)
class Linearised(Effect):
    """Everything that acts but forcing is replaced by its derivative at the flow `Scene.base`.

    d state/dt = F'(base) (state - base) + forcing.  The state is still the whole flow, and the base
    is taken to be steady, whether F(base) is zero or not.
    """

    name = "linearised"
    everywhere = frozenset({"tangent"})
    needs = "base"
    excludes: ClassVar[Mapping[str, str]] = {
        "tracers": "tracers need the whole dynamics; leave out linearised"
    }


@dataclass(frozen=True)
class Viscosity(Effect):
    """ν ∇² with the coefficient `nu` [m2 s-1] on the prognostic fields.

    Raises ConfigError where `nu` is negative or not finite.
    """

    name = "viscosity"
    dissipation = True
    terms = frozenset({"diffusion"})
    strengths = ("nu",)
    nu: float

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """ν [m2 s-1]."""
        return {"nu": self.nu}

    def damping(self, mesh: Mesh, squares: Array) -> Array:
        """ν k²."""
        return self.nu * squares


@dataclass(frozen=True)
class Hyperviscosity(Effect):
    """-ν ∇⁴ with one coefficient for the whole mesh.

    Args:
        nu: Coefficient [m4 s-1]; None: `factor` times `hyperviscosity_default` of the mesh. Users
            say "default" for None.
        factor: Multiple of the default coefficient; 30 is the rule of CAM-SE.

    Raises ConfigError where `nu` or `factor` is negative or not finite.
    """

    name = "hyperviscosity"
    dissipation = True
    terms = frozenset({"biharmonic"})
    strengths = ("nu", "factor")
    nu: float | None = None
    factor: float = 1.0

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """ν [m4 s-1], by default that of the mesh."""
        if self.nu is not None:
            return {"nu4": self.nu}
        refinement = 1.0
        if mesh.stretch != 1.0:
            plain = Mesh.build(mesh.ne, mesh.np, mesh.radius)
            refinement = plain.spacing()[0] / mesh.spacing()[0]
        default = hyperviscosity_default(mesh.ne, mesh.np, mesh.radius, refinement)
        return {"nu4": self.factor * default}

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
        c: Strength; None: `penalty_default` of the mesh, which removes the computational modes that
            grow in flows across the edges of the cube's faces. Users say "default" for it.
        speed: Wind speed [m s-1]; by default the largest of the initial wind, or of the base.

    Raises ConfigError where `c` or `speed` is negative or not finite.
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
        gamma: Array = c * speed * np.sqrt(areas)
        return gamma


def penalty_default(np: int) -> float:
    """Strength of the edge penalty that goes with np nodes along the edge of an element.

    Its largest rate is then 4 to 6 % of that of gravity waves at every np.
    """
    return 0.16 / np**2


def hyperviscosity_default(
    ne: int, np: int, radius: float = EARTH.radius, refinement: float = 1.0
) -> float:
    """Hyperviscosity [m4 s-1] that goes with a mesh: ten times less for half the node spacing.

    One thirtieth of the rule of CAM-SE (ESCOMP/CAM, global_norms_mod, after Boville 1991 and
    Takahashi et al. 2006), 1e15 (a / 6.37122e6 m) (30 / ne)^(1 / log10 2) at np = 4.
    Other np are compared at equal mean node spacing, which goes as 1 / (ne (np - 1)), and a
    stretched mesh has the one coefficient that goes with its finest part.

    Args:
        ne: elements along the edge of a cube face.
        np: nodes along the edge of an element.
        radius: of the planet [m].
        refinement: how many times finer than without stretching the finest part of the mesh is.
    """
    spacing = (30.0 * 3.0) / (ne * (np - 1) * refinement)
    return float(1.0e15 / 30.0 * (radius / EARTH.radius) * spacing ** (1.0 / math.log10(2.0)))


@dataclass(frozen=True)
class PointwiseEffect(Effect):
    """An effect whose tendency at a node depends on the wind and depth there; derive from it.

    The formulas are static methods of `(c, i, u, v, h)`, with the coefficients c, the number i of
    the node, the winds u, v [m s-1] and the depth h [m].  Those of the wind return two rates
    [m s-2], those of the depth one [m s-1].  A coefficient that is a number reads c.name, one that
    is a field (N,) c.name[i]; a bare constant is a float32 to Warp, so make it a coefficient.

    The derivatives are static methods of `(c, i, u, v, h, du, dv, dh)`, linear in the last three.
    Where one is not given, all products with the Jacobian are differences of right-hand sides.

    `conserves` says whether the total mass stays: `MASSES` if it does, and with the default it is
    left to the effect.  `dissipation` says whether leapfrog schemes have to take it at the past
    level.
    """

    conserves = frozenset({"tracers"})
    wind_tendency: ClassVar[Formula | None] = None
    depth_tendency: ClassVar[Formula | None] = None
    wind_derivative: ClassVar[Formula | None] = None
    depth_derivative: ClassVar[Formula | None] = None

    @property
    def degree(self) -> int | None:
        """None: it may be any function of the state."""
        return None

    @property
    def tendencies(self) -> Formulas:
        """The rates of change."""
        cls = type(self)
        return cls.wind_tendency, cls.depth_tendency

    @property
    def derivatives(self) -> Formulas:
        """The derivatives of both."""
        cls = type(self)
        return cls.wind_derivative, cls.depth_derivative

    @property
    def differentiable(self) -> bool:
        """True if each formula has its derivative."""
        pairs = zip(self.tendencies, self.derivatives, strict=True)
        return all(formula is None or derivative is not None for formula, derivative in pairs)

    def coefficients(self, mesh: Mesh) -> Mapping[str, float | Array]:
        """Numbers and fields (N,) that the formulas read: by default the parameters."""
        return {name: float(getattr(self, name)) for name in self.parameters()}


@dataclass(frozen=True)
class Drag(PointwiseEffect):
    """-(linear + quadratic |v|) v on the wind, with `linear` [s-1] and `quadratic` [m-1].

    Raises ConfigError where a coefficient is negative or not finite.
    """

    name = "drag"
    conserves = MASSES
    dissipation = True
    strengths = ("linear", "quadratic")
    linear: float = 0.0
    quadratic: float = 0.0

    @property
    def absent(self) -> bool:
        """True where both coefficients are 0."""
        return self.linear == 0.0 and self.quadratic == 0.0

    @property
    def degree(self) -> int | None:
        """One, but for the modulus of the wind."""
        return 1 if self.quadratic == 0.0 else None

    @property
    def tendencies(self) -> Formulas:
        """Linear drag alone, where it is, knows no modulus."""
        return self._linear if self.quadratic == 0.0 else self._both, None

    @property
    def derivatives(self) -> Formulas:
        """Derivatives of the drag of the wind; the depth has none."""
        linear, both = self._linear_derivative, self._derivative_of_both
        return linear if self.quadratic == 0.0 else both, None

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """Both, and a wind that is none."""
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

    Newtonian cooling in a shallow layer.  Switched on for a scene that has no equilibrium, it pulls
    depth back to what it was at the start.  Raises ConfigError where `time` is not positive.
    """

    name = "relaxation"
    needs = "equilibrium"
    dissipation = True
    degree = 1
    time: float

    def __post_init__(self) -> None:
        if not self.time > 0.0:
            raise ConfigError(f"{self.name}.time must be positive, not {self.time}")

    @property
    def absent(self) -> bool:
        """True where the time is infinite."""
        return math.isinf(self.time)

    def coefficients(self, mesh: Mesh) -> dict[str, float]:
        """One over the time [s-1]; the equilibrium is a function of the scene."""
        return {"rate": 1.0 / self.time}

    @staticmethod
    @no_type_check
    def depth_tendency(c, i, u, v, h):
        """Return the rate at which the depth approaches its equilibrium."""
        return c.rate * (c.equilibrium[i] - h)

    @staticmethod
    @no_type_check
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        """Without it."""
        return -c.rate * dh


DYNAMICS: tuple[Effect, ...] = (MomentumAdvection(), PressureGradient())
"""The effects of every scene that steps the wind."""

EFFECTS: dict[str, type[Effect]] = {
    each.name: each
    for each in [*vars().values()]
    if isinstance(each, type) and issubclass(each, Effect) and hasattr(each, "name")
}
"""All effects of the package by name."""
