"""Build scene, mesh and model of a run, once, from its configuration and the user's objects."""

from __future__ import annotations

import inspect
import math
import os
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy

from swe_sphere.equations.effects import Effect
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError, shown
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.files.user_file import guarded
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.planet import DAY
from swe_sphere.ranks.communicator import world
from swe_sphere.ranks.limits import available_memory
from swe_sphere.settings.values import SCENE, STEPPER, convert, read_settings
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.diagnostics import Snapshot, load_diagnostics
from swe_sphere.simulation.restart import (
    OF_ONE_RUN,
    adopt,
    check_identity,
    check_paths,
    identity,
    read_restart,
)
from swe_sphere.testcases import get_scene

if TYPE_CHECKING:
    from swe_sphere.io.checkpoint import Checkpoint
    from swe_sphere.io.reference_solution import Reference
    from swe_sphere.solvers.preconditioners import Preconditioner
    from swe_sphere.steppers import Stepper, Trajectory


class Setup:
    """Everything of a run that stays the same while it is stepped; cheap checks come first.

    Args:
        config: all settings and names.
        scene, mesh, stepper, preconditioner: objects in the place of the named ones.
        effects: further effects of the scene.
        checkpoint: the state to resume from, where it has been read already.

    Raises ConfigError where the run cannot be made.
    """

    def __init__(
        self,
        config: RunConfig,
        scene: Scene | None = None,
        mesh: Mesh | None = None,
        stepper: type[Stepper] | None = None,
        preconditioner: type[Preconditioner] | None = None,
        effects: Iterable[Effect] = (),
        checkpoint: Checkpoint | None = None,
    ) -> None:
        from swe_sphere.steppers import get_stepper

        if checkpoint is None and config.restart is not None:
            checkpoint = read_restart(config)
        self.config = config = config if checkpoint is None else adopt(config, checkpoint)
        self.checkpoint = checkpoint
        """The state that the run resumes from."""
        self.kind = get_stepper(stepper or config.stepper)
        """The class of the stepper."""
        self.scene = make_scene(config, scene, effects)
        self.mesh = make_mesh(config, self.scene, mesh)
        self.identity = identity(config, self.scene, self.mesh)
        """All that a run must share with this one to resume it."""
        self.comm = world()
        """The ranks of the run."""
        self.comm.on_root(lambda: check_paths(config))
        if checkpoint is not None:
            check_identity(config, checkpoint, self.identity)
        self.reference: Reference | None = None
        """The solution at the end of the run."""
        if config.reference is not None:
            from swe_sphere.io.reference_solution import Reference  # needs scipy's splines

            self.reference = Reference(config.reference)
        if config.days is not None:
            self.check_reference(config.days)
        for path in config.diagnostics:
            load_diagnostics(path)
        self._preconditioner = preconditioner
        self.options = stepper_options(self.kind, config)
        """Options of the stepper by name."""
        start_warp()  # takes its time
        from swe_sphere.equations.model import Model

        self.scene.check_answers(self.mesh.lon, self.mesh.lat)
        launch = config.device, config.precision, config.launch
        self.model = Model(self.mesh, self.scene, *launch, comm=self.comm)
        """The compiled right-hand side."""
        self.has_other_code = (
            checkpoint is not None and checkpoint.attributes.get("code") != code_fingerprint()
        )
        """Whether other code of this package wrote the state that the run resumes from."""
        self.limit: float | None = None
        """The stability limit [s], once it has been computed."""

    def check_reference(self, days: float) -> None:
        """Raise ConfigError if the reference is of another time than the end of the run [days]."""
        time = None if self.reference is None else self.reference.nearest(None)
        if time is not None and abs(time - days * DAY) > 1.0:
            raise ConfigError(
                f"{self.config.reference} is of day {time / DAY:g}, the run ends at day {days:g}:"
                f" take days={time / DAY:g} or another reference"
            )

    def new_stepper(self, dt: float) -> Trajectory:
        """Return the stepper of the configuration with steps of dt [s]."""
        from swe_sphere.steppers.adaptive import AdaptiveSteps

        options = dict(self.options)
        if self._preconditioner is not None:
            options["preconditioner"] = self._preconditioner
        stepper = self.kind(self.model, dt, **options)
        if self.config.adaptive is None:
            return stepper
        return AdaptiveSteps(stepper, self.config.adaptive)

    @property
    def initial(self) -> Snapshot:
        """The initial state of the scene, built anew each time."""
        return Snapshot(self.model, self.model.initial_state(), 0.0)

    def stable_dt(self) -> float:
        """Return the stability limit at the initial state [s], about; infinite if there is none.

        Raises ConfigError where the stepper does not return a number.
        """
        if self.limit is None:
            counted = dict(self.model.counters)
            spectrum = self.kind.spectrum(self.model, self.model.initial_state())
            self.model.counters.update(counted)  # evaluations of the estimate are none of the run
            label = f"stable_dt of stepper {self.kind.name}"
            limit = guarded(label, self.kind.limit, spectrum)
            self.limit = float(convert(label, float, limit, finite=False))
        return self.limit

    @cached_property
    def gravity_limit(self) -> float:
        """1 over the spectral radius of waves at the initial state [s]."""
        radius = self.model.spectrum(self.model.initial_state()).wave
        return 1.0 / radius if radius > 0.0 else math.inf


