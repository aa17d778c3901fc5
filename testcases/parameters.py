"""Scene parameters: a value given as text, checked and made into what the factory asks for.

The keyword parameters of a factory are the parameters of its scene. Their annotations say what they
may be: float, int, bool, str, Path, `Literal[...]` of words or numbers, or one of these `| None`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import ConfigError, shown

__all__ = ["SceneFactory", "checked"]

SceneFactory = Callable[..., Scene]

_SWITCH = {"true": True, "yes": True, "on": True, "1": True}
_SWITCH |= {"false": False, "no": False, "off": False, "0": False}


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
        key: _read(f"{name}: {key}", known[key].annotation, value) for key, value in given.items()
    }


def _read(label: str, kind: object, value: Parameter) -> object:
    """The value as the kind that an annotation names; numbers where there is no annotation."""
    kinds = [k for k in get_args(kind) if k is not NoneType]
    if get_origin(kind) is Literal:
        return _word(label, kinds, value)
    if kinds:  # optional: the first kind that is not None
        return _read(label, kinds[0], value)
    if kind is str or kind is Path:
        return kind(str(value).strip())
    if kind is bool:
        return _switch(label, value)
    return _whole(label, value) if kind is int else _number(label, value)


def _word(label: str, words: list[object], value: Parameter) -> object:
    """The one of the words (or numbers) that the value spells."""
    for word in words:
        if str(value).strip().lower() == str(word):
            return word
    known = ", ".join(str(word) for word in words)
    raise ConfigError(f"{label} must be one of {known}, not {value!r}")


def _switch(label: str, value: Parameter) -> bool:
    try:
        return _SWITCH[str(value).strip().lower()]
    except KeyError:
        raise ConfigError(f"{label} must be true or false, not {value!r}") from None


def _whole(label: str, value: Parameter) -> int:
    number = _float(value)
    if number is None or not number.is_integer():
        raise ConfigError(f"{label} must be a whole number, not {shown(value)}")
    return int(number)


def _number(label: str, value: Parameter) -> float:
    number = _float(value)
    if number is None:
        raise ConfigError(f"{label} must be a number, not {shown(value)}")
    if not math.isfinite(number):
        raise ConfigError(f"{label} must be finite, not {number}")
    return number


def _float(value: Parameter) -> float | None:
    """The number, infinite where it is too large; None for a switch and for other words."""
    try:
        return None if isinstance(value, bool) else float(value)
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        return None
