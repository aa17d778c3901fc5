"""A scene: the data, formulas and effects of one test case.

The functions of a scene are checked at each evaluation, so that callers get valid arrays.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from inspect import isfunction
from itertools import chain
from numbers import Integral
from typing import Any, Self, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array as Array  # scenes import it from here
from swe_sphere.equations.effects import EFFECTS, Effect, PointwiseEffect, as_float
from swe_sphere.errors import ConfigError, shown, unknown_name
from swe_sphere.files.user_file import call_custom
from swe_sphere.planet import EARTH, Planet
from swe_sphere.settings.values import SCENE, STEPPER, convert, read_settings

Scalar = Callable[[Array, Array], Array]
"""Function (lon, lat) [rad] -> one value per point."""
State = Callable[[Array, Array], tuple[Array, Array, Array]]
"""Function (lon, lat) [rad] -> eastward wind, northward wind [m s-1], fluid depth [m]."""
UnsteadyState = Callable[[Array, Array, float], tuple[Array, Array, Array]]
"""Function (lon, lat, t) [rad, rad, s] -> eastward, northward wind [m s-1], fluid depth [m]."""
Rates = Callable[[Array, Array, float], tuple[Array, Array, Array]]
"""Function (lon, lat, t) [rad, rad, s] -> rates of change of winds [m s-2] and depth [m s-1]."""
UnsteadyTracers = Callable[[Array, Array, float], Mapping[str, Array]]
"""Function (lon, lat, t) [rad, rad, s] -> mixing ratios by name."""
Wind = Callable[[Array, Array, float], tuple[Array, Array]]
"""Function (lon, lat, t) [rad, rad, s] -> eastward wind, northward wind [m s-1]."""
Parameter = float | bool | str
"""Value of a scene parameter: a number, a boolean, a word or a path."""

LARGEST_COUNT = 10**6
"""Largest accepted value of ne, np and other whole numbers; more must be a typing error."""
LONGEST_DAYS = 1e9
"""Largest accepted length of a run [days]; more must be a typing error."""

KINDS: Mapping[str, type] = {
    "name": str, "title": str, "reference": str, "error_field": str,
    "effects": tuple, "planet": Planet, "steady_wind": bool, "steady_forcing": bool,
    "sheds_waves": bool, "parameters": Mapping,
}  # fmt: skip
"""Attributes of a scene that are neither numbers nor functions."""

FIELDS = ("bottom", "coriolis", "equilibrium")
"""Functions of a scene that a `PointwiseEffect` may read."""


@dataclass(frozen=True)
class Scene:
    """A test case: its initial state, its effects, and its exact solution if one is known.

    All functions accept arrays of equal shape and return arrays of that shape, or numbers for
    constant fields. Values must be finite everywhere (a NaN of an exact solution marks an unknown
    value); each function checks its results at every call and raises ConfigError. At a pole the
    wind refers to the frame of the given longitude (0 on meshes of the package): east = (-sin lon,
    cos lon, 0) and north = (-sin lat cos lon, -sin lat sin lon, cos lat).

    Examples:
        >>> import numpy as np
        >>> from swe_sphere import Scene, Simulation
        >>> from swe_sphere.equations.effects import DYNAMICS
        >>> drop = Scene(
        ...     name="drop", effects=DYNAMICS,
        ...     initial=lambda lon, lat: (0.0, 0.0, 1000.0 + 10.0 * np.exp(-9.0 * lat**2)),
        ... )
        >>> abs(Simulation(drop, ne=3).run(days=0.25)["mass_drift"]) < 1e-14
        True

    Raises ConfigError if functions do not match effects, or a value has a wrong type or range.
    """

    name: str
    effects: tuple[Effect, ...]
    initial: State
    title: str = ""
    """Title of files and pages; the name if empty."""
    reference: str = ""
    """Paper that defines the case, with its DOI."""
    ne: int = 16
    """Recommended number of elements along the edge of a cube face."""
    np: int = 4
    """Recommended number of nodes along the edge of an element."""
    days: float = 5.0
    """Recommended length of the run [days]."""
    planet: Planet = EARTH
    exact: UnsteadyState | None = None
    bottom: Scalar | None = None
    """Height of the bottom [m]; set if and only if an effect needs it."""
    coriolis: Scalar | None = None
    """Coriolis parameter [s-1], only if an effect needs it; None: 2 Ω sin θ of the planet."""
    wind: Wind | None = None
    """Prescribed wind; set if and only if the wind is prescribed."""
    steady_wind: bool = False
    """True if the prescribed wind is the same at all times; it is then evaluated once."""
    forcing: Rates | None = None
    """Rates of change independent of the state; set if and only if the scene has forcing."""
    steady_forcing: bool = False
    """True if the forcing is the same at all times; it is then evaluated once."""
    base: State | None = None
    """Flow about which the dynamics are linearised; set if and only if they are."""
    equilibrium: Scalar | None = None
    """Depth h_eq [m] to which the depth relaxes; set if and only if an effect needs it."""
    tracers: Mapping[str, Scalar] | None = None
    """Initial mixing ratios by name, in any unit; set if and only if the scene has tracers."""
    exact_tracers: UnsteadyTracers | None = None
    """Exact mixing ratios at a time; NaN at times without a known solution."""
    error_field: str = "h"
    """Height whose errors are reported: the fluid depth ("h") or the free surface ("surface")."""
    sheds_waves: bool = False
    """True if the initial state radiates gravity waves; sweeps then compute slow-flow errors."""
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    """Parameters (alpha, ...) with which this scene was built."""

    def __post_init__(self) -> None:
        _refuse(self, _wrong_kinds)
        object.__setattr__(self, "title", self.title or self.name)
        rotates = any(effect.needs == "coriolis" for effect in self.effects)
        given = getattr(self.coriolis, "function", self.coriolis)
        if rotates and (given is None or getattr(given, "__func__", None) is Planet.coriolis):
            object.__setattr__(self, "coriolis", self.planet.coriolis)
        _check_texts(self)
        _refuse(self, _wrong_effects, _wrong_tracers, _wrong_numbers)
        for name, function in checked_functions(vars(self)).items():
            object.__setattr__(self, name, function)

    @property
    def autonomous(self) -> bool:
        """True if the tendency depends on the state alone and not on time."""
        return not self.unsteady_wind and (self.forcing is None or self.steady_forcing)

    @property
    def unsteady_wind(self) -> bool:
        """True if a prescribed wind depends on time."""
        return self.wind is not None and not self.steady_wind

    @property
    def linear(self) -> bool:
        """True if the tendency is linear in the state, apart from a constant."""
        if self.base is not None:
            return True
        if self.tracers and self.effect("orography") and any(e.diffuses for e in self.effects):
            return False  # hq (1 + b/h) is smoothed
        return self.wind is not None and all(effect.degree == 1 for effect in self.effects)

    @property
    def changes_depth(self) -> bool:
        """True if an effect at a point (relaxation, or a custom one) changes the depth."""
        return any(isinstance(e, PointwiseEffect) and e.tendencies[1] for e in self.effects)

    def effect(self, name: str) -> Effect | None:
        """Return the effect of that name, or None if the scene does not have it."""
        return next((effect for effect in self.effects if effect.name == name), None)

    def with_effect(self, effect: Effect) -> Self:
        """Return the scene with the effect added; it replaces an effect of the same name.

        An effect that vanishes (a viscosity of zero) is removed instead. Without an equilibrium,
        the depth relaxes to that of `initial`. A new or changed pointwise effect (drag,
        relaxation, custom) removes the exact solution; diffusion counts as a discretisation error.

        Raises ConfigError if `effect` is not an effect.
        """
        if isinstance(effect, type) or not hasattr(effect, "absent"):
            return replace(self, effects=(*self.effects, effect))  # raises a ConfigError
        is_new = self.effect(effect.name) is None
        if effect.absent:
            return self if is_new else self.without_effect(effect.name)
        effects = {e.name: e for e in self.effects} | {effect.name: effect}
        changes: dict[str, Any] = {"effects": (*effects.values(),)}
        if is_new and effect.needs == "equilibrium" and self.equilibrium is None:
            changes["equilibrium"] = lambda lon, lat: self.initial(lon, lat)[2]
        if isinstance(effect, PointwiseEffect) and effect not in self.effects:
            changes |= {"exact": None, "exact_tracers": None}
        return replace(self, **changes)

    def without_effect(self, name: str) -> Self:
        """Return the scene without the effect of that name and the function that only it needs.

        The exact solution is removed too, unless the effect is tracers, diffusion or the edge
        penalty. Raises ConfigError if the scene does not have the effect.
        """
        if (effect := self.effect(name)) is None:
            raise self.lacks(name)
        kept = tuple(e for e in self.effects if e.name != name)
        changes: dict[str, Any] = {"effects": kept}
        if effect.needs and all(e.needs != effect.needs for e in kept):
            changes[effect.needs] = None
        if name == "tracers":
            changes["exact_tracers"] = None
        elif isinstance(effect, PointwiseEffect) or not effect.dissipation:
            changes |= {"exact": None, "exact_tracers": None}
        return replace(self, **changes)

    def lacks(self, name: str) -> ConfigError:
        """Return the error for an effect that the scene does not have."""
        has = ", ".join(effect.name for effect in self.effects)
        return ConfigError(f"{self.name} has no effect {name!r}; it has {has}")


def apply_settings(scene: Scene, settings: object) -> Scene:
    """Return the scene with the parameters of its effects from settings.

    settings: as for `read_settings`; settings of the scene itself and of the stepper are skipped.
    Raises ConfigError like `configured_effect`.
    """
    of_effects: dict[str, dict[str, Any]] = {}
    for owner, parameter, value in read_settings(settings):  # the last of a name counts
        if owner not in (SCENE, STEPPER):
            of_effects.setdefault(owner, {})[parameter] = value
    for name, values in of_effects.items():
        scene = scene.with_effect(configured_effect(scene, name, values))
    return scene


def configured_effect(scene: Scene, name: str, given: Mapping[str, object]) -> Effect:
    """Return the effect `name` of the scene, or a new one, with the given parameters.

    Dissipation can be added to any scene; the parameters of other effects can be changed only if
    the scene has the effect. given: values by parameter, or text that can be read as such. Raises
    ConfigError for a value that cannot be read, and for an unknown name.
    """
    present = scene.effect(name)
    if present is None and name not in EFFECTS:
        raise unknown_name("effect", name, {effect.name: 0 for effect in scene.effects} | EFFECTS)
    cls = EFFECTS[name] if present is None else type(present)
    if present is None and not cls.dissipation:
        raise scene.lacks(name)
    values = {} if present is None else {key: getattr(present, key) for key in cls.parameters()}
    kinds = get_type_hints(cls)
    for key, value in given.items():
        if key not in cls.parameters():
            has = ", ".join(cls.parameters()) or "no parameters"
            raise ConfigError(f"effect {name!r} has no parameter {key!r}; it has {has}")
        values[key] = convert(f"{name}.{key}", kinds[key], value, finite=False)
    for each in fields(cls):
        if each.name not in values and each.default is MISSING:
            raise ConfigError(f"effect {name!r} needs {name}.{each.name}=…")
    return cls(**values)


def _refuse(scene: Scene, *checks: Callable[[Scene], Iterator[str]]) -> None:
    """Raise ConfigError for the first fault that a check finds."""
    for fault in chain.from_iterable(check(scene) for check in checks):
        raise ConfigError(f"{scene.name}: {fault}")


def _check_texts(scene: Scene) -> None:
    """Raise ConfigError for a text that cannot be written into files and tables."""
    if not scene.name.strip():
        raise ConfigError("name: give the scene a name")
    if scene.name.endswith((".py", ".toml")):
        raise ConfigError(f"name: {shown(scene.name)} is the name of a file: leave out its ending")
    for name in ("name", "title", "reference"):
        if not "".join(getattr(scene, name).split()).isprintable():
            raise ConfigError(f"{scene.name!a}: {name} holds characters that cannot be printed")


def _wrong_kinds(scene: Scene) -> Iterator[str]:
    for name, kind in KINDS.items():
        value = getattr(scene, name)
        if not isinstance(value, kind):
            yield f"{name} must be a {kind.__name__.lower()}, got {shown(value)}"
    effects: tuple[object, ...] = scene.effects
    for effect in effects:
        if not isinstance(effect, Effect):
            hint = "; write Rotation(), not Rotation" if isinstance(effect, type) else ""
            yield f"{shown(effect)} among its effects is not an effect{hint}"
    parameters: Mapping[Any, Any] = scene.parameters
    for key, value in parameters.items():
        if not (isinstance(key, str) and isinstance(value, bool | int | float | str)):
            yield f"parameters must be numbers, booleans or words, got {key!r}: {shown(value)}"


def _wrong_effects(scene: Scene) -> Iterator[str]:
    """Yield faults of effects: missing or unused functions, effects that exclude others."""
    names = [effect.name for effect in scene.effects]
    if len(set(names)) < len(names):
        yield f"an effect is listed twice: {', '.join(names)}"
    for effect in scene.effects:
        yield from (effect.excludes[other] for other in names if other in effect.excludes)
        if isinstance(effect, PointwiseEffect):
            yield from _wrong_formulas(scene, effect)
    needed = {effect.needs for effect in scene.effects}
    for name, cls in EFFECTS.items():
        there = cls.needs is not None and getattr(scene, cls.needs) is not None
        if there and cls.needs not in needed:
            yield f"{cls.needs!r} is given without effect {name!r}"
        if name in names and cls.needs is not None and not there:
            yield f"effect {name!r} needs the function {cls.needs!r}"


def _wrong_formulas(scene: Scene, effect: PointwiseEffect) -> Iterator[str]:
    """Yield faults in the name, formulas and needs of a pointwise effect."""
    label = f"effect {effect.name!r}"
    if EFFECTS.get(effect.name, type(effect)) is not type(effect):
        yield f"{label} has the name of an effect of the package: choose another"
    if not re.fullmatch(r"[a-z][a-z0-9-]*", effect.name):
        yield f"{label}: a name must consist of small letters, digits and -"
    if effect.name in (SCENE, STEPPER):
        yield f"{label}: the model uses this name for something else: choose another"
    for name in effect.parameters():
        if hasattr(PointwiseEffect, name):
            yield f"{label}: a parameter cannot have the name of the attribute {name!r}"
    if effect.needs not in (None, *FIELDS):
        yield f"{label} needs {shown(effect.needs)}, which is not one of {', '.join(FIELDS)}"
    if effect.needs is not None and getattr(scene, effect.needs) is None:
        yield f"{label} needs the function {effect.needs!r}"
    for formula in (*effect.tendencies, *effect.derivatives):
        if not (formula is None or isfunction(formula)):
            yield f"{label}: a formula must be a plain Python function, got {shown(formula)}"
    wind, depth = effect.tendencies
    if wind is None and depth is None:
        yield f"{label} has neither a wind_tendency nor a depth_tendency"
    if scene.wind is not None and depth is None:
        yield f"{label} acts on the wind, which is prescribed"
    if scene.base is not None and not effect.differentiable:
        yield f"{label} has no derivative, which linearised dynamics need"


def _wrong_tracers(scene: Scene) -> Iterator[str]:
    """Yield faults in the names of tracers, which become names of variables in files."""
    tracers: object = scene.tracers
    if tracers is None:
        if scene.exact_tracers is not None:
            yield "'exact_tracers' is given without tracers"
    elif not isinstance(tracers, Mapping):
        yield f"tracers must be functions by name, got {shown(tracers)}"
    elif not tracers:
        yield "the effect tracers needs at least one tracer"
    else:
        for name in tracers:
            if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name)):
                yield f"a tracer's name must consist of letters, digits and _, got {name!r}"


def _wrong_numbers(scene: Scene) -> Iterator[str]:
    if scene.error_field not in ("h", "surface"):
        yield "error_field must be 'h' or 'surface'"
    sizes: dict[str, Any] = {"ne": scene.ne, "np": scene.np}
    for name, value in sizes.items():
        whole = isinstance(value, Integral) and not isinstance(value, bool)
        if not (whole and 1 <= value <= LARGEST_COUNT):
            yield f"{name} must be a whole number from 1 to {LARGEST_COUNT}, got {shown(value)}"
    positive = {"days": scene.days, "radius": scene.planet.radius, "gravity": scene.planet.gravity}
    for name, number in positive.items():
        if not (is_finite(number) and number > 0.0):
            yield f"{name} must be finite and positive, got {shown(number)}"
    if scene.days > LONGEST_DAYS:
        yield f"days must be at most {LONGEST_DAYS:g}, got {scene.days}"
    if not is_finite(scene.planet.rotation):
        yield f"rotation must be finite, got {scene.planet.rotation!r}"


def is_finite(value: Any) -> bool:
    """Return True for a finite number, and False for booleans and numbers too large for a float."""
    return math.isfinite(as_float(value))


STATE, RATES, WIND = ("u", "v", "h"), ("du/dt", "dv/dt", "dh/dt"), ("u", "v")

RETURNS: Mapping[str, tuple[str, ...]] = {
    "initial": STATE, "exact": STATE, "base": STATE, "forcing": RATES, "wind": WIND,
    "bottom": (), "coriolis": (), "equilibrium": (),
}  # fmt: skip
"""Return values of the functions of a scene, by name: a tuple of fields, or one field."""


def checked_functions(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the functions of a scene by attribute name, wrapped so that they check their results.

    given: the attributes of the scene by name. Raises ConfigError for a value that is no function.
    """
    scene, tracers, exact = given["name"], given["tracers"], given["exact_tracers"]
    functions: dict[str, Any] = {
        name: _Function(f"{scene}: {name}", given[name], returns, may_be_nan=name == "exact")
        for name, returns in RETURNS.items()
        if given[name] is not None or name == "initial"
    }
    if tracers is not None:
        functions["tracers"] = {x: _Function(f"{scene}: tracer {x}", f) for x, f in tracers.items()}
    if exact is not None:
        label = f"{scene}: exact_tracers"
        functions["exact_tracers"] = _Function(label, exact, (*tracers,), True, True)
    return functions


