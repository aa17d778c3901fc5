"""A scene from its factory: the function whose keyword parameters are those of the scene."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.testcases.parameters import SceneFactory, checked


def made(name: str, factory: SceneFactory, given: Mapping[str, Parameter]) -> Scene:
    """The scene that the factory makes; it knows its parameters, also those left at defaults.

    Raises:
        ConfigError: a parameter that the factory does not have, a value that cannot be read, or
            something else than a scene that it makes.
    """
    values = checked(name, factory, given)
    scene = factory(**values)
    if not isinstance(scene, Scene):
        raise ConfigError(f"scene() of {name} must return a Scene, not {type(scene).__name__}")
    known = inspect.signature(factory).parameters
    defaults = {key: p.default for key, p in known.items() if p.default is not p.empty}
    told = {key: _plain(value) for key, value in (defaults | values).items() if value is not None}
    return replace(scene, parameters=told | dict(scene.parameters))


def _plain(value: object) -> Parameter:
    return value if isinstance(value, (bool, int, float, str)) else str(value)
