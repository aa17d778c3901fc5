"""Build scene, state and mesh of a run from its configuration and user objects; check memory."""

import hashlib
import inspect
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy

from swe_sphere.arrays import Array
from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError, shown
from swe_sphere.files.durable import translate_errors
from swe_sphere.io.scalar_fields import evaluate
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.mesh import check_settings
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.planet import DAY
from swe_sphere.ranks.communicator import world
from swe_sphere.ranks.limits import available_memory
from swe_sphere.settings.registry import file_or_name
from swe_sphere.settings.values import SCENE, STEPPER, convert, read_settings, read_toml
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.restart import OF_ONE_RUN
from swe_sphere.testcases import get_scene

if TYPE_CHECKING:
    from swe_sphere.steppers import Stepper


SHIPPED: dict[str, tuple[str, tuple[str, ...]]] = {
    "williamson5": ("williamson5", ()), "williamson6": ("williamson6", ()),
    "galewsky": ("galewsky", ()), "galewsky_viscous": ("galewsky", ("viscosity.nu=1e5",)),
}  # fmt: skip
"""Solutions that come with the package: the scene and the settings of each."""
DECISIVE = [
    *inspect.signature(Scene).parameters.keys()
    - {"title", "reference", "ne", "np", "days", "error_field", "sheds_waves"}
]
"""Attributes of a scene on which its solution depends."""


def read_arguments(
    scene: Any, mesh: Any, effects: Any, parameters: Any, options: Any, settings: object = (),
    **values: Any,
) -> tuple[RunConfig, dict[str, Any]]:  # fmt: skip
    """Return what the arguments of `Simulation` configure, and the classes and objects among them.

    Raises ConfigError if an object is not of the requested kind, an argument belongs elsewhere,
    or two arguments contradict each other.
    """
    from swe_sphere.solvers.preconditioners import Preconditioner
    from swe_sphere.steppers import Stepper

    for name in OF_ONE_RUN.keys() & values.keys():
        raise ConfigError(f"{name} is not a setting of a simulation: see {OF_ONE_RUN[name]}")
    for what, thing, kinds, choice in (
        ("scene", scene, Scene | str | Path, "a name, a file or a Scene"),
        ("mesh", mesh, Mesh | None, "a Mesh"),
        ("parameters", parameters, Mapping | None, "{'alpha': 0.8}"),
        ("options", options, Mapping | None, "{'tolerance': 1e-6}"),
    ):
        if not isinstance(thing, kinds):
            raise _unfit(what, choice, thing)
    effects = () if effects is None else effects
    changes, added = (effects, ()) if isinstance(effects, Mapping) else ({}, effects)
    added = tuple(added) if isinstance(added, Iterable) else (added,)
    if not all(isinstance(effect, Effect) for effect in added):
        raise _unfit("effects", "parameters {'viscosity.nu': 1e5}, or a list of Effects", effects)
    for name in {effect.name for effect in added}:
        if len([effect for effect in added if effect.name == name]) > 1:
            raise ConfigError(f"effects: {name} is listed twice")
    objects: dict[str, Any] = {"effects": added}
    if (initial := values.pop("initial", None)) is not None:
        (values if isinstance(initial, str | Path) else objects)["initial"] = initial
    for what, kind in (("stepper", Stepper), ("preconditioner", Preconditioner)):
        method = values.pop(what, None)
        if isinstance(method, type) and issubclass(method, kind):
            objects[what], values[what] = method, file_or_name(method)
        elif isinstance(method, str | Path):
            values[what] = str(method)
        elif method is not None:
            raise _unfit(what, "a name, a file or a class", method)
    if mesh is not None:
        of_mesh = {name: getattr(mesh, name) for name in ("ne", "np", "stretch", "spin")}
        of_mesh["centre_lon"], of_mesh["centre_lat"] = mesh.centre
        for name in [name for name in of_mesh if values.get(name) is not None]:
            raise ConfigError(f"{name} is given twice: as {name}, and by the mesh")
        values |= of_mesh
    tables = {SCENE: parameters or {}, STEPPER: options or {}}
    if said := [one for each in (changes, tables, settings) for one in read_settings(each)]:
        values["settings"] = said
    own = isinstance(scene, Scene)
    config = make_config(values | {"scene": scene.name if own else str(scene)})
    if own and config.settings_of(SCENE):
        raise ConfigError("alpha and parameters are for a scene by name: this one is built already")
    return config, objects


