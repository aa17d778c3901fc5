"""The contents of the user's files that a run is made of, so that an edited one is noticed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import file_fingerprint
from swe_sphere.simulation.config import RunConfig
from swe_sphere.testcases.user_scenes import scene_files
from swe_sphere.user_file import is_user_file

SCENE_FILE = "the scene's file"


def scene_sources(name: str, scene: Scene) -> dict[str, str]:
    """Fingerprints of the scene's file, of the files it builds on and of those it takes data from.

    The names of bases are relative to the scene's file, so that the folder may be moved.  Files of
    data are those whose names are parameters of the scene; what a Python scene reads besides is not
    known.  Empty for a scene of the package without data.

    Raises:
        ConfigError: a file is gone since the scene was made.
    """
    with _readable():
        files = scene_files(name)
        found = {_label(path, files[0]): file_fingerprint(path) for path in files}
    for value in scene.parameters.values():
        if isinstance(value, str):
            with suppress(OSError, ValueError):  # a word, not the name of a file
                found[value] = file_fingerprint(Path(value))
    return found


def method_sources(config: RunConfig) -> dict[str, str]:
    """Fingerprints of the user's own files of stepper and preconditioner.

    Raises:
        ConfigError: a file is gone since it was loaded.
    """
    asked = {"stepper": config.stepper, "preconditioner": config.preconditioner}
    files = {what: Path(file) for what, file in asked.items() if file and is_user_file(file)}
    with _readable():
        return {f"the {what}'s file": file_fingerprint(file) for what, file in files.items()}


@contextmanager
def _readable() -> Iterator[None]:
    """ConfigError for a file that cannot be read any more."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"cannot read {error.filename}: {error.strerror}") from None


def _label(path: Path, scene: Path) -> str:
    return SCENE_FILE if path == scene else os.path.relpath(path, scene.parent)
