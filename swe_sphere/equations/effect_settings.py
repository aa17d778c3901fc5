"""Parameters of effects as the user sets them."""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from typing import get_type_hints

from swe_sphere.equations.effects import EFFECTS, Effect
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.settings import SCENE, STEPPER, by_owner, convert


def apply_settings(scene: Scene, settings: Iterable[str]) -> Scene:
    """The scene with the parameters of its effects as settings "effect.parameter=value" say.

    Settings of the scene itself and of the stepper are for others.  Raises ConfigError as
    `with_parameters` does.
    """
    owners = by_owner(settings)
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
