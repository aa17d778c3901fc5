"""From a configuration to the things that are stepped: scene, mesh and model."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from swe_sphere.equations.effect_settings import apply_settings
from swe_sphere.equations.scene import Parameter, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.parallel import world
from swe_sphere.settings import SCENE, by_owner
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.memory_guard import check_memory
from swe_sphere.simulation.scene_files import method_sources, scene_sources
from swe_sphere.simulation.warp_start import start_warp
from swe_sphere.testcases import get_scene

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model


def make_scene(config: RunConfig) -> Scene:
    """The scene with the parameters and effects the configuration asks for.

    Raises:
        ConfigError: unknown scene, parameter or effect, or a value that does not fit.
    """
    parameters = _scene_parameters(config)
    scene = get_scene(config.scene, **parameters)
    return apply_settings(scene, config.settings)


def make_mesh(config: RunConfig, scene: Scene) -> Mesh:
    """The mesh; ConfigError for a number out of range, or a mesh that memory cannot hold."""
    ne = scene.ne if config.ne is None else config.ne
    np = scene.np if config.np is None else config.np
    check_memory(config, scene, ne, np)
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
    comm = world()
    if comm.shared and config.device != "cpu":
        raise ConfigError(f"device={config.device}: several ranks run on the cpu only")
    start_warp()  # takes its time: after the cheap checks
    from swe_sphere.equations.model import Model

    scene.check_answers(mesh.lon, mesh.lat)
    return Model(mesh, scene, config.device, config.precision, config.launch, comm=comm)


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
