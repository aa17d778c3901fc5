"""Effects as the user sets them: "effect.parameter=value"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields

from swe_sphere.equations.effects import EFFECTS, Effect
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, unknown_name

__all__ = ["apply_settings"]


def apply_settings(scene: Scene, settings: Sequence[str]) -> Scene:
    """The scene with the effect parameters changed as "effect.parameter=value" strings say.

    Dissipation may be switched on (and, by zero, off) for any scene; the parameters of other
    effects can be changed only where the scene has the effect.

    Raises:
        ConfigError: a setting that cannot be read, or names what is not there.
    """
    grouped: dict[str, dict[str, str]] = {}
    for setting in settings:
        effect, parameter, value = _split(setting)
        grouped.setdefault(effect, {})[parameter] = value
    for effect, values in grouped.items():
        scene = scene.with_effect(_configured(scene, effect, values))
    return scene


def _split(setting: str) -> tuple[str, str, str]:
    key, equals, value = setting.partition("=")
    effect, dot, parameter = key.strip().partition(".")
    if not (equals and dot and effect and parameter and value.strip()):
        raise ConfigError(f"a setting reads effect.parameter=value, not {setting!r}")
    return effect, parameter, value.strip()


def _configured(scene: Scene, name: str, texts: Mapping[str, str]) -> Effect:
    """The effect `name` of the scene, or a new one, with the parameters given as text."""
    if name not in EFFECTS:
        raise unknown_name("effect", name, EFFECTS)
    cls, present = EFFECTS[name], scene.effect(name)
    if present is None and not cls.dissipation:
        has = ", ".join(effect.name for effect in scene.effects)
        raise ConfigError(f"{scene.name} has no effect {name!r}; it has {has}")
    for parameter in texts:
        if parameter not in cls.parameters():
            has = ", ".join(cls.parameters()) or "no parameters"
            raise ConfigError(f"effect {name!r} has no parameter {parameter!r}; it has {has}")
    values = {} if present is None else {key: getattr(present, key) for key in cls.parameters()}
    values |= {key: cls.convert(key, text) for key, text in texts.items()}
    _check_complete(cls, values)
    return cls(**values)


def _check_complete(cls: type[Effect], values: Mapping[str, object]) -> None:
    for field in fields(cls):
        if field.name not in values and field.default is MISSING:
            raise ConfigError(f"effect {cls.name!r} needs {cls.name}.{field.name}=…")
