"""A scene in a Python file of the user, which defines `scene(**parameters) -> Scene`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.guarded import guarded
from swe_sphere.testcases.parameters import SceneFactory, checked
from swe_sphere.user_file import load_file

__all__ = ["load"]


def load(path: Path, parameters: Mapping[str, Parameter]) -> Scene:
    """The scene that the file makes with these parameters.

    Raises:
        ConfigError: no such file, a file that fails, or a parameter that it does not have.
    """
    factory = getattr(load_file(path, "scene"), "scene", None)
    if not callable(factory):
        raise ConfigError(f"{path} must define scene(**parameters) -> Scene")
    return _made_by(path, factory, parameters)


def _made_by(path: Path, factory: SceneFactory, parameters: Mapping[str, Parameter]) -> Scene:
    given = guarded(f"scene() of {path}", checked, str(path), factory, parameters)
    scene = guarded(f"scene() of {path}", factory, **given)
    if not isinstance(scene, Scene):
        raise ConfigError(f"scene() of {path} must return a Scene, not {type(scene).__name__}")
    return scene