@dataclass(frozen=True)
class _Function:
    """A function of (lon, lat) [rad], or of (lon, lat, t) [rad, rad, s].

    It returns float64 arrays of the broadcast shape of lon and lat; numbers and smaller arrays are
    broadcast. Raises ConfigError, with the names of scene and field, for a function that fails and
    for anything but real numbers of modulus below 1e30 of that shape.
    """

    label: str
    function: Callable[..., Any]
    names: tuple[str, ...] = ()
    """Names of the fields that it returns; empty for a single field."""
    may_be_nan: bool = False
    """True if NaN may stand for unknown values."""
    by_name: bool = False
    """True if the function returns fields by name, some or all of them, instead of a tuple."""

    def __post_init__(self) -> None:
        function = self.function.function if isinstance(self.function, _Function) else self.function
        if not callable(function):
            raise ConfigError(f"{self.label} must be a function, got {type(function).__name__}")
        object.__setattr__(self, "function", function)

    def __call__(self, lon: ArrayLike, lat: ArrayLike, *time: float) -> Any:
        return call_custom(self.label, self._evaluated, np.asarray(lon), np.asarray(lat), *time)

    def _evaluated(self, lon: Array, lat: Array, *time: float) -> Any:
        with np.errstate(all="ignore"):  # the result is checked
            result = self.function(lon, lat, *time)
        lon, lat = np.broadcast_arrays(lon, lat)
        if not self.names:
            return fitted(self.label, result, lon, lat, self.may_be_nan)
        named = self._named(result)
        if not isinstance(named, dict):
            what = "fields by the names of tracers" if self.by_name else f"{len(self.names)} fields"
            what += f" ({', '.join(self.names)})"
            raise ConfigError(f"{self.label} must return {what}, got {named}")
        label, nan = self.label, self.may_be_nan
        fields = {name: fitted(f"{label} {name}", x, lon, lat, nan) for name, x in named.items()}
        return fields if self.by_name else tuple(fields.values())

    def _named(self, result: Any) -> dict[str, Any] | str:
        """Return the fields by name, or a description of any other result."""
        if not isinstance(result, Mapping if self.by_name else Iterable):
            return type(result).__name__
        if self.by_name:
            return str([*result]) if {*result} - {*self.names} else dict(result)
        fields = [*result]
        fits = len(fields) == len(self.names)
        return dict(zip(self.names, fields, strict=True)) if fits else f"{len(fields)} of them"