def read_setup(
    scene: Any,
    *,
    mesh: Any = None,
    effects: Any = (),
    parameters: Mapping[str, object] | None = None,
    options: Mapping[str, object] | None = None,
    settings: object = (),
    resumed: tuple[Path, Checkpoint] | None = None,
    **values: Any,
) -> Setup:
    """Return the set-up in the arguments of `Simulation`; resumed: from which file, and its state.

    Raises ConfigError where an object is not of the requested kind, an argument belongs elsewhere,
    or two arguments contradict each other.
    """
    from swe_sphere.solvers.preconditioners import Preconditioner
    from swe_sphere.steppers import Stepper

    for name in OF_ONE_RUN.keys() & values.keys():
        raise ConfigError(f"{name} is no setting of a simulation: see {OF_ONE_RUN[name]}")
    if not isinstance(scene, Scene | str | Path):
        raise _unfit("scene", "a name, a file or a Scene", scene)
    if not isinstance(mesh, Mesh | None):
        raise _unfit("mesh", "a Mesh", mesh)
    examples = ("parameters", "{'alpha': 0.8}"), ("options", "{'tolerance': 1e-6}")
    for (what, example), table in zip(examples, (parameters, options), strict=True):
        if not isinstance(table, Mapping | None):
            raise _unfit(what, example, table)
    changes, added = (effects, ()) if isinstance(effects, Mapping) else ({}, effects)
    added = tuple(added) if isinstance(added, Iterable) else (added,)
    if not all(isinstance(effect, Effect) for effect in added):
        raise _unfit("effects", "parameters {'viscosity.nu': 1e5}, or a list of Effects", effects)
    objects: dict[str, Any] = {"mesh": mesh, "effects": added}
    for what, kind in (("stepper", Stepper), ("preconditioner", Preconditioner)):
        method = values.pop(what, None)
        if isinstance(method, type) and issubclass(method, kind):
            objects[what], values[what] = method, method.name
        elif isinstance(method, str | Path):
            values[what] = str(method)
        elif method is not None:
            raise _unfit(what, "a name, a file or a class", method)
    if mesh is not None:
        of_mesh = {name: getattr(mesh, name) for name in ("ne", "np", "stretch", "spin")}
        of_mesh["centre_lon"], of_mesh["centre_lat"] = mesh.centre
        for name in of_mesh.keys() & values.keys():
            raise ConfigError(f"{name} is given twice: as {name}, and by the mesh")
        values |= of_mesh
    tables = {SCENE: parameters or {}, STEPPER: options or {}}
    if said := [one for each in (changes, tables, settings) for one in read_settings(each)]:
        values["settings"] = said
    if resumed is not None:
        values["restart"], objects["checkpoint"] = resumed
    if not isinstance(scene, Scene):
        return Setup(make_config(values | {"scene": str(scene)}), **objects)
    config = make_config(values | {"scene": scene.name})
    if config.alpha is not None or config.settings_of(SCENE):
        raise ConfigError("alpha and parameters are for a scene by name: this one is made already")
    return Setup(config, scene, **objects)


def _unfit(what: str, choice: str, thing: object) -> ConfigError:
    return ConfigError(f"{what}: give {choice}, not {shown(thing)}")


