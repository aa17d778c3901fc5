"""What was given as objects, where a configuration has names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swe_sphere.equations.effect_settings import apply_settings
from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.settings import SCENE, STEPPER
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.setup import make_scene

if TYPE_CHECKING:
    from swe_sphere.steppers import Stepper

__all__ = ["Supplied", "supply"]


@dataclass(frozen=True)
class Supplied:
    """Objects in the place of names; None where there is a name."""

    scene: Scene | None = None
    mesh: Mesh | None = None
    kind: type[Stepper] | None = None
    instance: Stepper | None = None
    preconditioner: Any = None
    effects: tuple[Effect, ...] = ()

    def scene_of(self, config: RunConfig) -> Scene:
        """The scene with all effects and their parameters.

        Raises:
            ConfigError: unknown scene, parameter or effect, or a value that does not fit.
        """
        if self.instance is not None:
            return self.instance.model.scene
        if self.scene is None:
            scene = make_scene(config)
        else:
            scene = apply_settings(self.scene, config.settings)
        for effect in self.effects:
            scene = scene.with_effect(effect)
        return scene


def supply(
    scene: str | Path | Scene,
    stepper: Any,
    mesh: Mesh | None,
    preconditioner: Any,
    effects: Mapping[str, object] | Iterable[Effect],
    parameters: Mapping[str, object] | None,
    options: Mapping[str, object] | None,
) -> tuple[dict[str, Any], Supplied]:
    """Fields of a configuration, and the objects that stand behind its names.

    Raises:
        ConfigError: an object of another kind than is asked for, or what does not go together.
    """
    from swe_sphere.steppers import Stepper

    changes = dict(effects) if isinstance(effects, Mapping) else {}
    added = () if isinstance(effects, Mapping) else tuple(effects)
    for effect in added:
        if not isinstance(effect, Effect):
            raise ConfigError(f"effects: give parameters {{'viscosity.nu': 1e5}}, not {effect!r}")
    if isinstance(scene, Scene) and parameters:
        raise ConfigError("parameters are for a scene by name: this one is made already")
    if mesh is not None and not isinstance(mesh, Mesh):
        raise ConfigError(f"mesh: give a Mesh, not {mesh!r}")
    instance = stepper if isinstance(stepper, Stepper) else None
    kind = type(instance) if instance else stepper if isinstance(stepper, type) else None
    if kind is not None and not issubclass(kind, Stepper):
        raise ConfigError(f"stepper: {kind.__name__} is no Stepper")
    settings = [f"{name}={value}" for name, value in changes.items()]
    settings += [f"{SCENE}.{name}={value}" for name, value in (parameters or {}).items()]
    settings += [f"{STEPPER}.{name}={value}" for name, value in (options or {}).items()]
    named = isinstance(preconditioner, str | Path | None)
    values: dict[str, Any] = {
        "scene": scene.name if isinstance(scene, Scene) else str(scene),
        "stepper": None if stepper is None else kind.name if kind else str(stepper),
        "preconditioner": None if preconditioner is None else _name(preconditioner),
        "settings": tuple(settings),
    }
    mine = mesh if instance is None else instance.model.mesh
    if mine is not None:
        values |= {"ne": mine.ne, "np": mine.np, "stretch": mine.stretch, "spin": mine.spin,
                   "centre_lon": mine.centre[0], "centre_lat": mine.centre[1]}  # fmt: skip
    given = {name: value for name, value in values.items() if value is not None}
    objects = Supplied(
        scene if isinstance(scene, Scene) else None, mine, kind, instance,
        None if named else preconditioner, added,
    )  # fmt: skip
    return given, objects


def _name(preconditioner: Any) -> str:
    if isinstance(preconditioner, str | Path):
        return str(preconditioner)
    return str(getattr(preconditioner, "name", getattr(preconditioner, "__name__", "own")))
