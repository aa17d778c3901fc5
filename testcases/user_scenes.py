"""Scenes by name, and user-defined scenes in files.

Scene files are Python files that define `scene(**parameters) -> Scene`, and TOML files, each of
which changes another scene:

base = "williamson5"                    # a scene, or a .py or .toml file beside this one
name = "my-mountain"                    # by default the name of the file
title = "slow flow over a mountain"
ne = 8                                  # and np, days: recommended values
days = 5

[parameters]                            # of the base; --set scene.… overrides them
speed = 5

[effects]
viscosity = { nu = 1e5 }                # switched on, or its parameters changed
rotation = false                        # switched off; the exact solution is dropped

The keyword parameters of a factory (a function that returns a scene) are the parameters of its
scene. Their annotations state the permitted values (`swe_sphere.settings.values.convert`).
"""

import importlib
import inspect
import os
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, PositiveFloat, PositiveInt, ValidationError

from swe_sphere.equations.scene import Parameter, Scene, configured_effect
from swe_sphere.errors import ConfigError, shown, unknown_name
from swe_sphere.files.user_file import call_custom, file_contents, is_user_file, load_file
from swe_sphere.settings.registry import first_line
from swe_sphere.settings.values import complaint, convert, read_toml

MAX_NESTING = 8
"""Largest number of files that may build on each other; a longer chain counts as a circle."""

Value = bool | Annotated[int, Field(ge=-(2**63), lt=2**63)] | float | str


class _File(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False, strict=True):
    """Contents of a TOML scene file."""

    base: str
    name: str | None = None
    title: str | None = None
    ne: PositiveInt | None = None
    np: PositiveInt | None = None
    days: PositiveFloat | None = None
    parameters: dict[str, Value] = {}
    effects: dict[str, dict[str, Value] | Literal[False]] = {}


def is_scene_file(name: str) -> bool:
    """Return whether the name of a scene is the path of a file."""
    return is_user_file(name) or name.endswith(".toml")


def scene_files(name: str) -> list[Path]:
    """Return the file of a loadable scene, the file of its base, and so on to the last file.

    The list is empty for a key of `SCENES`. Raises ConfigError if a file of TOML cannot be read.
    """
    path = Path(name)
    if not is_scene_file(name):
        return []
    if is_user_file(name):
        return [path]
    base = str(read_toml(path)["base"])
    return [path, *(scene_files(os.fspath(path.parent / base)) if is_scene_file(base) else [])]


def get_scene(name: str | Path, **parameters: Parameter) -> Scene:
    """Return the scene of a name or of a file, with the given parameters.

    Args:
        name: a key of `SCENES`, the path of a .py file that defines `scene(**parameters)`, or
            the path of a .toml file (see `swe_sphere.testcases.user_scenes`).
        parameters: numbers, booleans and words, or text that can be read as such.

    Raises ConfigError for an unknown name or parameter, an unreadable value, or a file that fails.
    """
    if is_scene_file(name := os.fspath(name)):
        return _load(Path(name), parameters)
    if name not in SCENES:
        raise unknown_name("scene", name, SCENES)
    return call_custom(f"scene {name}", made, name, SCENES[name], parameters)


def list_scenes() -> dict[str, str]:
    """Return the one-line summary of each scene, by name.

    Examples:
        >>> import swe_sphere
        >>> swe_sphere.list_scenes()["williamson5"]
        'Zonal flow over an isolated mountain.'
    """
    return {name: first_line(make) for name, make in SCENES.items()}