def make_scene(
    config: RunConfig, own: Scene | None = None, effects: Iterable[Effect] = ()
) -> Scene:
    """Return the scene with the parameters and effects of the configuration.

    own: a scene in the place of the named one.  effects: further effects.  Raises ConfigError where
    there is no such scene, parameter or effect, or a value does not fit.
    """
    scene = own
    if scene is None:
        parameters = config.settings_of(SCENE)
        if config.alpha is not None:
            if "alpha" in parameters:
                raise ConfigError("alpha is given twice: by alpha and by set scene.alpha")
            parameters["alpha"] = config.alpha
        scene = get_scene(config.scene, **parameters)
        angle = scene.parameters.get("alpha")
        if isinstance(angle, float) and abs(angle) > 2.0 * math.pi:
            raise ConfigError(f"alpha={angle:g}: the angle is in radians, at most a whole turn")
    scene = apply_settings(scene, config.settings)
    for effect in effects:
        scene = scene.with_effect(effect)
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


def stepper_options(kind: type[Stepper], config: RunConfig) -> dict[str, Any]:
    """Return all options of a stepper: as configured, and else their defaults.

    Raises ConfigError where the stepper has no such option, or the value does not fit.
    """
    known = inspect.signature(kind, eval_str=True).parameters
    # a default that depends on the scheme is an attribute of its class
    defaults = {name: getattr(kind, f"default_{name}", p.default) for name, p in known.items()}
    options: dict[str, Any] = {
        name: default
        for name, default in defaults.items()
        if isinstance(default, (bool, int, float, str))
    }
    given = config.settings_of(STEPPER)
    for name in ("preconditioner", "tolerance"):
        value = getattr(config, name)
        if value is not None and name in given:
            raise ConfigError(f"{name} is given twice: by {name} and by set stepper.{name}")
        given |= {} if value is None else {name: value}
    for name, value in given.items():
        if name not in options:
            has = f"it has {', '.join(options)}" if options else "implicit steppers have some"
            raise ConfigError(f"stepper {kind.name} has no option {name!r}; {has}")
        options[name] = convert(f"stepper {kind.name}: {name}", known[name].annotation, value)
    return options


MEMORY = tomllib.loads(Path(__file__).with_name("memory.toml").read_text("utf-8"))
"""Peak memory of runs, as measured (docs/memory.md)."""


def needed_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Return about how much memory [bytes] a run on a CPU occupies, the program included.

    A Krylov basis of more than 14 vectors occupies more, float32 a little less.
    """
    from swe_sphere.steppers import get_stepper

    kind = get_stepper(config.stepper)
    nodes, rows = MEMORY["nodes"], MEMORY["bytes"]
    row = rows.get(kind.name, rows[kind.family])
    beyond = max(0, np - nodes[-1]) / (nodes[-1] - nodes[-2])
    node: float = numpy.interp(np, nodes, row) + beyond * (row[-1] - row[-2])
    node *= 1.0 + MEMORY["tracer"] * len(scene.tracers or ())
    node += MEMORY["diffusion"] if any(effect.diffuses for effect in scene.effects) else 0.0
    program: float = MEMORY["program"]
    return program + node * 6.0 * (ne * np) ** 2 + _memory_of_factors(config, scene, ne, np)


def _memory_of_factors(config: RunConfig, scene: Scene, ne: int, np: int) -> float:
    """Return the memory [bytes] of the factors of a preconditioner by name."""
    from swe_sphere.solvers.preconditioners import PRECONDITIONERS

    named = config.settings_of(STEPPER).get("preconditioner", config.preconditioner)
    kind = None if scene.wind is not None else PRECONDITIONERS.get(str(named))
    return 0.0 if kind is None else kind.memory_of_factors(6 * (ne * (np - 1)) ** 2 + 2, np)


def check_memory(config: RunConfig, scene: Scene, ne: int, np: int) -> None:
    """Raise ConfigError for a run that the system would end because it exhausts the memory."""
    needed, free = needed_memory(config, scene, ne, np), available_memory()
    if free is not None and needed > free:
        smaller = _memory_of_factors(config, scene, ne, np) > 0.0
        raise ConfigError(
            f"ne={ne} with np={np} and {config.stepper} needs about {needed / 2**30:.3g} GiB of"
            f" memory, and {free / 2**30:.3g} GiB are free: take a smaller ne"
            + (", or the preconditioner helmholtz" if smaller else "")
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
