"""A simulation before its first step: what is run, and how its steps are planned."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

from swe_sphere.equations.scene import Scene
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import load_diagnostics
from swe_sphere.simulation.evaluator import ReferenceErrors
from swe_sphere.simulation.output import check_paths
from swe_sphere.simulation.restart import adopt, check_identity, code_warnings, read_restart
from swe_sphere.simulation.setup import identity, make_mesh, make_model
from swe_sphere.simulation.snapshot import Fields, Snapshot
from swe_sphere.simulation.stepping import (
    StepChoice,
    accurate_step,
    choose_step,
    longest_step,
    stepper_options,
)
from swe_sphere.simulation.supplied import Supplied

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model
    from swe_sphere.io.checkpoint import Checkpoint
    from swe_sphere.steppers import Stepper


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
        self.scene: Scene = supplied.scene_of(config)
        self._kind = supplied.kind or get_stepper(config.stepper)
        self.mesh: Mesh = supplied.mesh or make_mesh(config, self.scene)
        check_paths(config)
        if checkpoint is not None:
            check_identity(config, checkpoint, self.identity)
        self._reference = self._read_reference()
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

    @cached_property
    def identity(self) -> dict[str, object]:
        """All that a run must share with this one to go on where it stopped."""
        return identity(self.config, self.scene, self.mesh)

    def _read_reference(self) -> ReferenceErrors | None:
        if self.config.reference is None:
            return None
        return ReferenceErrors(self.config.reference, self.scene.error_field, self.days)

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
        """Largest stable step at the start [s], about; infinite if there is none."""
        counted = dict(self.model.counters)
        spectrum = self._kind.spectrum(self.model, self.model.initial_state())
        self.model.counters.update(counted)  # whenever it is asked for, it is no part of the run
        return self._kind.limit(spectrum)

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
        return choose_step(asked, days, self.stable_dt, kind.safety, accurate, cautious)

    def _new_stepper(self, dt: float) -> Stepper:
        """The stepper of the configuration, with steps that follow their error if it says so."""
        from swe_sphere.steppers.adaptive import AdaptiveStepper

        config, made = self.config, self._supplied.preconditioner
        options = self.options if made is None else {**self.options, "preconditioner": made}
        stepper = self._kind(self.model, dt, **options)
        if config.adaptive is None:
            return stepper
        return AdaptiveStepper(stepper, config.adaptive, config.adaptive_by)
