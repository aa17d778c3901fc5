"""What must hold of a scene before any of its functions is evaluated."""

import math
import operator
import re
from collections.abc import Mapping
from numbers import Real

from swe_sphere.equations.effects import EFFECTS, Effect, PointwiseEffect
from swe_sphere.equations.scene_fields import SceneFields
from swe_sphere.errors import ConfigError, shown
from swe_sphere.planet import Planet
from swe_sphere.settings.values import SCENE, STEPPER

MOST_ELEMENTS = 10**6
"""More along an edge of the cube are a slip of the pen."""
LONGEST_DAYS = 1e9
"""A run that is longer is one, too [days]."""

KINDS: Mapping[str, type] = {
    "name": str, "title": str, "reference": str, "report": str, "error_field": str,
    "effects": tuple, "planet": Planet, "steady_wind": bool, "steady_forcing": bool,
    "sheds_waves": bool, "parameters": Mapping,
}  # fmt: skip
"""Attributes of a scene that are neither numbers nor functions."""

FIELDS = ("bottom", "coriolis", "equilibrium")
"""Functions of a scene that an effect without derivatives may read."""


def check_scene(scene: SceneFields) -> None:
    """Raise ConfigError for the first thing that is wrong, after `check_kinds`."""
    _check_texts(scene)
    _check_effects(scene)
    _check_tracers(scene)
    _check_numbers(scene)


def check_kinds(scene: SceneFields) -> None:
    """Raise ConfigError for an attribute of the wrong type."""
    for name, kind in KINDS.items():
        value = getattr(scene, name)
        if not isinstance(value, kind):
            what = kind.__name__.lower()
            raise ConfigError(f"{scene.name}: {name} must be a {what}, not {shown(value)}")
    effects: tuple[object, ...] = scene.effects
    for effect in effects:
        if not isinstance(effect, Effect):
            hint = "; write Rotation(), not Rotation" if isinstance(effect, type) else ""
            raise ConfigError(f"{scene.name}: {shown(effect)} among its effects is none{hint}")
        if not isinstance(getattr(effect, "name", None), str):
            raise ConfigError(f"{scene.name}: give the effect {type(effect).__name__} a name")
    for name, value in scene.parameters.items():
        if not (isinstance(name, str) and isinstance(value, bool | int | float | str)):
            raise ConfigError(
                f"{scene.name}: parameters are numbers, switches or words by name, not"
                f" {name!r}: {shown(value)}"
            )


def _check_texts(scene: SceneFields) -> None:
    """They are written into files and tables."""
    if not scene.name.strip():
        raise ConfigError("name: give the scene a name")
    for name in ("name", "title", "reference", "report"):
        if not "".join(getattr(scene, name).split()).isprintable():
            raise ConfigError(f"{scene.name!a}: {name} holds characters that cannot be printed")


def _check_effects(scene: SceneFields) -> None:
    """An effect and the function it calls for come together or not at all."""
    names = [effect.name for effect in scene.effects]
    if len(set(names)) < len(names):
        raise ConfigError(f"{scene.name}: an effect is listed twice: {', '.join(names)}")
    needed = [effect.needs for effect in scene.effects]
    for name, cls in EFFECTS.items():
        if cls.needs is None:
            continue
        there = getattr(scene, cls.needs) is not None
        if there and cls.needs not in needed:
            raise ConfigError(f"{scene.name}: {cls.needs!r} is given without effect {name!r}")
        if name in names and not there:
            raise ConfigError(f"{scene.name}: effect {name!r} needs the function {cls.needs!r}")
    for effect in scene.effects:
        for other in names:
            if other in effect.excludes:
                raise ConfigError(f"{scene.name}: {effect.excludes[other]}")
        if isinstance(effect, PointwiseEffect):
            _check_pointwise(scene, effect)


def _check_pointwise(scene: SceneFields, effect: PointwiseEffect) -> None:
    """Of an effect that may be the user's own."""
    label = f"{scene.name}: effect {effect.name!r}"
    if EFFECTS.get(effect.name, type(effect)) is not type(effect):
        raise ConfigError(f"{label} has the name of one of the package; choose another")
    if not (re.fullmatch(r"[a-z][a-z0-9-]*", effect.name) and effect.name not in (SCENE, STEPPER)):
        raise ConfigError(f"{label}: a name is of small letters, digits and -")
    if effect.needs not in (None, *FIELDS):
        known = ", ".join(FIELDS)
        raise ConfigError(f"{label} needs {shown(effect.needs)}, which is none of {known}")
    if effect.needs is not None and getattr(scene, effect.needs) is None:
        raise ConfigError(f"{label} needs the function {effect.needs!r}")
    wind, depth = effect.tendencies
    if wind is None and depth is None:
        raise ConfigError(f"{label} has neither a wind_tendency nor a depth_tendency")
    if scene.wind is not None and depth is None:
        raise ConfigError(f"{label} acts on the wind, which is prescribed")
    if scene.base is not None and not effect.differentiable:
        raise ConfigError(f"{label} has no derivative, which linearised dynamics are made of")


def _check_tracers(scene: SceneFields) -> None:
    """Names of tracers become names of variables in files."""
    tracers: object = scene.tracers
    if tracers is not None and not isinstance(tracers, Mapping):
        raise ConfigError(f"{scene.name}: tracers are functions by name, not {shown(tracers)}")
    if scene.tracers is not None and not scene.tracers:
        raise ConfigError(f"{scene.name}: tracers are called for, but there is none")
    for name in scene.tracers or ():
        if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name)):
            raise ConfigError(
                f"{scene.name}: a tracer is named by letters, digits and _, not {name!r}"
            )
    if scene.exact_tracers is not None and scene.tracers is None:
        raise ConfigError(f"{scene.name}: 'exact_tracers' is given without tracers")


def _check_numbers(scene: SceneFields) -> None:
    if scene.error_field not in ("h", "surface"):
        raise ConfigError(f"{scene.name}: error_field is 'h' or 'surface'")
    for name in ("ne", "np"):
        _check_count(scene, name, getattr(scene, name))
    positive = {"days": scene.days, "radius": scene.planet.radius, "gravity": scene.planet.gravity}
    if scene.dt is not None:
        positive["dt"] = scene.dt
    for name, value in positive.items():
        if not (is_finite(value) and value > 0.0):
            what = shown(value)
            raise ConfigError(f"{scene.name}: {name} must be finite and positive, not {what}")
    if scene.days > LONGEST_DAYS:
        raise ConfigError(f"{scene.name}: days must be at most {LONGEST_DAYS:g}, not {scene.days}")
    if not is_finite(scene.planet.rotation):
        raise ConfigError(f"{scene.name}: rotation must be finite, not {scene.planet.rotation!r}")


def _check_count(scene: SceneFields, name: str, value: object) -> None:
    try:
        whole = -1 if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        whole = -1
    if not 1 <= whole <= MOST_ELEMENTS:
        raise ConfigError(
            f"{scene.name}: {name} must be a whole number from 1 to {MOST_ELEMENTS}, not"
            f" {shown(value)}"
        )


def is_finite(value: object) -> bool:
    """Whether the value is a finite number; a switch is none, nor is one too large for a float."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
