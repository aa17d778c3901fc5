"""The effects a scene may call for: a closed set of small frozen dataclasses.

An effect says *what* acts on the fluid and with which coefficients, never how it is computed.
To add one: write its class here and list it in `EFFECTS`; the kernels then branch on its name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from swe_sphere.errors import ConfigError
from swe_sphere.mesh import build_mesh
from swe_sphere.planet import EARTH

if TYPE_CHECKING:
    from swe_sphere.mesh import Mesh

__all__ = [
    "DYNAMICS",
    "EFFECTS",
    "MASSES",
    "Drag",
    "Effect",
    "Forcing",
    "Hyperviscosity",
    "Linearised",
    "MomentumAdvection",
    "Orography",
    "PrescribedWind",
    "PressureGradient",
    "Relaxation",
    "Rotation",
    "Tracers",
    "Viscosity",
    "hyperviscosity_default",
]


MASSES = frozenset({"mass", "tracers"})
"""The total mass of the fluid, and those of its tracers."""


@dataclass(frozen=True)
class Effect:
    """One thing that acts on the fluid; the fields of a subclass are its parameters."""

    name: ClassVar[str]
    """The name used on the command line and in files."""

    needs: ClassVar[str | None] = None
    """The function of the `Scene` that this effect, and only this effect, calls for."""

    conserves: ClassVar[frozenset[str]] = frozenset()
    """What the effect leaves as it is all over the globe, of `MASSES`: implicit steppers restore
    the masses that all effects of a scene conserve, and leave the others to their solver.  (What
    forcing brings is known: see `Model.mean_source`.)"""

    dissipation: ClassVar[bool] = False
    """Whether the effect damps: the user may switch it on for any scene, and leapfrog schemes take
    it at the past level."""

    @property
    def polynomial(self) -> bool:
        """Whether it is a polynomial of the state, of second degree at most: then the derivative is
        a difference of any size."""
        return True

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(field.name for field in fields(cls))

    @classmethod
    def convert(cls, parameter: str, text: str) -> float | None:
        """Value of one parameter from the text given by a user.

        Raises:
            ConfigError: the text is not a number.
        """
        try:
            return float(text)
        except ValueError:
            raise ConfigError(f"{cls.name}.{parameter} must be a number, not {text!r}") from None

    @property
    def absent(self) -> bool:
        """Whether the parameters make the effect vanish, so that it need not be computed."""
        return False


@dataclass(frozen=True)
class MomentumAdvection(Effect):
    """-ζ k×v - ∇|v|²/2: the wind carries itself (vector-invariant form)."""

    name = "momentum-advection"
    conserves = MASSES


@dataclass(frozen=True)
class PressureGradient(Effect):
    """-g ∇(h + b), with b = 0 unless the scene has orography."""

    name = "pressure-gradient"
    conserves = MASSES


@dataclass(frozen=True)
class Rotation(Effect):
    """-f k×v with the Coriolis parameter f [s-1] given by `Scene.coriolis`."""

    name = "rotation"
    conserves = MASSES
    needs = "coriolis"


@dataclass(frozen=True)
class Orography(Effect):
    """A bottom b [m], given by `Scene.bottom`, below the fluid of depth h."""

    name = "orography"
    conserves = MASSES
    needs = "bottom"


@dataclass(frozen=True)
class PrescribedWind(Effect):
    """The wind is given by `Scene.wind`; only the depth h is stepped."""

    name = "prescribed-wind"
    conserves = MASSES
    needs = "wind"


@dataclass(frozen=True)
class Forcing(Effect):
    """Given rates of change of wind [m s-2] and depth [m s-1], whatever the state is."""

    name = "forcing"
    conserves = MASSES
    needs = "forcing"


@dataclass(frozen=True)
class Tracers(Effect):
    """Passive tracers with the mixing ratios of `Scene.tracers`, carried by wind and depth.

    With `limiter` every step ends with mixing ratios within the bounds of the initial ones.
    """

    name = "tracers"
    conserves = MASSES
    needs = "tracers"
    limiter: bool = False

    @classmethod
    def convert(cls, parameter: str, text: str) -> bool:
        """The switch from the text given by a user.

        Raises:
            ConfigError: the text is neither true nor false.
        """
        if text.lower() not in ("true", "false"):
            raise ConfigError(f"{cls.name}.{parameter} must be true or false, not {text!r}")
        return text.lower() == "true"


@dataclass(frozen=True)
class Linearised(Effect):
    """Everything that acts but forcing is replaced by its derivative at the flow `Scene.base`.

    d state/dt = F'(base) (state - base) + forcing.  The state is still the whole flow, and the base
    is taken to be steady, whether F(base) is zero or not.
    """

    name = "linearised"
    conserves = MASSES
    needs = "base"


@dataclass(frozen=True)
class Viscosity(Effect):
    """ν ∇² with the coefficient `nu` [m2 s-1] on the prognostic fields.

    Raises:
        ConfigError: `nu` is negative or not finite.
    """

    name = "viscosity"
    conserves = MASSES
    dissipation = True
    nu: float

    def __post_init__(self) -> None:
        _check_coefficient(f"{self.name}.nu", self.nu)

    @property
    def absent(self) -> bool:
        """True where ν = 0."""
        return self.nu == 0.0


@dataclass(frozen=True)
class Hyperviscosity(Effect):
    """-ν ∇⁴ with the coefficient `nu` [m4 s-1]; None: `hyperviscosity_default` of the mesh.

    Raises:
        ConfigError: `nu` is negative or not finite.
    """

    name = "hyperviscosity"
    conserves = MASSES
    dissipation = True
    nu: float | None = None

    def __post_init__(self) -> None:
        if self.nu is not None:
            _check_coefficient(f"{self.name}.nu", self.nu)

    @classmethod
    def convert(cls, parameter: str, text: str) -> float | None:
        """As for every effect; the word "default" stands for the value that goes with the mesh."""
        if text.strip().lower() == "default":
            return None
        try:
            return float(text)
        except ValueError:
            message = f"{cls.name}.{parameter} must be a number or 'default', not {text!r}"
            raise ConfigError(message) from None

    @property
    def absent(self) -> bool:
        """True where ν = 0."""
        return self.nu == 0.0

    def coefficient(self, mesh: Mesh) -> float:
        """The coefficient [m4 s-1] on a mesh."""
        if self.nu is not None:
            return self.nu
        return hyperviscosity_default(mesh.ne, mesh.np, mesh.radius, _refinement(mesh))


@dataclass(frozen=True)
class Drag(Effect):
    """-(linear + quadratic |v|) v on the wind, with `linear` [s-1] and `quadratic` [m-1].

    Raises:
        ConfigError: a coefficient is negative or not finite.
    """

    name = "drag"
    conserves = MASSES
    dissipation = True
    linear: float = 0.0
    quadratic: float = 0.0

    def __post_init__(self) -> None:
        _check_coefficient(f"{self.name}.linear", self.linear)
        _check_coefficient(f"{self.name}.quadratic", self.quadratic)

    @property
    def polynomial(self) -> bool:
        """Not with the modulus of the wind in it."""
        return self.quadratic == 0.0

    @property
    def absent(self) -> bool:
        """True where both coefficients are 0."""
        return self.linear == 0.0 and self.quadratic == 0.0


@dataclass(frozen=True)
class Relaxation(Effect):
    """-(h - h_eq) / time on the depth, `time` in [s], with h_eq [m] from `Scene.equilibrium`.

    Newtonian cooling in a shallow layer.  Switched on for a scene that has no equilibrium, it pulls
    depth back to what it was at the start.

    Raises:
        ConfigError: `time` is not positive.
    """

    name = "relaxation"
    conserves = frozenset({"tracers"})
    needs = "equilibrium"
    dissipation = True
    time: float

    def __post_init__(self) -> None:
        if not self.time > 0.0:
            raise ConfigError(f"{self.name}.time must be positive, not {self.time}")

    @property
    def absent(self) -> bool:
        """True where the time is infinite."""
        return math.isinf(self.time)


DYNAMICS: tuple[Effect, ...] = (MomentumAdvection(), PressureGradient())
"""The effects of every scene that steps the wind."""

EFFECTS: dict[str, type[Effect]] = {
    cls.name: cls
    for cls in (
        MomentumAdvection,
        PressureGradient,
        Rotation,
        Orography,
        PrescribedWind,
        Forcing,
        Tracers,
        Linearised,
        Viscosity,
        Hyperviscosity,
        Drag,
        Relaxation,
    )
}
"""All effects by name."""


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
    plain = build_mesh(mesh.ne, mesh.np, mesh.radius)
    return plain.spacing()[0] / mesh.spacing()[0]


def _check_coefficient(label: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise ConfigError(f"{label} must be finite and not negative, not {value}")
