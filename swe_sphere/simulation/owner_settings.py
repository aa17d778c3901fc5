"""Settings "owner.parameter=value" for what is no effect: the scene and the stepper."""

from __future__ import annotations

from collections.abc import Iterable

from swe_sphere.errors import ConfigError

__all__ = ["SCENE", "STEPPER", "effect_settings", "settings_of"]

SCENE, STEPPER = "scene", "stepper"


def effect_settings(settings: Iterable[str]) -> list[str]:
    """The settings that are for effects."""
    return [text for text in settings if _owner(text) not in (SCENE, STEPPER)]


def settings_of(settings: Iterable[str], owner: str) -> dict[str, str]:
    """Values, as text, by the names of the owner's parameters.

    Raises:
        ConfigError: a setting of the owner that cannot be read.
    """
    values: dict[str, str] = {}
    for text in settings:
        if _owner(text) != owner:
            continue
        key, equals, value = text.partition("=")
        name = key.partition(".")[2].strip()
        if not (equals and name and value.strip()):
            raise ConfigError(f"a setting reads {owner}.parameter=value, not {text!r}")
        values[name] = value.strip()
    return values


def _owner(setting: str) -> str | None:
    owner, dot, _ = setting.partition("=")[0].strip().partition(".")
    return owner if dot else None
