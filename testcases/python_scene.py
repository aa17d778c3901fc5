"""A scene in a Python file of the user, which defines `scene(**parameters) -> Scene`."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.guarded import guarded
from swe_sphere.testcases.parameters import SceneFactory, checked

__all__ = ["load"]


def load(path: Path, parameters: Mapping[str, Parameter]) -> Scene:
    """The scene that the file makes with these parameters.

    Raises:
        ConfigError: no such file, a file that fails, or a parameter that it does not have.
    """
    if not guarded(f"looking for {path}", path.is_file):
        raise ConfigError(f"there is no scene file {path}")
    spec = importlib.util.spec_from_file_location(f"swe_sphere_scene_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path} cannot be read as a Python file")
    module = importlib.util.module_from_spec(spec)
    guarded(str(path), spec.loader.exec_module, module)
    factory = getattr(module, "scene", None)
    if not callable(factory):
        raise ConfigError(f"{path} must define scene(**parameters) -> Scene")
    return _made_by(path, factory, parameters)


def _made_by(path: Path, factory: SceneFactory, parameters: Mapping[str, Parameter]) -> Scene:
    given = guarded(f"scene() of {path}", checked, str(path), factory, parameters)
    scene = guarded(f"scene() of {path}", factory, **given)
    if not isinstance(scene, Scene):
        raise ConfigError(f"scene() of {path} must return a Scene, not {type(scene).__name__}")
    return scene
