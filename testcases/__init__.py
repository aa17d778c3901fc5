"""The scenes: one short function each, of data and formulas, found where it is defined.

`get_scene` finds one by name, or in a file of the user: a .py file that defines
`scene(**parameters)`, or a .toml file that changes another scene.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import unknown_name
from swe_sphere.settings.registry import first_line
from swe_sphere.testcases.user_scenes import SceneFactory, load, made

__all__ = ["SCENES", "get_scene", "list_scenes"]


def _factories() -> Iterator[tuple[str, SceneFactory]]:
    """Yield by name the public functions here that make a scene, without arguments too."""
    for found in pkgutil.iter_modules(__path__, f"{__name__}."):
        module = importlib.import_module(found.name)
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ != found.name or name.startswith("_"):
                continue
            called = inspect.signature(function)
            optional = all(each.default is not each.empty for each in called.parameters.values())
            if optional and called.return_annotation in (Scene, "Scene"):
                yield name.replace("_", "-"), function


_FOUND = dict(_factories())
_ORDER = sorted(_FOUND, key=lambda name: (not name.startswith("williamson"), name))
SCENES = {name: _FOUND[name] for name in _ORDER}
"""Factories by name, the standard set first; their keyword parameters are those of the scene."""


def get_scene(name: str, **parameters: Parameter) -> Scene:
    """The scene of that name, or of the file of that path, with the parameters given.

    Args:
        name: a key of `SCENES`, the path of a .py file that defines `scene(**parameters)`, or
            that of a .toml file (see `swe_sphere.testcases.user_scenes`).
        parameters: numbers, switches and words, or text that can be read as such.

    Raises:
        ConfigError: unknown name or parameter, a value that cannot be read, a file that fails.
    """
    if name.endswith((".py", ".toml")):
        return load(Path(name), parameters, get_scene)
    if name not in SCENES:
        raise unknown_name("scene", name, SCENES)
    return made(name, SCENES[name], parameters)


def list_scenes() -> dict[str, str]:
    """What each scene is, in a line, by name.

    Examples:
        >>> import swe_sphere
        >>> swe_sphere.list_scenes()["williamson5"]
        'Zonal flow over an isolated mountain.'
    """
    return {name: first_line(make) for name, make in SCENES.items()}
