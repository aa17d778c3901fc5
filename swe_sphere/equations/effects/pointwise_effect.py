"""Effects without derivatives in space: formulas at a point, of the package or of a scene's file.

Warp compiles the formulas for the number type of the run, into the kernel that makes the sum over
the elements; functions of Python's `math` and those of Warp may be called in them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, no_type_check

from swe_sphere.arrays import Array
from swe_sphere.equations.effects.effect import MASSES, Effect, check_coefficient
from swe_sphere.errors import ConfigError

if TYPE_CHECKING:
    from swe_sphere.mesh import Mesh

Formula = Callable[..., Any]


class Formulas(NamedTuple):
    """What an effect does to the wind and to the depth, None for nothing."""

    wind: Formula | None = None
    depth: Formula | None = None


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
        return Formulas(cls.wind_tendency, cls.depth_tendency)

    @property
    def derivatives(self) -> Formulas:
        """The derivatives of both."""
        cls = type(self)
        return Formulas(cls.wind_derivative, cls.depth_derivative)

    @property
    def differentiable(self) -> bool:
        """Whether each formula has its derivative."""
        pairs = zip(self.tendencies, self.derivatives, strict=True)
        return all(formula is None or derivative is not None for formula, derivative in pairs)

    def coefficients(self, mesh: Mesh) -> Mapping[str, float | Array]:
        """Numbers and fields (N,) that the formulas read: by default the parameters."""
        return {name: float(getattr(self, name)) for name in self.parameters()}


@dataclass(frozen=True)
class Drag(PointwiseEffect):
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
        check_coefficient(f"{self.name}.linear", self.linear)
        check_coefficient(f"{self.name}.quadratic", self.quadratic)

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
        return Formulas(wind=self._linear if self.quadratic == 0.0 else self._both)

    @property
    def derivatives(self) -> Formulas:
        """Of either."""
        linear, both = self._linear_derivative, self._derivative_of_both
        return Formulas(wind=linear if self.quadratic == 0.0 else both)

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
    depth back to what it was at the start.

    Raises:
        ConfigError: `time` is not positive.
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
        """To the equilibrium."""
        return c.rate * (c.equilibrium[i] - h)

    @staticmethod
    @no_type_check
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        """Without it."""
        return -c.rate * dh
