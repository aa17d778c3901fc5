"""Scene parameters: a value given as text, checked and made into what the factory asks for.

The keyword parameters of a factory are the parameters of its scene. Their annotations say what they
may be: what `swe_sphere.settings.convert` takes.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
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