def fitted(label: str, original: Any, lon: Array, lat: Array, may_be_nan: bool = False) -> Array:
    """Return the values as a float64 array of the shape of lon and lat.

    Raises ConfigError for values that are not numbers below 1e30 in modulus or do not broadcast.
    """
    values = np.asanyarray(original)
    if values.dtype.kind not in "fiub":  # real numbers, or booleans that stand for 0 and 1
        kind = type(original).__name__ if values.ndim == 0 else f"an array of {values.dtype}"
        raise ConfigError(f"{label} must be real numbers, got {kind}")
    values = values.astype(np.float64, copy=False)
    if hasattr(values, "filled"):  # a masked array, tested without importing numpy.ma
        values = values.filled(np.nan)
    try:
        field = np.broadcast_to(np.asarray(values), lon.shape)
    except ValueError:
        raise ConfigError(
            f"{label} has the shape {values.shape}; it must be an array of shape"
            f" {lon.shape}, like the longitudes given, or a number"
        ) from None
    sound = np.abs(field) < 1e30  # powers of larger numbers do not fit into a float64
    if may_be_nan:
        sound |= np.isnan(field)
    if not sound.all():
        value, *where = (a[~sound][0] for a in (field, np.degrees(lon), np.degrees(lat)))
        fault = "too large" if np.isfinite(value) else "not finite"
        raise ConfigError(
            f"{label} is {fault} ({value:.3g}) at longitude {where[0]:.4g}°,"
            f" latitude {where[1]:.4g}°: correct its formula"
        )
    return field