def _load(path: Path, parameters: Mapping[str, Parameter], depth: int = 0) -> Scene:
    """Return the scene of a file; `parameters` override those of the file; depth: bases so far.

    Raises ConfigError if the file is missing, fails, is not TOML, or does not fit the scene.
    """
    if is_user_file(path):
        if not callable(factory := getattr(load_file(path, "scene"), "scene", None)):
            raise ConfigError(f"{path} must define scene(**parameters) -> Scene")
        return call_custom(f"scene() of {path}", made, str(path), factory, parameters)
    if depth == MAX_NESTING:
        raise ConfigError(f"{path}: its bases form a circle")
    file_contents(path, "scene")
    try:
        file = _File.model_validate(read_toml(path))
    except ValidationError as error:
        raise ConfigError(f"{path}: {_complaint(error)}") from None
    given = {**file.parameters, **parameters}
    try:
        if is_scene_file(file.base):
            scene = _load(path.parent / file.base, given, depth + 1)
        else:
            scene = get_scene(file.base, **given)
        for name, values in file.effects.items():
            if values is False:
                scene = scene.without_effect(name)
            else:
                scene = scene.with_effect(configured_effect(scene, name, values))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}" if depth == 0 else str(error)) from None
    changed = file.model_dump(exclude={"base", "parameters", "effects"}, exclude_none=True)
    return replace(scene, **{"name": path.stem} | changed)


def _complaint(error: ValidationError) -> str:
    """Return the first of the validation errors as one line."""
    first = error.errors(include_url=False)[0]
    key, given = ".".join(str(part) for part in first["loc"][:2]), shown(first["input"])
    if first["type"] == "extra_forbidden":
        return f"there is no {key!r} in a scene; there are {', '.join(_File.model_fields)}"
    if first["type"] == "missing":
        return f'name the scene that it changes: {key} = "williamson5"'
    if first["loc"][0] == "effects" and len(first["loc"]) > 1:
        return f"{key} must be false or a table of parameters, got {given}"
    return f"{key}: {complaint(error)}, got {given}"


SceneFactory = Callable[..., Scene]


def checked(name: str, factory: SceneFactory, given: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return the given parameters converted to the types in the factory's annotations.

    name: the scene, for messages. Raises ConfigError for an unknown parameter or unreadable value.
    """
    known = inspect.signature(factory, eval_str=True).parameters
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in known.values()):
        return dict(given)  # the factory accepts any parameter and must check the values itself
    for key in given:
        if key not in known:
            has = ", ".join(known) or "no parameters"
            raise ConfigError(f"scene {name} has no parameter {key!r}; it has {has}")
    kinds = {k: float if p.annotation is p.empty else p.annotation for k, p in known.items()}
    return {key: convert(f"{name}: {key}", kinds[key], value) for key, value in given.items()}


def made(name: str, factory: SceneFactory, given: Mapping[str, Parameter]) -> Scene:
    """Return the scene that the factory builds; `Scene.parameters` include the default values.

    Raises ConfigError like `checked`, and if the factory returns anything but a scene.
    """
    values = checked(name, factory, given)
    if not isinstance(scene := factory(**values), Scene):
        raise ConfigError(f"scene() of {name} must return a Scene, got {type(scene).__name__}")
    known = inspect.signature(factory).parameters
    defaults = {key: p.default for key, p in known.items() if p.default is not p.empty}
    told = {
        key: value if isinstance(value, (bool, int, float, str)) else str(value)
        for key, value in (defaults | values).items()
        if value is not None
    }
    return replace(scene, parameters=dict(scene.parameters) | told)


def _factories() -> Iterator[tuple[str, SceneFactory]]:
    """Yield name and function of each public function that builds a scene without arguments."""
    for found in pkgutil.iter_modules([str(Path(__file__).parent)], f"{__package__}."):
        module = importlib.import_module(found.name)
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ != found.name or name.startswith("_"):
                continue
            called = inspect.signature(function)
            optional = all(each.default is not each.empty for each in called.parameters.values())
            if optional and called.return_annotation in (Scene, "Scene"):
                yield name.replace("_", "-"), function


SCENES = dict(sorted(_factories(), key=lambda of: (not of[0].startswith("williamson"), of[0])))
"""Factories by name, Williamson's first; their keyword parameters are those of the scenes."""
