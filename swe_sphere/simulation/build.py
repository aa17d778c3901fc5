"""Build scene, mesh and model of a run, once, from its configuration and the user's objects."""

from __future__ import annotations

import inspect
import math
import os
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy

from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError, shown
from swe_sphere.files.user_file import guarded
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.ranks.communicator import world
from swe_sphere.ranks.memory import available_memory
from swe_sphere.settings.values import SCENE, STEPPER, convert, read_settings
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.diagnostics import Fields, ReferenceErrors, Snapshot, load_diagnostics
from swe_sphere.simulation.restart import (
    adopt,
    check_identity,
    check_paths,
    code_warnings,
    identity,
    read_restart,
)
from swe_sphere.testcases import get_scene

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.io.checkpoint import Checkpoint
    from swe_sphere.steppers import Stepper, Trajectory

Name = str | Path | None


@dataclass(frozen=True)
class Inputs:
    """A configuration, and the objects that stand behind its names; None where a name counts."""

    config: RunConfig
    scene: Scene | None = None
    mesh: Mesh | None = None
    stepper: Any = None
    """A class of steppers, or a stepper on a model of its own."""
    preconditioner: Any = None
    """A class of preconditioners."""
    effects: tuple[Effect, ...] = ()
    """Effects to add to the scene."""
    checkpoint: Checkpoint | None = None
    """The state to resume from, where it has been read already."""


def read_inputs(
    scene: Any,
    *,
    stepper: Any = None,
    mesh: Any = None,
    preconditioner: Any = None,
    effects: Any = (),
    parameters: Mapping[str, object] | None = None,
    options: Mapping[str, object] | None = None,
    settings: object = (),
    **fields: Any,
) -> Inputs:
    """Return the inputs in the arguments of `Simulation`.

    Raises:
        ConfigError: an object is not of the requested kind, or two arguments contradict each other.
    """
    _expect(isinstance(scene, Scene | str | Path), "scene", "a name, a file or a Scene", scene)
    _expect(isinstance(mesh, Mesh | None), "mesh", "a Mesh", mesh)
    changes, added = (effects, ()) if isinstance(effects, Mapping) else ({}, _listed(effects))
    choice = "parameters {'viscosity.nu': 1e5}, or a list of Effects"
    _expect(all(isinstance(effect, Effect) for effect in added), "effects", choice, effects)
    _expect(isinstance(parameters, Mapping | None), "parameters", "{'alpha': 0.8}", parameters)
    _expect(isinstance(options, Mapping | None), "options", "{'tolerance': 1e-6}", options)
    _check_methods(stepper, preconditioner)
    if not isinstance(stepper, Name | type):
        more = mesh or preconditioner or changes or added or parameters or options or settings
        decided = any(fields.get(name) is not None for name in DECIDED)
        _check_model(stepper, str(getattr(scene, "name", scene)), decided or bool(more))
        mesh = stepper.model.mesh
    of_mesh = {} if mesh is None else _settings_of_mesh(mesh)
    for name in of_mesh.keys() & fields.keys():
        raise ConfigError(f"{name} is given twice: as {name}, and by the mesh")
    named = {"scene": scene, "stepper": stepper, "preconditioner": preconditioner}
    names = {
        what: str(thing if isinstance(thing, Name) else thing.name)
        for what, thing in named.items()
        if thing is not None
    }
    tables = {SCENE: parameters or {}, STEPPER: options or {}}
    said = (*read_settings(changes), *read_settings(tables), *read_settings(settings))
    config = make_config({**names, **({"settings": said} if said else {}), **of_mesh, **fields})
    objects = {what: thing for what, thing in named.items() if not isinstance(thing, Name)}
    if "scene" in objects and (config.alpha is not None or config.settings_of(SCENE)):
        raise ConfigError("alpha and parameters are for a scene by name: this one is made already")
    return Inputs(config, mesh=mesh, effects=added, **objects)


def _expect(fits: bool, what: str, choice: str, thing: object) -> None:
    if not fits:
        raise ConfigError(f"{what}: give {choice}, not {shown(thing)}")


def _listed(effects: Any) -> tuple[Any, ...]:
    return tuple(effects) if isinstance(effects, Iterable) else (effects,)


