"""A scene: the data and formulas of one test case, and its effects as the user sets them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from typing import Any, get_type_hints

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import EFFECTS, Effect
from swe_sphere.equations.scene_checks import check_kinds, check_scene
from swe_sphere.equations.scene_fields import (
    Parameter,
    Rates,
    Scalar,
    SceneFields,
    State,
    UnsteadyState,
    UnsteadyTracers,
    Wind,
)  # fmt: skip
from swe_sphere.equations.scene_functions import checked_functions
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.planet import Planet
from swe_sphere.settings.values import SCENE, STEPPER, by_owner, convert, read_settings

__all__ = [
    "Array", "Parameter", "Rates", "Scalar", "Scene", "State", "UnsteadyState", "UnsteadyTracers",
    "Wind",
]  # fmt: skip


@dataclass(frozen=True)
class Scene(SceneFields):
    """One test case: where it starts, what acts, and what is known of the answer.

    All functions take arrays of equal shape and return arrays of that shape, or numbers, which hold
    everywhere. They must be finite everywhere (NaN of the exact ones says that nothing is known);
    each checks what it returns whenever it is called, and raises ConfigError. At a pole the wind is
    meant in the frame of the longitude given (the meshes here give 0), so east = (-sin lon,
    cos lon, 0) and north = (-sin lat cos lon, -sin lat sin lon, cos lat).

    Examples:
        >>> import numpy as np
        >>> from swe_sphere import Scene, Simulation
        >>> from swe_sphere.equations.effects import DYNAMICS
        >>> drop = Scene(
        ...     name="drop", effects=DYNAMICS,
        ...     initial=lambda lon, lat: (0.0, 0.0, 1000.0 + 10.0 * np.exp(-9.0 * lat**2)),
        ... )
        >>> abs(Simulation(drop, ne=3).run(days=0.25)["mass_drift"]) < 1e-14
        True

    Raises:
        ConfigError: the functions do not go with the effects, a value is of the wrong type, or a
            number is out of range.
    """

    def __post_init__(self) -> None:
        check_kinds(self)
        object.__setattr__(self, "title", self.title or self.name)
        rotates = any(effect.needs == "coriolis" for effect in self.effects)
        given = getattr(self.coriolis, "function", self.coriolis)
        if rotates and (given is None or getattr(given, "__func__", None) is Planet.coriolis):
            object.__setattr__(self, "coriolis", self.planet.coriolis)
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

        Raises ConfigError where `effect` is no effect.
        """
        if isinstance(effect, type) or not hasattr(effect, "absent"):
            return replace(self, effects=(*self.effects, effect))  # whose check states the mistake
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


def apply_settings(scene: Scene, settings: object) -> Scene:
    """Return the scene with the parameters of its effects from settings.

    settings: what `read_settings` reads; settings of the scene itself and of the stepper are
    skipped.  Raises ConfigError as `with_parameters` does.
    """
    owners = by_owner(read_settings(settings))
    return with_parameters(scene, {k: v for k, v in owners.items() if k not in (SCENE, STEPPER)})


def with_parameters(scene: Scene, effects: Mapping[str, Mapping[str, object]]) -> Scene:
    """The scene with these parameters of its effects; text is read as a value.

    Dissipation may be switched on (and, by zero, off) for any scene; the parameters of other
    effects can be changed only where the scene has the effect.

    Raises:
        ConfigError: a value that cannot be read, or a name of what is not there.
    """
    for name, values in effects.items():
        scene = scene.with_effect(_configured(scene, name, values))
    return scene


def _configured(scene: Scene, name: str, given: Mapping[str, object]) -> Effect:
    """The effect `name` of the scene, or a new one, with the parameters given."""
    present = scene.effect(name)
    if present is None and name not in EFFECTS:
        raise unknown_name("effect", name, {effect.name: 0 for effect in scene.effects} | EFFECTS)
    cls = EFFECTS[name] if present is None else type(present)
    if present is None and not cls.dissipation:
        has = ", ".join(effect.name for effect in scene.effects)
        raise ConfigError(f"{scene.name} has no effect {name!r}; it has {has}")
    values = {} if present is None else {key: getattr(present, key) for key in cls.parameters()}
    kinds = get_type_hints(cls)
    for key, value in given.items():
        if key not in cls.parameters():
            has = ", ".join(cls.parameters()) or "no parameters"
            raise ConfigError(f"effect {name!r} has no parameter {key!r}; it has {has}")
        values[key] = convert(f"{name}.{key}", kinds[key], value, finite=False)
    for field in fields(cls):
        if field.name not in values and field.default is MISSING:
            raise ConfigError(f"effect {name!r} needs {name}.{field.name}=…")
    return cls(**values)
