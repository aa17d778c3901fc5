"""What was given as objects, where a configuration has names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError, shown
from swe_sphere.mesh import Mesh
from swe_sphere.settings.values import SCENE, STEPPER, by_owner
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.setup import make_scene

if TYPE_CHECKING:
    from swe_sphere.steppers import Stepper

Name = str | Path | None
"""What a configuration holds."""


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
    *,
    stepper: Any = None,
    mesh: Mesh | None = None,
    preconditioner: Any = None,
    effects: Mapping[str, object] | Iterable[Effect] = (),
    parameters: Mapping[str, object] | None = None,
    options: Mapping[str, object] | None = None,
    settings: Iterable[str] = (),
    **fields: Any,
) -> tuple[RunConfig, Supplied]:
    """A configuration, and the objects that stand behind its names; arguments as of `Simulation`.

    Raises:
        ConfigError: an object of another kind than is asked for, or what does not go together.
    """
    if not isinstance(scene, Scene | Name):
        raise _unfit("scene", "a name, a file or a Scene", scene)
    if not isinstance(mesh, Mesh | None):
        raise _unfit("mesh", "a Mesh", mesh)
    changes, added = _effects(effects)
    kind, instance = _method(stepper)
    own = _preconditioner_class(preconditioner)
    if instance is not None:
        brought = mesh or preconditioner or changes or added or parameters or options or settings
        _check_model(instance, str(_name(scene)), bool(brought))
    objects = Supplied(
        scene if isinstance(scene, Scene) else None,
        instance.model.mesh if instance else mesh,
        kind, instance, own, added,
    )  # fmt: skip
    tables = {"": changes, f"{SCENE}.": parameters or {}, f"{STEPPER}.": options or {}}
    said = [f"{of}{k}={v}" for of, table in tables.items() for k, v in table.items()]
    names = {
        "scene": _name(scene),
        "stepper": _name(kind or stepper),
        "preconditioner": _name(preconditioner),
        "settings": (*said, *settings) or None,
    }
    given = {name: value for name, value in names.items() if value is not None}
    of_mesh = _mesh_settings(objects.mesh)
    for name in of_mesh.keys() & fields.keys():
        raise ConfigError(f"{name} is given twice: as {name}, and by the mesh")
    config = make_config(given | of_mesh | fields)
    if objects.scene is not None and (
        config.alpha is not None or SCENE in by_owner(config.settings)
    ):
        raise ConfigError("alpha and parameters are for a scene by name: this one is made already")
    return config, objects


def _effects(
    effects: Mapping[str, object] | Iterable[Effect],
) -> tuple[Mapping[str, object], tuple[Effect, ...]]:
    """Changes of parameters by name, or effects to add."""
    if isinstance(effects, Mapping):
        return effects, ()
    added = tuple(effects) if isinstance(effects, Iterable) else (effects,)
    for effect in added:
        if not isinstance(effect, Effect):
            raise _unfit(
                "effects", "parameters {'viscosity.nu': 1e5}, or a list of Effects", effects
            )
    return {}, added


def _method(stepper: Any) -> tuple[type[Stepper] | None, Stepper | None]:
    """The class and the instance, as far as they are given."""
    if isinstance(stepper, Name):
        return None, None
    from swe_sphere.steppers import Stepper

    if isinstance(stepper, Stepper):
        return type(stepper), stepper
    if not _is_kind(stepper, Stepper):
        raise _unfit("stepper", "a name, a file, a class or a Stepper", stepper)
    return stepper, None


def _check_model(stepper: Stepper, scene: str, more: bool) -> None:
    """ConfigError if a stepper on a model of its own comes with another scene, or with more."""
    own = stepper.model.scene.name
    if more or (own != scene and not scene.endswith((".py", ".toml"))):
        raise ConfigError(
            f"the stepper has a model of its own, of {own}: give this scene, and leave out mesh,"
            " preconditioner, effects, parameters, options and settings"
        )


def _preconditioner_class(which: Any) -> Any:
    """The class, if it is one; None for a name."""
    if isinstance(which, Name):
        return None
    from swe_sphere.solvers.preconditioners import Preconditioner

    if not _is_kind(which, Preconditioner):
        raise _unfit("preconditioner", "a name, a file or a class", which)
    return which


def _is_kind(thing: object, kind: type) -> bool:
    return isinstance(thing, type) and issubclass(thing, kind)


def _unfit(what: str, choice: str, thing: object) -> ConfigError:
    return ConfigError(f"{what}: give {choice}, not {shown(thing)}")


def _name(thing: Any) -> str | None:
    """What a configuration calls it."""
    if thing is None:
        return None
    return str(thing if isinstance(thing, Name) else thing.name)


def _mesh_settings(mesh: Mesh | None) -> dict[str, float]:
    if mesh is None:
        return {}
    lon, lat = mesh.centre
    return {"ne": mesh.ne, "np": mesh.np, "stretch": mesh.stretch, "spin": mesh.spin,
            "centre_lon": lon, "centre_lat": lat}  # fmt: skip
