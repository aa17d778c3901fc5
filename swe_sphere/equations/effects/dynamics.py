"""Effects that make or change the dynamics of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from swe_sphere.equations.effects.effect import MASSES, Effect


@dataclass(frozen=True)
class MomentumAdvection(Effect):
    """-ζ k×v - ∇|v|²/2: the wind carries itself (vector-invariant form)."""

    name = "momentum-advection"
    conserves = MASSES
    terms = frozenset({"advection"})
    degree = 2


@dataclass(frozen=True)
class PressureGradient(Effect):
    """-g ∇(h + b), with b = 0 unless the scene has orography; the flow carries the depth."""

    name = "pressure-gradient"
    conserves = MASSES
    terms = frozenset({"pressure"})
    degree = 2


@dataclass(frozen=True)
class Rotation(Effect):
    """-f k×v with the Coriolis parameter f [s-1] given by `Scene.coriolis`."""

    name = "rotation"
    conserves = MASSES
    terms = frozenset({"rotation"})
    needs = "coriolis"


@dataclass(frozen=True)
class Orography(Effect):
    """A bottom b [m], given by `Scene.bottom`, below the fluid of depth h."""

    name = "orography"
    conserves = MASSES
    everywhere = frozenset({"bottom"})
    needs = "bottom"


@dataclass(frozen=True)
class PrescribedWind(Effect):
    """The wind is given by `Scene.wind`; only the depth h is stepped."""

    name = "prescribed-wind"
    conserves = MASSES
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
    conserves = MASSES
    terms = frozenset({"forcing"})
    constant = True
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


@dataclass(frozen=True)
class Linearised(Effect):
    """Everything that acts but forcing is replaced by its derivative at the flow `Scene.base`.

    d state/dt = F'(base) (state - base) + forcing.  The state is still the whole flow, and the base
    is taken to be steady, whether F(base) is zero or not.
    """

    name = "linearised"
    conserves = MASSES
    everywhere = frozenset({"tangent"})
    needs = "base"
    excludes: ClassVar[Mapping[str, str]] = {
        "tracers": "tracers need the whole dynamics; leave out linearised"
    }