def _unfit(what: str, choice: str, thing: object, also: str = "") -> ConfigError:
    return ConfigError(f"{what}: give {choice}, got {shown(thing)}{also}")


def make_scene(
    config: RunConfig, own: Scene | None = None, effects: Iterable[Effect] = ()
) -> Scene:
    """Return the scene with the parameters and effects of the configuration.

    own: a scene in the place of the named one.  effects: further effects.  Raises ConfigError where
    there is no such scene, parameter or effect, or a value does not fit.
    """
    scene = own
    if scene is None:
        scene = get_scene(config.scene, **config.settings_of(SCENE))
        angle = scene.parameters.get("alpha")
        if isinstance(angle, float) and abs(angle) > 2.0 * math.pi:
            raise ConfigError(f"alpha={angle:g}: the angle is in radians, at most a whole turn")
    return reduce(Scene.with_effect, effects, apply_settings(scene, config.settings))


def shipped_solution(scene: Scene, days: float) -> Path | None:
    """Return the file of the solution of a scene at that day that comes with the package, if any.

    The scene has no exact solution and agrees with the scene of the file in all `DECISIVE`
    attributes; functions are compared on a grid of 2.5 degrees.
    """
    places = numpy.meshgrid(numpy.radians(numpy.r_[:360:2.5]), numpy.radians(numpy.r_[-90:90:73j]))
    for label, (name, settings) in SHIPPED.items():
        if scene.name != name or scene.exact is not None:
            continue
        from swe_sphere.io import reference_solution  # imports Warp

        if not (path := reference_solution.SHIPPED / f"{label}_day{days:g}.nc").exists():
            continue
        found = make_scene(make_config({"scene": name, "settings": settings}))
        pairs = [(getattr(found, name), getattr(scene, name)) for name in DECISIVE]
        if all(
            numpy.array_equal(a(*places), b(*places)) if callable(a) and callable(b) else a == b
            for a, b in pairs
        ):
            return path
    return None


def check_mesh(config: RunConfig, scene: Scene) -> dict[str, Any]:
    """Return the arguments of `Mesh.build` by name, without building the mesh.

    Raises ConfigError for numbers out of range, and a mesh too large for memory or small for ranks.
    """
    values: dict[str, Any] = {
        "ne": scene.ne if config.ne is None else config.ne,
        "np": scene.np if config.np is None else config.np, "radius": scene.planet.radius,
        "stretch": config.stretch, "centre": (config.centre_lon, config.centre_lat),
        "spin": config.spin,
    }  # fmt: skip
    check_ranks(values["ne"], world().size)
    check_memory(config, scene, values["ne"], values["np"])
    check_settings(**values)
    return values


MOST_ERROR_OF_AREA = 0.1
"""Largest relative error of the area of the sphere, as the sum of the nodal areas."""


def make_mesh(config: RunConfig, scene: Scene, made: Mesh | None = None) -> Mesh:
    """Return the mesh of the configuration, or the existing mesh `made` if it is the same.

    Raises the errors of `check_mesh`, and ConfigError if `made` is another mesh, or if the areas
    of the nodes of a strongly stretched mesh are not about those of the sphere.
    """
    values = check_mesh(config, scene)
    mesh = Mesh.build(**values) if made is None else made
    for name, value in values.items():
        if (other := getattr(mesh, name)) != value:
            raise ConfigError(
                f"the mesh has {name}={other!r}, and {scene.name} is to run with {name}={value!r}:"
                " build the mesh with this value"
            )
    share = mesh.area.sum() / (4.0 * math.pi * mesh.radius**2)
    if abs(share - 1.0) > MOST_ERROR_OF_AREA:
        raise ConfigError(
            f"stretch={mesh.stretch:g}, ne={mesh.ne}, np={mesh.np}: the areas of the nodes are"
            f" {share:.2g} of the sphere: take a larger ne or a smaller stretch"
        )
    return mesh


