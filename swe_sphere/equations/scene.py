"""A scene: the data and formulas of one test case, without any numerics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene_checks import check_scene
from swe_sphere.equations.scene_functions import checked_functions
from swe_sphere.errors import ConfigError
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


@dataclass(frozen=True)
class Scene:
    """One test case: where it starts, what acts, and what is known of the answer.

    All functions take arrays of equal shape and return arrays of that shape, or numbers, which hold
    everywhere. They must be finite everywhere (NaN of the exact ones says that nothing is known);
    each checks what it returns whenever it is called, and raises ConfigError. At a pole the wind is
    meant in the frame of the longitude given (the meshes here give 0), so east = (-sin lon,
    cos lon, 0) and north = (-sin lat cos lon, -sin lat sin lon, cos lat).

    Raises:
        ConfigError: the functions do not go with the effects, a value is of the wrong type, or a
            number is out of range.
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
        check_scene(self)
        for name, function in checked_functions(self).items():
            object.__setattr__(self, name, function)

    @property
    def autonomous(self) -> bool:
        """Whether the tendency depends on the state alone and not on time."""
        changing_wind = self.wind is not None and not self.steady_wind
        return not changing_wind and (self.forcing is None or self.steady_forcing)

    @property
    def linear(self) -> bool:
        """Whether the tendency is linear in the state, but for a constant."""
        if self.base is not None:
            return True
        return self.wind is not None and all(effect.degree == 1 for effect in self.effects)

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

    def check_answers(self, lon: Array, lat: Array) -> None:
        """ConfigError now, and not when errors are first taken, if what is exact cannot be had."""
        for known in (self.exact, self.exact_tracers):
            if known is not None:
                known(lon, lat, 0.0)

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
        if name == "tracers":
            changes |= {"exact_tracers": None}
        elif not effect.dissipation:
            changes |= {"exact": None}
        return replace(self, **changes)


def _initial_depth(initial: State, lon: Array, lat: Array) -> Array:
    return initial(lon, lat)[2]
