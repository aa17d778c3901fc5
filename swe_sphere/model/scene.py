"""A scene: the data and formulas of one test case, without any numerics."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.model.effects import EFFECTS, Effect
from swe_sphere.planet import EARTH, Planet

__all__ = [
    "Array",
    "Parameter",
    "Rates",
    "Scalar",
    "Scene",
    "State",
    "UnsteadyState",
    "UnsteadyTracers",
    "Wind",
]

Array = NDArray[np.float64]
Scalar = Callable[[Array, Array], Array]
"""(lon, lat) [rad] -> one value a point."""
State = Callable[[Array, Array], tuple[Array, Array, Array]]
"""(lon, lat) [rad] -> eastward wind, northward wind [m s-1], fluid depth [m]."""
UnsteadyState = Callable[[Array, Array, float], tuple[Array, Array, Array]]
"""(lon, lat, t) [rad, rad, s] -> eastward wind, northward wind [m s-1], fluid depth [m]."""
Rates = Callable[[Array, Array, float], tuple[Array, Array, Array]]
"""(lon, lat, t) [rad, rad, s] -> rates of change of the winds [m s-2] and of depth [m s-1]."""
UnsteadyTracers = Callable[[Array, Array, float], Mapping[str, Array]]
"""(lon, lat, t) [rad, rad, s] -> mixing ratios by name."""
Wind = Callable[[Array, Array, float], tuple[Array, Array]]
"""(lon, lat, t) [rad, rad, s] -> eastward wind, northward wind [m s-1]."""
Parameter = float | bool | str
"""Value of a scene parameter: a number (also a whole one), a switch, a word or a path."""

INCOMPATIBLE = (
    ("prescribed-wind", "momentum-advection", "a prescribed wind cannot also be stepped"),
    ("prescribed-wind", "drag", "a prescribed wind cannot be slowed down; leave out drag"),
    (
        "prescribed-wind",
        "linearised",
        "a prescribed wind acts linearly; leave out linearised",
    ),
    ("linearised", "tracers", "tracers need the whole dynamics; leave out linearised"),
)
"""Effects that cannot both act, and what to say then."""


@dataclass(frozen=True)
class Scene:
    """One test case: where it starts, what acts, and what is known of the answer.

    All functions take arrays of equal shape and return arrays of that shape. They must be finite
    everywhere; at a pole the wind is meant in the frame of the longitude given (the meshes here
    give 0), so east = (-sin lon, cos lon, 0) and north = (-sin lat cos lon, -sin lat sin lon,
    cos lat).

    Raises:
        ConfigError: the functions do not go with the effects, or a number is out of range.
    """

    name: str
    title: str
    reference: str
    """The paper, with its DOI."""
    effects: tuple[Effect, ...]
    initial: State
    report: str
    """What is worth reporting, in words."""
    ne: int
    """Recommended number of elements along the edge of a cube face."""
    np: int
    """Recommended number of nodes along the edge of an element."""
    dt: float | None
    """Recommended time step [s], stable for rk4 at this ne and np; None: chosen by the stepper."""
    days: float
    """Recommended length of the run [days]."""
    planet: Planet = EARTH
    exact: UnsteadyState | None = None
    bottom: Scalar | None = None
    """Height of the bottom [m]; there if and only if the scene has orography."""
    coriolis: Scalar | None = None
    """Coriolis parameter [s-1]; there if and only if the scene has rotation."""
    wind: Wind | None = None
    """The wind, if and only if it is prescribed."""
    steady_wind: bool = False
    """Whether the prescribed wind is the same at all times, so that it need be evaluated once."""
    forcing: Rates | None = None
    """Rates of change whatever the state is; there if and only if the scene has forcing."""
    steady_forcing: bool = False
    """Whether the forcing is the same at all times, so that it need be evaluated once."""
    base: State | None = None
    """The flow that the dynamics are linearised about, if and only if they are."""
    equilibrium: Scalar | None = None
    """Depth [m] that relaxation pulls to, if and only if there is relaxation."""
    tracers: Mapping[str, Scalar] | None = None
    """Initial mixing ratios by name, in any unit; there if and only if the scene has tracers."""
    exact_tracers: UnsteadyTracers | None = None
    """What is known of the tracers at later times; NaN at those where nothing is."""
    error_field: str = "h"
    """Errors of height are those of the fluid depth ("h") or of the free surface ("surface")."""
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    """The scene parameters (alpha, ...) this scene was made with."""

    def __post_init__(self) -> None:
        _check_effects(self)
        _check_tracers(self)
        _check_numbers(self)

    @property
    def autonomous(self) -> bool:
        """Whether the tendency depends on the state alone and not on time."""
        changing_wind = self.wind is not None and not self.steady_wind
        return not changing_wind and (self.forcing is None or self.steady_forcing)

    @property
    def linear(self) -> bool:
        """Whether the tendency is linear in the state, but for a constant."""
        return self.wind is not None or self.base is not None

    def effect(self, name: str) -> Effect | None:
        """The effect of that name, None where the scene does not have it."""
        return next((effect for effect in self.effects if effect.name == name), None)

    def with_effect(self, effect: Effect) -> Scene:
        """The scene with the effect added, or put in the place of the one of the same name.

        An effect that vanishes (a viscosity of zero) is left out instead.  Relaxation of a scene
        without equilibrium is to the initial depth.
        """
        kept = tuple(e for e in self.effects if e.name != effect.name)
        if effect.absent:
            unneeded: dict[str, Any] = {effect.needs: None} if effect.needs else {}
            return replace(self, effects=kept, **unneeded)
        if len(kept) < len(self.effects):
            swapped = tuple(effect if e.name == effect.name else e for e in self.effects)
            return replace(self, effects=swapped)
        needed: dict[str, Any] = {}
        if effect.needs == "equilibrium" and self.equilibrium is None:
            needed = {"equilibrium": partial(_initial_depth, self.initial)}
        return replace(self, effects=(*self.effects, effect), **needed)

    def without_effect(self, name: str) -> Scene:
        """The scene without the effect of that name and the function that it needs.

        What was exact with one of the scene's own effects is not exact without it.

        Raises:
            ConfigError: the scene does not have the effect.
        """
        effect = self.effect(name)
        if effect is None:
            has = ", ".join(each.name for each in self.effects)
            raise ConfigError(f"{self.name} has no effect {name!r}; it has {has}")
        changes: dict[str, Any] = {"effects": tuple(e for e in self.effects if e.name != name)}
        if effect.needs:
            changes |= {effect.needs: None}
        if not effect.dissipation:
            changes |= {"exact": None}
        return replace(self, **changes)


def _check_effects(scene: Scene) -> None:
    """An effect and the function it calls for come together or not at all."""
    names = [effect.name for effect in scene.effects]
    if len(set(names)) < len(names):
        raise ConfigError(f"{scene.name}: an effect is listed twice: {', '.join(names)}")
    for name, cls in EFFECTS.items():
        if cls.needs is None:
            continue
        given = getattr(scene, cls.needs) is not None
        if given and name not in names:
            raise ConfigError(f"{scene.name}: {cls.needs!r} is given without effect {name!r}")
        if name in names and not given:
            raise ConfigError(f"{scene.name}: effect {name!r} needs the function {cls.needs!r}")
    for first, second, trouble in INCOMPATIBLE:
        if first in names and second in names:
            raise ConfigError(f"{scene.name}: {trouble}")


def _initial_depth(initial: State, lon: Array, lat: Array) -> Array:
    return initial(lon, lat)[2]


def _check_tracers(scene: Scene) -> None:
    """Names of tracers become names of variables in files."""
    if scene.tracers is not None and not scene.tracers:
        raise ConfigError(f"{scene.name}: tracers are called for, but there is none")
    for name in scene.tracers or ():
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise ConfigError(
                f"{scene.name}: a tracer is named by letters, digits and _, not {name!r}"
            )
    if scene.exact_tracers is not None and scene.tracers is None:
        raise ConfigError(f"{scene.name}: 'exact_tracers' is given without tracers")


def _check_numbers(scene: Scene) -> None:
    if scene.error_field not in ("h", "surface"):
        raise ConfigError(f"{scene.name}: error_field is 'h' or 'surface'")
    if not (math.isfinite(scene.days) and scene.days > 0.0):
        raise ConfigError(f"{scene.name}: days must be finite and positive, not {scene.days}")
    if scene.dt is not None and not (math.isfinite(scene.dt) and scene.dt > 0.0):
        raise ConfigError(f"{scene.name}: dt must be finite and positive, not {scene.dt}")