def _check_methods(stepper: Any, preconditioner: Any) -> None:
    """Raise ConfigError for what is neither a name nor a class, or a stepper."""
    if not isinstance(stepper, Name):
        from swe_sphere.steppers import Stepper

        fits = isinstance(stepper, Stepper) or _is_kind(stepper, Stepper)
        _expect(fits, "stepper", "a name, a file, a class or a Stepper", stepper)
    if not isinstance(preconditioner, Name):
        from swe_sphere.solvers.preconditioners import Preconditioner

        fits = _is_kind(preconditioner, Preconditioner)
        _expect(fits, "preconditioner", "a name, a file or a class", preconditioner)


def _is_kind(thing: object, kind: type) -> bool:
    return isinstance(thing, type) and issubclass(thing, kind)


DECIDED = (
    "adaptive", "adaptive_by", "alpha", "device", "dt", "launch", "precision", "tolerance",
    "tracer_steps",
)  # fmt: skip
"""Fields of a configuration that are decided where a stepper and its model are made."""


def _check_model(stepper: Stepper, scene: str, more: bool) -> None:
    own = stepper.model.scene.name
    if more or (own != scene and not scene.endswith((".py", ".toml"))):
        raise ConfigError(
            f"the stepper has a model of its own, of {own}: give this scene, and leave out mesh,"
            f" preconditioner, effects, parameters, options, settings, {', '.join(DECIDED)}"
        )


def _settings_of_mesh(mesh: Mesh) -> dict[str, float]:
    lon, lat = mesh.centre
    return {"ne": mesh.ne, "np": mesh.np, "stretch": mesh.stretch, "spin": mesh.spin,
            "centre_lon": lon, "centre_lat": lat}  # fmt: skip


class Setup:
    """Everything of a run that stays the same while it is stepped; cheap checks come first.

    Raises:
        ConfigError: the inputs cannot be run, in one line.
    """

    def __init__(self, inputs: Inputs) -> None:
        from swe_sphere.steppers import Stepper, get_stepper

        config, checkpoint = inputs.config, inputs.checkpoint
        if checkpoint is None and config.restart is not None:
            checkpoint = read_restart(config)
        self.config = config = config if checkpoint is None else adopt(config, checkpoint)
        self.checkpoint = checkpoint
        """The state that the run resumes from."""
        method = inputs.stepper
        self.instance: Stepper | None = method if isinstance(method, Stepper) else None
        """A stepper on a model of its own, in the place of a new one."""
        self.kind = type(self.instance) if self.instance else get_stepper(method or config.stepper)
        """The class of the stepper."""
        if self.instance is None:
            self.scene = make_scene(config, inputs.scene, inputs.effects)
        else:
            self.scene = self.instance.model.scene
        self.mesh = make_mesh(config, self.scene, inputs.mesh)
        self.identity = identity(config, self.scene, self.mesh)
        """All that a run must share with this one to resume it."""
        self.comm = world()
        """The ranks of the run."""
        self.comm.on_root(lambda: check_paths(config))
        if checkpoint is not None:
            check_identity(config, checkpoint, self.identity)
        self.reference = (
            None if config.reference is None
            else ReferenceErrors(config.reference, self.scene.error_field)
        )  # fmt: skip
        if config.days is not None:
            self.check_reference(config.days)
        for path in config.diagnostics:
            load_diagnostics(path)
        self._preconditioner = inputs.preconditioner
        self.options = {} if self.instance else stepper_options(self.kind, config)
        """Options of the stepper by name."""
        self.model = (
            self.instance.model if self.instance else make_model(config, self.scene, self.mesh)
        )
        self.warnings = code_warnings(config, checkpoint)
        """What the user should know before the run."""
        self.limits: dict[str, float] = {}
        """Limits of the step that have been computed so far [s]."""

    def check_reference(self, days: float) -> None:
        """Raise ConfigError if the reference is of another time than the end of the run [days]."""
        if self.reference is not None:
            self.reference.check(days)

    def new_stepper(self, dt: float, cycle: int = 1) -> Trajectory:
        """Return the stepper of the configuration with steps of dt [s].

        cycle: steps of the flow for one step of the tracers.
        """
        from swe_sphere.steppers.adaptive import AdaptiveSteps
        from swe_sphere.steppers.tracer_steps import CarriedTracers, CarriedWithDepth

        options = dict(self.options)
        if self._preconditioner is not None:
            options["preconditioner"] = self._preconditioner
        if cycle > 1 and self.scene.wind is not None:
            return CarriedWithDepth(self.model, self.kind, dt, cycle)
        if cycle > 1:
            return CarriedTracers(self.model, self.kind(self.model.carrier, dt, **options), cycle)
        stepper = self.kind(self.model, dt, **options)
        if self.config.adaptive is None:
            return stepper
        return AdaptiveSteps(stepper, self.config.adaptive, self.config.adaptive_by)

    @property
    def initial(self) -> Snapshot:
        """The initial state of the scene, built anew each time."""
        return Snapshot(self.model, self.model.initial_state(), 0.0)

    @property
    def start(self) -> Fields:
        """All fields of the initial state of the scene, each (N,)."""
        return self.initial.with_constants

    def stable_dt(self) -> float:
        """Return the stability limit at the initial state [s], about; infinite if there is none.

        Raises:
            ConfigError: the stepper does not return a number.
        """
        if "stable" not in self.limits:
            counted = dict(self.model.counters)
            spectrum = self.kind.spectrum(self.model, self.model.initial_state())
            self.model.counters.update(counted)  # evaluations of the estimate are none of the run
            label = f"stable_dt of stepper {self.kind.name}"
            limit = guarded(label, self.kind.limit, spectrum)
            self.limits["stable"] = float(convert(label, float, limit, finite=False))
        return self.limits["stable"]

    def gravity_limit(self) -> float:
        """Return 1 over the spectral radius of waves at the initial state [s]."""
        if "gravity" not in self.limits:
            radius = self.model.spectrum(self.model.initial_state()).wave
            self.limits["gravity"] = 1.0 / radius if radius > 0.0 else math.inf
        return self.limits["gravity"]


