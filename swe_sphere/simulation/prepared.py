"""A simulation before its first step: what is run, and how its steps are planned."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import HOUR
from swe_sphere.ranks.communicator import world
from swe_sphere.settings.values import convert
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import load_diagnostics
from swe_sphere.simulation.restart import (
    adopt,
    check_identity,
    check_paths,
    code_warnings,
    read_restart,
)
from swe_sphere.simulation.setup import identity, make_mesh, make_model
from swe_sphere.simulation.snapshot import Fields, ReferenceErrors, Snapshot
from swe_sphere.simulation.supplied import Supplied
from swe_sphere.simulation.time_plan import (
    StepChoice,
    accurate_step,
    choose_step,
    longest_step,
    stepper_options,
)

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.io.checkpoint import Checkpoint
    from swe_sphere.steppers import Stepper


ROUNDING = 1.0 + 1e-9
LONGEST_OF_TRACERS = 3.0 * HOUR
"""An automatic step of tracers in a flow that is stepped, which changes meanwhile, is no longer
[s]."""


class Prepared:
    """Scene, mesh, model and the method of stepping, of a configuration; cheap checks come first.

    supplied: objects that stand behind names of the configuration.  checkpoint: what the run goes
    on from, where it has been read already.

    Raises:
        ConfigError: whatever cannot be done as asked for.
    """

    def __init__(
        self, config: RunConfig, supplied: Supplied, checkpoint: Checkpoint | None = None
    ) -> None:
        from swe_sphere.steppers import get_stepper

        if checkpoint is None and config.restart is not None:
            checkpoint = read_restart(config)
        config = config if checkpoint is None else adopt(config, checkpoint)
        self.config, self._supplied, self._checkpoint = config, supplied, checkpoint
        self.configured = config
        """What it was made from; `config` has also what the present run is asked for."""
        self.scene: Scene = supplied.scene_of(config)
        self._kind = supplied.kind or get_stepper(config.stepper)
        self.mesh: Mesh = make_mesh(config, self.scene, supplied.mesh)
        self.identity = identity(config, self.scene, self.mesh)
        """All that a run must share with this one to go on where it stopped."""
        self.comm = world()
        """The ranks of the run."""
        self.comm.on_root(lambda: check_paths(config))
        if checkpoint is not None:
            check_identity(config, checkpoint, self.identity)
        self._reference = self._read_reference()
        if config.days is not None:
            self._check_reference()
        for path in config.diagnostics:
            load_diagnostics(path)
        self.options: dict[str, Any] = {}
        """What the stepper is built with, by names."""
        if supplied.instance is None:
            self.options = stepper_options(self._kind, config)
            self.model: Model = make_model(config, self.scene, self.mesh)
        else:
            self.model = supplied.instance.model
        self.warnings = code_warnings(config, checkpoint)
        """What the user should know before the run."""

    def _read_reference(self) -> ReferenceErrors | None:
        if self.config.reference is None:
            return None
        return ReferenceErrors(self.config.reference, self.scene.error_field)

    def _check_reference(self) -> None:
        """ConfigError if the reference is of another time than the end of the run."""
        if self._reference is not None:
            self._reference.check(self.days)

    @property
    def days(self) -> float:
        """Length of the whole run [days], as configured or as the scene recommends."""
        return self.scene.days if self.config.days is None else self.config.days

    @property
    def initial(self) -> Snapshot:
        """The scene's own start, also where the run begins later; made anew each time."""
        return Snapshot(self.model, self.model.initial_state(), 0.0)

    @property
    def start(self) -> Fields:
        """All fields at the scene's own start, each (N,); made anew each time."""
        return self.initial.with_constants

    @cached_property
    def stable_dt(self) -> float:
        """Largest stable step at the start [s], about; infinite if there is none.

        Raises:
            ConfigError: the stepper does not return a number.
        """
        counted = dict(self.model.counters)
        spectrum = self._kind.spectrum(self.model, self.model.initial_state())
        self.model.counters.update(counted)  # whenever it is asked for, it is no part of the run
        limit = self._kind.limit(spectrum)
        return float(convert(f"stable_dt of stepper {self._kind.name}", float, limit, finite=False))

    @cached_property
    def gravity_limit(self) -> float:
        """1 over the spectral radius at the start [s]: the longest step of leapfrog, about."""
        radius = self.model.spectrum(self.model.initial_state()).wave
        return 1.0 / radius if radius > 0.0 else math.inf

    def _choice(self) -> StepChoice:
        """The step that the configuration asks for, or else leaves to be chosen."""
        config, days = self.config, self.days or 1.0
        asked = None if config.dt == "auto" else config.dt
        if config.adaptive is not None and asked is None:
            return longest_step(config, days)
        fields, kind = self.initial.fields, self._kind
        accurate = accurate_step(kind, self.mesh, fields)
        # the limit of a fluid at rest, whose wind is yet to come, says nothing of its waves
        cautious = kind.family == "imex" and not (fields["u"].any() or fields["v"].any())
        limit = self.stable_dt
        if asked is None and not limit > 0.0:
            raise ConfigError(
                f"the stability limit of {kind.name} is {limit:g} s: choose a step with --dt"
            )
        return choose_step(asked, days, limit, kind.safety, accurate, cautious)

    def _tracer_steps(self, dt: float) -> int:
        """Steps of dt [s] for one of the tracers: as asked for, or the most that may be.

        Raises ConfigError where that is too many, or where tracers cannot take their own.
        """
        from swe_sphere.steppers.tracer_steps import tracer_limit, why_not

        asked, adaptive = self.config.tracer_steps, self.config.adaptive is not None
        if asked == 1 or self._supplied.instance is not None:
            return 1
        reason = "steps follow their error" if adaptive else why_not(self.model, self._kind)
        if reason and asked != "auto":
            raise ConfigError(f"tracer-steps={asked}: {reason}; leave tracer-steps out")
        limit = 0.0 if reason else tracer_limit(self.model)
        if asked == "auto":
            longest = min(limit, LONGEST_OF_TRACERS if self.scene.wind is None else math.inf)
            return max(1, int(longest / dt)) if math.isfinite(longest) else 1
        if asked * dt > limit * ROUNDING:
            raise ConfigError(
                f"tracer-steps={asked}: the longest step of the tracers is {limit:.4g} s; of"
                f" {dt:.4g} s take {max(1, int(limit / dt))} at once at the most"
            )
        return asked

    def _new_stepper(self, dt: float, cycle: int) -> Stepper:
        """The stepper of the configuration, with steps that follow their error if it says so.

        cycle: steps for one of the tracers.
        """
        from swe_sphere.steppers.adaptive import AdaptiveStepper
        from swe_sphere.steppers.tracer_steps import CarriedTracers, CarriedWithDepth

        config, made = self.config, self._supplied.preconditioner
        options = self.options if made is None else {**self.options, "preconditioner": made}
        if cycle > 1 and self.scene.wind is not None:
            return CarriedWithDepth(self.model, self._kind, dt, cycle)
        if cycle > 1:
            return CarriedTracers(self.model, self._kind(self.model.carrier, dt, **options), cycle)
        stepper = self._kind(self.model, dt, **options)
        if config.adaptive is None:
            return stepper
        return AdaptiveStepper(stepper, config.adaptive, config.adaptive_by)
