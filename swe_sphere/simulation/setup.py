"""From a configuration to what is stepped, scene, mesh and model; and what tells runs apart."""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.equations.scene import Parameter, Scene, apply_settings
from swe_sphere.errors import ConfigError
from swe_sphere.files.fingerprints import SCENE_FILE, file_fingerprint
from swe_sphere.files.user_file import is_user_file
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.ranks.communicator import world
from swe_sphere.settings.values import SCENE, by_owner
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.memory_guard import check_memory
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.user_scenes import scene_files

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model


def make_scene(config: RunConfig) -> Scene:
    """The scene with the parameters and effects the configuration asks for.

    Raises:
        ConfigError: unknown scene, parameter or effect, or a value that does not fit.
    """
    parameters = _scene_parameters(config)
    scene = get_scene(config.scene, **parameters)
    angle = scene.parameters.get("alpha")
    if isinstance(angle, float) and abs(angle) > 2.0 * math.pi:
        raise ConfigError(f"alpha={angle:g}: the angle is in radians, at most a whole turn")
    return apply_settings(scene, config.settings)


def make_mesh(config: RunConfig, scene: Scene, made: Mesh | None = None) -> Mesh:
    """The mesh, which may be made already.

    Raises ConfigError for a number out of range, for a mesh that memory cannot hold, that has too
    few elements for the ranks, or that is of another planet.
    """
    ne = scene.ne if config.ne is None else config.ne
    np = scene.np if config.np is None else config.np
    check_ranks(ne, world().size)
    check_memory(config, scene, ne, np)
    if made is not None:
        if made.radius != scene.planet.radius:
            raise ConfigError(
                f"the mesh has a radius of {made.radius:.8g} m, and the planet of {scene.name} one"
                f" of {scene.planet.radius:.8g} m: make it with radius={scene.planet.radius!r}"
            )
        return made
    return Mesh.build(
        ne,
        np,
        radius=scene.planet.radius,
        stretch=config.stretch,
        centre=(config.centre_lon, config.centre_lat),
        spin=config.spin,
    )


def make_model(config: RunConfig, scene: Scene, mesh: Mesh) -> Model:
    """The compiled right-hand side; ConfigError for a device that is not there,
    or a function of the scene that fails."""
    start_warp()  # takes its time: after the cheap checks
    from swe_sphere.equations.model import Model

    scene.check_answers(mesh.lon, mesh.lat)
    return Model(mesh, scene, config.device, config.precision, config.launch, comm=world())


def identity(config: RunConfig, scene: Scene, mesh: Mesh) -> dict[str, object]:
    """All that two runs must share for one to go on where the other stopped."""
    from swe_sphere.steppers import get_stepper

    return {
        "scene": scene.name,
        "stepper": get_stepper(config.stepper).name,
        "ne": mesh.ne,
        "np": mesh.np,
        "stretch": mesh.stretch,
        "centre": [*mesh.centre],
        "spin": mesh.spin,
        "precision": config.precision,
        "tracer_steps": config.tracer_steps,
        "scene_parameters": dict(scene.parameters),
        "effects": {effect.name: asdict(effect) for effect in scene.effects},
        "planet": asdict(scene.planet),
        "sources": scene_sources(config.scene, scene) | method_sources(config),
    }


def _scene_parameters(config: RunConfig) -> dict[str, Parameter]:
    parameters: dict[str, Parameter] = {**by_owner(config.settings).get(SCENE, {})}
    if config.alpha is not None:
        if "alpha" in parameters:
            raise ConfigError("alpha is given twice: by alpha and by set scene.alpha")
        parameters["alpha"] = config.alpha
    return parameters


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


EXPECTED = b"Could not find or load the NVIDIA CUDA driver"
"""What Warp's native library writes to stderr on every machine without a GPU."""


def start_warp() -> None:
    """Import and initialise Warp; warnings and errors still come through, but for that one."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            caught.seek(0)
            for line in caught:
                if EXPECTED not in line:
                    os.write(2, line)
