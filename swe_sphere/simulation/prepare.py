"""From a configuration to a run that is ready for its first step; cheap checks come first."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.fingerprints import code_fingerprint
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.output import appends, check_out
from swe_sphere.simulation.plan import TimePlan, continued_plan, time_plan
from swe_sphere.simulation.restart import (
    adopt,
    carried_counts,
    check_identity,
    check_step,
    code_warnings,
)
from swe_sphere.simulation.sampler import ReferenceErrors
from swe_sphere.simulation.setup import identity, make_mesh, make_model, make_scene
from swe_sphere.simulation.stepping import (
    StepChoice,
    accurate_step,
    choose_step,
    longest_step,
    stepper_options,
)
from swe_sphere.user_file import users_code

if TYPE_CHECKING:
    import warp as wp

    from swe_sphere.equations.model import Model
    from swe_sphere.io.checkpoint import Checkpoint
    from swe_sphere.steppers import Stepper

__all__ = ["Prepared", "prepare"]

PICTURES = (".png", ".pdf", ".svg")


@dataclass(frozen=True)
class Prepared:
    """A run before its first step."""

    config: RunConfig
    """As asked for, with what a restart file adds."""
    days: float
    """Length of the whole run [days]."""
    scene: Scene
    model: Model
    stepper: Stepper
    options: dict[str, Any]
    """What the stepper was built with."""
    plan: TimePlan
    dt_rule: str
    """How the step was chosen, in words."""
    stable_dt: float
    """Largest stable step at the start [s], about."""
    counts: dict[str, float]
    """Counters of the part of the run before a restart."""
    before: dict[str, int]
    """Counters of the model before the run, which do not belong to it."""
    reference: ReferenceErrors | None
    warnings: tuple[str, ...] = ()
    """What the user should know before the run."""

    def attributes(self) -> dict[str, object]:
        """The resolved configuration, for the file."""
        config, scene = self.config, self.scene
        return {
            "title": scene.title,
            "references": scene.reference,
            **identity(config, scene, self.model.mesh),
            "identity": identity(config, scene, self.model.mesh),
            "code": code_fingerprint(),
            "stepper": config.stepper,
            "configuration": config.model_dump(mode="json"),
            "scheme": self.stepper.name,
            "stepper_options": self.options,
            "dt": self.plan.dt,
            "dt_rule": self.dt_rule,
            "stable_dt": self.stable_dt,
            "days": self.days,
            "device": self.model.device,
            "launch": self.model.shape,
            "start_step": self.stepper.steps,
            **_plot_field(scene),
        }


def _plot_field(scene: Scene) -> dict[str, str]:
    """What a picture shows unless it is told: the first tracer where the air only carries it."""
    if scene.wind is None or not scene.tracers:
        return {}
    return {"plot_field": f"q_{next(iter(scene.tracers))}"}


def prepare(config: RunConfig) -> Prepared:
    """Everything up to the first step.

    Raises:
        ConfigError: whatever cannot be done as asked for.
    """
    checkpoint = None if config.restart is None else _read(config)
    config = config if checkpoint is None else adopt(config, checkpoint)
    scene = make_scene(config)
    days = scene.days if config.days is None else config.days
    mesh = make_mesh(config, scene)
    _check_paths(config)
    check_out(config)
    if checkpoint is not None:
        check_identity(config, checkpoint, identity(config, scene, mesh))
    reference = _reference(config, scene, days)
    prepared = _built(config, days, scene, mesh, checkpoint, reference)
    if checkpoint is None:
        return prepared
    return replace(prepared, warnings=code_warnings(config, checkpoint))


def _built(
    config: RunConfig,
    days: float,
    scene: Scene,
    mesh: Mesh,
    checkpoint: Checkpoint | None,
    reference: ReferenceErrors | None,
) -> Prepared:
    from swe_sphere.steppers import get_stepper

    kind = get_stepper(config.stepper)
    options = stepper_options(kind, config)
    model = make_model(config, scene, mesh)
    state = model.initial_state()
    spectrum = kind.spectrum(model, state)
    stable_dt = kind.stable_dt(spectrum.wave, spectrum.dissipation)
    asked = None if config.dt == "auto" else config.dt
    accurate = accurate_step(mesh, model.fields(state))
    choice = choose_step(asked, days, stable_dt, kind.safety, accurate)
    if config.adaptive is not None and asked is None:
        choice = longest_step(config, days)
    plan, dt_rule = _plan(config, days, checkpoint, choice)
    before = dict(model.counters)
    with users_code():
        stepper = _adapted(config, kind(model, plan.dt, **options))
        counts = _begin(stepper, state, checkpoint)
    return Prepared(
        config, days, scene, model, stepper, options, plan, dt_rule, stable_dt, counts, before,
        reference,
    )  # fmt: skip


def _adapted(config: RunConfig, stepper: Stepper) -> Stepper:
    """The stepper, with steps that follow their error where that is asked for."""
    from swe_sphere.steppers.adaptive import AdaptiveStepper

    if config.adaptive is None:
        return stepper
    return AdaptiveStepper(stepper, config.adaptive, config.adaptive_by)


def _plan(
    config: RunConfig, days: float, checkpoint: Checkpoint | None, choice: StepChoice
) -> tuple[TimePlan, str]:
    """The plan and the rule of its step, which a restarted run takes from the file."""
    if checkpoint is None:
        return time_plan(days, config.every, choice.dt), choice.rule
    dt = check_step(config, checkpoint)
    return continued_plan(days, config.every, dt, checkpoint.steps), "that of the restart file"


def _begin(stepper: Stepper, state: wp.array, checkpoint: Checkpoint | None) -> dict[str, float]:
    """Start from the state, or restore from the checkpoint and return its counters."""
    if checkpoint is None:
        stepper.start(state)
        return {}
    counts = carried_counts(checkpoint)
    stepper.load_state_dict(checkpoint.memory, checkpoint.steps)
    return counts


def _read(config: RunConfig) -> Checkpoint:
    from swe_sphere.io.checkpoint import read_checkpoint

    place = config.out if appends(config) else config.restart
    assert place is not None
    return read_checkpoint(place)


def _reference(config: RunConfig, scene: Scene, days: float) -> ReferenceErrors | None:
    if config.reference is None:
        return None
    return ReferenceErrors(config.reference, scene.error_field, days)


def _check_paths(config: RunConfig) -> None:
    """Complain of a place that cannot be written to before anything is computed."""
    for name, path in (("out", config.out), ("plot", config.plot)):
        if path is not None:
            _check_path(name, path)

    if config.plot is not None and config.plot.suffix.lower() not in PICTURES:
        raise ConfigError(f"plot: {config.plot} must end in {', '.join(PICTURES)}")


def _check_path(name: str, path: Path) -> None:
    if path.is_dir():
        raise ConfigError(f"{name}: {path} is a folder: give the name of a file in it")
    if not path.parent.is_dir():
        raise ConfigError(f"{name}: there is no folder {path.parent}: make it first")
    target = path if path.exists() else path.parent
    if not os.access(target, os.W_OK):
        raise ConfigError(f"{name}: {target} cannot be written to: choose another place")
