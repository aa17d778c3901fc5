"""The contents of the user's files that a scene is made of, so that an edited one is noticed."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import file_fingerprint
from swe_sphere.testcases.files import scene_files

__all__ = ["SCENE_FILE", "scene_sources"]

SCENE_FILE = "the scene's file"


def scene_sources(name: str, scene: Scene) -> dict[str, str]:
    """Fingerprints of the scene's file, of the files it builds on and of those it takes data from.

    The names of bases are relative to the scene's file, so that the folder may be moved.  Files of
    data are those whose names are parameters of the scene; what a Python scene reads besides is not
    known.  Empty for a scene of the package without data.

    Raises:
        ConfigError: a file is gone since the scene was made.
    """
    try:
        files = scene_files(name)
        found = {_label(path, files[0]): file_fingerprint(path) for path in files}
    except OSError as error:
        raise ConfigError(f"cannot read {error.filename}: {error.strerror}") from None
    for value in scene.parameters.values():
        if isinstance(value, str):
            with suppress(OSError, ValueError):  # a word, not the name of a file
                found[value] = file_fingerprint(Path(value))
    return found


def _label(path: Path, scene: Path) -> str:
    return SCENE_FILE if path == scene else os.path.relpath(path, scene.parent)