def stepper_options(kind: type["Stepper"], config: RunConfig) -> dict[str, Any]:
    """Return all options of a stepper: configured values, otherwise defaults.

    Raises ConfigError if the stepper has no such option, or the value does not fit.
    """
    known = inspect.signature(kind, eval_str=True).parameters
    # a default that depends on the scheme is an attribute of its class
    defaults = {name: getattr(kind, f"default_{name}", p.default) for name, p in known.items()}
    options = {k: value for k, value in defaults.items() if isinstance(value, int | float | str)}
    for name, value in config.settings_of(STEPPER).items():
        if name not in options:
            has = f"it has {', '.join(options)}" if options else "it has none"
            raise ConfigError(f"stepper {kind.name} has no option {name!r}; {has}")
        options[name] = convert(f"stepper {kind.name}: {name}", known[name].annotation, value)
    return options


MEMORY = read_toml(Path(__file__).with_name("memory.toml"))
"""Peak memory of runs, as measured (docs/results/performance.md)."""


def needed_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Return the approximate memory [bytes] of a run on a CPU, including the program.

    A Krylov basis of more than 14 vectors occupies more, float32 a little less.
    """
    from swe_sphere.steppers import get_stepper

    kind = get_stepper(config.stepper)
    nodes, rows = MEMORY["nodes"], MEMORY["bytes"]
    row = rows.get(kind.name, rows[kind.family])
    beyond = max(0, np - nodes[-1]) / (nodes[-1] - nodes[-2])
    node: float = numpy.interp(np, nodes, row) + beyond * (row[-1] - row[-2])
    node *= 1.0 + MEMORY["tracer"] * len(scene.tracers or ())
    if any(e.diffuses or e.name == "edge-penalty" for e in scene.effects):
        node += MEMORY["diffusion"]
    program: float = MEMORY["program"]
    return program + node * 6.0 * (ne * np) ** 2 + _memory_of_factors(config, scene, ne, np)


def _memory_of_factors(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Return the memory [bytes] of the factors of a preconditioner that is chosen by name, or 0."""
    from swe_sphere.solvers.preconditioners import PRECONDITIONERS

    named = str(config.chosen_preconditioner)
    kind = None if scene.wind is not None else PRECONDITIONERS.get(named)
    return 0.0 if kind is None else kind.memory_of_factors(6 * (ne * (np - 1)) ** 2 + 2, np)


def check_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> None:
    """Raise ConfigError for a run that needs more memory than is available."""
    needed, free = needed_memory(config, scene, ne, np), available_memory()
    if free is not None and needed > free:
        smaller = _memory_of_factors(config, scene, ne, np) > 0.0
        raise ConfigError(
            f"ne={ne} with np={np} and {config.stepper} needs about {needed / 2**30:.3g} GiB of"
            f" memory, and {free / 2**30:.3g} GiB are free: take a smaller ne"
            + (", or the preconditioner helmholtz" if smaller else "")
        )


DRIVER_MESSAGE = b"Could not find or load the NVIDIA CUDA driver"
"""Messages that Warp's native library writes to stderr on every machine without a GPU."""