def make_scene(
    config: RunConfig, own: Scene | None = None, effects: Iterable[Effect] = ()
) -> Scene:
    """Return the scene with the parameters and effects of the configuration.

    own: a scene in the place of the named one.  effects: further effects.

    Raises:
        ConfigError: there is no such scene, parameter or effect, or a value does not fit.
    """
    scene = _named_scene(config) if own is None else own
    scene = apply_settings(scene, config.settings)
    for effect in effects:
        scene = scene.with_effect(effect)
    return scene


def _named_scene(config: RunConfig) -> Scene:
    parameters = config.settings_of(SCENE)
    if config.alpha is not None:
        if "alpha" in parameters:
            raise ConfigError("alpha is given twice: by alpha and by set scene.alpha")
        parameters["alpha"] = config.alpha
    scene = get_scene(config.scene, **parameters)
    angle = scene.parameters.get("alpha")
    if isinstance(angle, float) and abs(angle) > 2.0 * math.pi:
        raise ConfigError(f"alpha={angle:g}: the angle is in radians, at most a whole turn")
    return scene


def make_mesh(config: RunConfig, scene: Scene, made: Mesh | None = None) -> Mesh:
    """Return the mesh of the configuration, or the given one once it is checked.

    Raises ConfigError for a number out of range, and for a mesh that memory cannot hold, that has
    too few elements for the ranks, or that is of another planet.
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
    centre = config.centre_lon, config.centre_lat
    return Mesh.build(
        ne, np, radius=scene.planet.radius, stretch=config.stretch, centre=centre, spin=config.spin
    )


def make_model(config: RunConfig, scene: Scene, mesh: Mesh) -> Model:
    """Return the compiled right-hand side.

    Raises ConfigError for a device that is not there, or a function of the scene that fails.
    """
    start_warp()  # takes its time: after the cheap checks
    from swe_sphere.equations.model import Model

    scene.check_answers(mesh.lon, mesh.lat)
    return Model(mesh, scene, config.device, config.precision, config.launch, comm=world())


def stepper_options(kind: type[Stepper], config: RunConfig) -> dict[str, Any]:
    """Return all options of a stepper: as configured, and else their defaults.

    Raises:
        ConfigError: the stepper has no such option, or the value does not fit.
    """
    known = inspect.signature(kind, eval_str=True).parameters
    # a default that depends on the scheme is an attribute of its class
    defaults = {
        name: getattr(kind, f"default_{name}", parameter.default)
        for name, parameter in known.items()
    }
    options: dict[str, Any] = {
        name: default
        for name, default in defaults.items()
        if isinstance(default, (bool, int, float, str))
    }
    flags = {"preconditioner": config.preconditioner, "tolerance": config.tolerance}
    given = {name: value for name, value in flags.items() if value is not None}
    settings = config.settings_of(STEPPER)
    for name in given.keys() & settings.keys():
        raise ConfigError(f"{name} is given twice: by {name} and by set stepper.{name}")
    for name, value in (given | settings).items():
        if name not in options:
            has = f"it has {', '.join(options)}" if options else "implicit steppers have some"
            raise ConfigError(f"stepper {kind.name} has no option {name!r}; {has}")
        options[name] = convert(f"stepper {kind.name}: {name}", known[name].annotation, value)
    return options


PROGRAM = 2.5e8
"""Memory [bytes] of the interpreter, the libraries and compiled kernels."""
NODES = (3, 4, 6, 8, 12)
BYTES = {
    "explicit": (480, 545, 645, 710, 790),
    "imex": (1850, 1930, 2850, 2550, 3250),
    "exponential": (740, 910, 1120, 1280, 1650),
    "implicit": (1500, 1600, 2250, 2000, 2700),
    "gauss-legendre": (2000, 2100, 2900, 2700, 3600),
}
"""Peak memory [bytes] an element node of runs of williamson5, by family or name of the stepper and
for the number of nodes on an edge in `NODES` (docs/memory.md)."""
TRACER = 0.05
"""Memory of a tracer, as a part of the memory of a run without."""
DIFFUSION = 200.0
"""Additional memory [bytes] an element node with viscosity or hyperviscosity."""


def needed_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Return about how much memory [bytes] a run on a CPU occupies, the program included.

    A Krylov basis of more than 14 vectors occupies more, float32 a little less.
    """
    from swe_sphere.steppers import get_stepper

    kind = get_stepper(config.stepper)
    row = BYTES.get(kind.name, BYTES[kind.family])
    beyond = max(0, np - NODES[-1]) / (NODES[-1] - NODES[-2])
    node = float(numpy.interp(np, NODES, row)) + beyond * (row[-1] - row[-2])
    node *= 1.0 + TRACER * len(scene.tracers or ())
    node += DIFFUSION if any(effect.diffuses for effect in scene.effects) else 0.0
    return PROGRAM + node * 6.0 * (ne * np) ** 2 + _memory_of_factors(config, scene, ne, np)


def _memory_of_factors(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Those of the preconditioner [bytes], if it is one by name."""
    named = config.settings_of(STEPPER).get("preconditioner", config.preconditioner)
    if named is None or scene.wind is not None:
        return 0.0
    from swe_sphere.solvers.preconditioners import PRECONDITIONERS

    kind = PRECONDITIONERS.get(str(named))
    return 0.0 if kind is None else kind.memory_of_factors(6 * (ne * (np - 1)) ** 2 + 2, np)


def check_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> None:
    """Raise ConfigError for a run that the system would end because it exhausts the memory."""
    needed, free = needed_memory(config, scene, ne, np), available_memory()
    if free is not None and needed > free:
        factors = _memory_of_factors(config, scene, ne, np) > 0.0
        raise ConfigError(
            f"ne={ne} with np={np} and {config.stepper} needs about {needed / 2**30:.3g} GiB of"
            f" memory, and {free / 2**30:.3g} GiB are free: take a smaller ne"
            + (", or the preconditioner helmholtz" if factors else "")
        )


EXPECTED = b"Could not find or load the NVIDIA CUDA driver"
"""What Warp's native library writes to stderr on every machine without a GPU."""


def start_warp() -> None:
    """Import and initialise Warp, without its message that there is no GPU."""
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
