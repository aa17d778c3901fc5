"""The scenes: one short function each, of data and formulas.

`get_scene` finds one by name, or in a file of the user that defines `scene(**parameters)`.
"""

from __future__ import annotations

import importlib.util
import inspect
import math
from collections.abc import Callable
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.model.effects import unknown_name
from swe_sphere.model.scene import Scene
from swe_sphere.testcases.galewsky import galewsky
from swe_sphere.testcases.lake import lake_at_rest
from swe_sphere.testcases.lauter import lauter
from swe_sphere.testcases.williamson import williamson1, williamson2, williamson5, williamson6

__all__ = ["SCENES", "get_scene"]

SceneFactory = Callable[..., Scene]

SCENES: dict[str, SceneFactory] = {
    "williamson1": williamson1,
    "williamson2": williamson2,
    "williamson5": williamson5,
    "williamson6": williamson6,
    "galewsky": galewsky,
    "lauter": lauter,
    "lake-at-rest": lake_at_rest,
}
"""Factories by name; their keyword parameters are the parameters of the scene."""

_SWITCH = {"true": True, "yes": True, "on": True, "1": True}
_SWITCH |= {"false": False, "no": False, "off": False, "0": False}


def get_scene(name: str, **parameters: float | bool | str) -> Scene:
    """The scene of that name, or of the Python file of that path, with the parameters given.

    Args:
        name: a key of `SCENES`, or the path of a .py file that defines `scene(**parameters)`.
        parameters: numbers and switches, or text that can be read as such.

    Raises:
        ConfigError: unknown name or parameter, a value that cannot be read, a file that fails.
    """
    if name.endswith(".py"):
        return _from_file(Path(name), parameters)
    if name not in SCENES:
        raise unknown_name("scene", name, SCENES)
    return SCENES[name](**_checked(name, SCENES[name], parameters))


def _checked(
    name: str, factory: SceneFactory, given: dict[str, float | bool | str]
) -> dict[str, float | bool | str]:
    """The parameters in the types that the factory's annotations ask for."""
    known = inspect.signature(factory, eval_str=True).parameters
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in known.values()):
        return given  # the file takes anything and must check it itself
    for key in given:
        if key not in known:
            has = ", ".join(known) or "no parameters"
            raise ConfigError(f"scene {name} has no parameter {key!r}; it has {has}")
    return {
        key: _switch(name, key, value)
        if known[key].annotation is bool
        else _number(name, key, value)
        for key, value in given.items()
    }


def _switch(name: str, key: str, value: float | bool | str) -> bool:
    try:
        return _SWITCH[str(value).strip().lower()]
    except KeyError:
        raise ConfigError(f"{name}: {key} must be true or false, not {value!r}") from None


def _number(name: str, key: str, value: float | bool | str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{name}: {key} must be a number, not {value!r}") from None
    if not math.isfinite(number):
        raise ConfigError(f"{name}: {key} must be finite, not {value}")
    return number


def _from_file(path: Path, parameters: dict[str, float | bool | str]) -> Scene:
    """The scene that a user's file makes."""
    if not path.is_file():
        raise ConfigError(f"there is no scene file {path}")
    spec = importlib.util.spec_from_file_location(f"swe_sphere_scene_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path} cannot be read as a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ConfigError(f"{path} fails: {type(error).__name__}: {error}") from error
    factory = getattr(module, "scene", None)
    if not callable(factory):
        raise ConfigError(f"{path} must define scene(**parameters) -> Scene")
    return _made_by(path, factory, parameters)


def _made_by(path: Path, factory: SceneFactory, parameters: dict[str, float | bool | str]) -> Scene:
    checked = _checked(str(path), factory, parameters)
    try:
        scene = factory(**checked)
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(f"scene() of {path} fails: {type(error).__name__}: {error}") from error
    if not isinstance(scene, Scene):
        raise ConfigError(f"scene() of {path} must return a Scene, not {type(scene).__name__}")
    return scene
