"""Writes a run down while it goes on: frames, series of numbers, checkpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import clear_errors
from swe_sphere.files.fingerprints import code_fingerprint
from swe_sphere.simulation.restart import COUNTER
from swe_sphere.simulation.running import Running
from swe_sphere.simulation.time_plan import TimePlan

if TYPE_CHECKING:
    from swe_sphere.io.netcdf import FrameWriter

SAMPLES = 200
"""About how many times the numbers are sampled in a run."""


def most_samples(plan: TimePlan, done: int) -> int:
    """How many samples a run takes at the most, of which so many steps lie behind."""
    ahead = plan.steps - done
    return min(ahead, ahead // plan.frame_steps + ahead // _interval(plan) + 3) + 1


def _interval(plan: TimePlan) -> int:
    """Steps between samples."""
    return plan.cycle * max(1, plan.steps // (plan.cycle * SAMPLES))


class Recorder:
    """Samples a run and writes all that it sees, by the writer that rank 0 has."""

    def __init__(self, sim: Running, writer: FrameWriter) -> None:
        self._plan, self._writer = sim.plan, writer
        self._every = _interval(sim.plan)
        self._framed: int | None = None

    def due(self, step: int) -> bool:
        """At frames, and in between about `SAMPLES` times a run."""
        return self._plan.is_frame(step) or step % self._every == 0

    def observe(self, sim: Running) -> None:
        """Sample, and write a frame if one is due."""
        if self._plan.is_frame(sim.steps):
            self.frame(sim)
            return
        time, numbers = sim.time, sim.diagnostics
        sim.comm.on_root(lambda: self._writer.record(time, numbers))

    def frame(self, sim: Running) -> None:
        """Sample, and write a frame and a checkpoint, unless there is a frame of this step."""
        if self._framed == sim.steps:
            return
        numbers, fields = sim.diagnostics, sim.snapshot.all_fields | sim.own_fields
        self._framed = sim.steps
        time, dt, arrays, name = sim.time, self._plan.dt, restart_arrays(sim), sim.config.stepper

        def write() -> None:
            self._writer.write(time, fields, numbers)
            self._writer.checkpoint(arrays, dt * sim.steps, sim.steps, name)

        sim.comm.on_root(write)


def attributes_of(sim: Running) -> dict[str, object]:
    """The resolved configuration of a simulation, for its files."""
    return {
        "references": sim.scene.reference,
        **sim.identity,
        **sim.method(),
        "identity": sim.identity,
        "code": code_fingerprint(),
        "configuration": sim.config.model_dump(mode="json"),
        "stepper_options": sim.options,
        "days": sim.days,
        "start_step": sim.steps,
        **_plot_field(sim.scene, sim.config.fields),
    }


def _plot_field(scene: Scene, fields: Sequence[str]) -> dict[str, str]:
    """What a picture shows unless it is told: the first tracer where the air only carries it.

    Of a file that lacks this, and else depth, the first of the fields that it has.
    """
    carried = scene.tracers if scene.wind is not None else None
    usual = f"q_{next(iter(carried))}" if carried else "h"
    if fields and usual not in fields:
        return {"plot_field": fields[0]}
    return {"plot_field": usual} if carried else {}


def restart_arrays(sim: Running) -> Mapping[str, NDArray[np.generic]]:
    """What a bitwise exact restart needs, with the counters, so that two parts count like one."""
    counters = {f"{COUNTER}{name}": np.array(n) for name, n in sim.counts().items()}
    return sim.stepper.state_dict() | counters


def save(sim: Running, path: Path) -> Path:
    """Write a checkpoint of the simulation as it stands, in a file of its own.

    Raises:
        ConfigError: there is something else already.
        RunFailed: the disk refuses.
    """
    from swe_sphere.io.checkpoint import Checkpoint, is_checkpoint, write_checkpoint
    from swe_sphere.io.layout import attribute

    attributes = {name: attribute(value) for name, value in attributes_of(sim).items()}
    arrays = dict(restart_arrays(sim))
    time, name = sim.plan.dt * sim.steps, sim.config.stepper
    checkpoint = Checkpoint(arrays, time, sim.steps, name, attributes)

    def write() -> None:
        if path.exists() and not is_checkpoint(path):
            raise ConfigError(f"{path} is there already, and no checkpoint: choose another name")
        with clear_errors(f"cannot write {path}", RunFailed):
            write_checkpoint(path, checkpoint)

    sim.comm.on_root(write)
    return path