def start_warp() -> None:
    """Import and initialise Warp, without its message that there is no GPU."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    if sys.stderr is None:  # the process was started without one
        wp.init()
        return
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            hint = ": set WARP_CACHE_PATH to a folder that can be written to"
            with translate_errors("compiled kernels cannot be kept", after=hint):
                wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            caught.seek(0)
            with suppress(OSError):  # stderr may be closed
                os.write(2, b"".join(line for line in caught if DRIVER_MESSAGE not in line))


class Initial:
    """A state from which a run begins.

    given: a file or a dataset of a run, or a function as `Scene.initial`.  day: time of the frame
    [days], the last one for None.  Raises ConfigError for another object, or without that frame.
    """

    origin, identity, history = "a function", "a function", ""
    """Origin, a name that equal states and all functions share, and the history of the file."""
    time_offset = 0.0
    """Time of the scene at the beginning of the run [s]."""

    def __init__(self, given: Any, day: float | None) -> None:
        import xarray as xr  # slow to import

        from swe_sphere.analysis.accessor import Analysis
        from swe_sphere.io.runfile import Nodal, RunFile

        self._given, self._points = given, numpy.empty(0)
        time = None if day is None else day * DAY
        if callable(given) and day is None:
            return
        run: Nodal
        if isinstance(given, xr.Dataset):
            name, run = "a dataset", Analysis(given).frames
        elif isinstance(given, str | Path):
            name, run = Path(given).name, RunFile(given)
        else:
            also = "" if day is None else "; initial-time chooses a frame of it"
            raise _unfit("initial", "a file, a dataset or a function", given, also)
        self._run, self._time, digest = run, run.frame_time(time), hashlib.sha256()
        self.time_offset = self._time + float(run.attributes.get("time_offset", 0.0))
        self._fields = {name: numpy.array(x) for name, x in run.frame(self._time).items()}
        for field, values in sorted(self._fields.items()):
            digest.update(field.encode() + numpy.ascontiguousarray(values).tobytes())
        self.origin, self.identity = f"{name} at day {self._time / DAY:g}", digest.hexdigest()[:16]
        self.history = str(run.attributes.get("history", ""))

    def begin(self, scene: Scene) -> Scene:
        """Return the scene with this initial state, and without exact solutions.

        Prescribed wind and forcing continue from the time of the frame.  A tracer that the frame
        lacks begins as in the scene.  ConfigError if depth or wind is lacking or not finite.
        """
        changes: dict[str, Any] = {"exact": None, "exact_tracers": None}
        if callable(self._given):
            return replace(scene, **changes | {"initial": self._given})
        fields, tracers = self._fields, dict(scene.tracers or {})
        known = {name: f"q_{name}" for name in tracers if f"q_{name}" in fields}
        for name in ("h", *(() if scene.wind else ("u", "v")), *known.values()):
            if name not in fields:
                _ = self._run.mesh  # refuses a file on a grid, of which no fields are read
                raise ConfigError(f"initial: {self.origin} lacks the field {name}: take another")
            if not numpy.isfinite(fields[name]).all():
                raise ConfigError(
                    f"initial: {name} is not finite in {self.origin}: take an earlier frame"
                    " (initial-time)"
                )
        bottom = scene.bottom if scene.effect("orography") else None
        changes["initial"] = partial(self._state, scene.wind is None, bottom)
        if known:
            changes["tracers"] = tracers | {k: partial(self._at, q) for k, q in known.items()}
        for name in ("wind", "forcing"):
            if (field := getattr(scene, name)) is not None:
                changes[name] = partial(self._later, field.function)
        return replace(scene, **changes)

    def _later(self, field: Callable[..., Any], lon: Array, lat: Array, t: float) -> Any:
        """Return a prescribed field at t [s] after the beginning of this run."""
        return field(lon, lat, t + self.time_offset)

    def _state(self, moves: bool, bottom: Any, lon: Array, lat: Array) -> tuple[Any, Any, Array]:
        """Return u, v [m s-1] and h [m] below the surface of the frame, above `bottom` if any.

        moves: False if the wind is prescribed.
        """
        u, v = self._at("wind", lon, lat) if moves else (0.0, 0.0)
        h = self._at("h", lon, lat)
        if "b" in self._fields:  # adds zero on the same mesh
            h = h + (self._at("b", lon, lat) - (bottom(lon, lat) if bottom else 0.0))
        return u, v, h

    def _at(self, name: str, lon: Array, lat: Array) -> Array:
        """Return a field at points [rad]."""
        points = numpy.array((lon, lat))
        if not numpy.array_equal(points, self._points):
            self._points, self._sampler = points, self._run.sampler(lon, lat)
        return evaluate(self._sampler, self._fields, name)
