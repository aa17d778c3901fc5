"""Scene parameters: a value given as text, checked and made into what the factory asks for.

The keyword parameters of a factory are the parameters of its scene. Their annotations say what they
may be: what `swe_sphere.settings.convert` takes.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.settings import convert

SceneFactory = Callable[..., Scene]


def checked(name: str, factory: SceneFactory, given: Mapping[str, Parameter]) -> dict[str, Any]:
    """The parameters in the types that the factory's annotations ask for.

    Raises:
        ConfigError: a parameter that the factory does not have, or a value that cannot be read.
    """
    known = inspect.signature(factory, eval_str=True).parameters
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in known.values()):
        return dict(given)  # the file takes anything and must check it itself
    for key in given:
        if key not in known:
            has = ", ".join(known) or "no parameters"
            raise ConfigError(f"scene {name} has no parameter {key!r}; it has {has}")
    return {
        key: convert(f"{name}: {key}", _kind(known[key]), value) for key, value in given.items()
    }


def _kind(parameter: inspect.Parameter) -> Any:
    """Its annotation; numbers where there is none."""
    return float if parameter.annotation is parameter.empty else parameter.annotation


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
    return replace(scene, parameters=dict(scene.parameters) | told)


def _plain(value: object) -> Parameter:
    return value if isinstance(value, (bool, int, float, str)) else str(value)
