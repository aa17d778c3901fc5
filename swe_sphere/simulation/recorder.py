"""Writes a run down while it goes on: frames, series of numbers, checkpoints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swe_sphere.simulation.restart import restart_arrays
from swe_sphere.simulation.time_plan import TimePlan

if TYPE_CHECKING:
    from swe_sphere.io.netcdf import FrameWriter
    from swe_sphere.simulation.running import Running

__all__ = ["Recorder", "most_samples"]

SAMPLES = 200
"""About how many times the numbers are sampled in a run."""


def most_samples(plan: TimePlan, done: int) -> int:
    """How many samples a run takes at the most, of which so many steps lie behind."""
    ahead = plan.steps - done
    return min(ahead, ahead // plan.frame_steps + ahead // _interval(plan) + 3) + 1


def _interval(plan: TimePlan) -> int:
    """Steps between samples."""
    return max(1, plan.steps // SAMPLES)


class Recorder:
    """Samples a run and writes all that it sees."""

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
        else:
            self._writer.record(sim.time, sim.diagnostics)

    def frame(self, sim: Running) -> None:
        """Sample, and write a frame and a checkpoint, unless there is a frame of this step."""
        if self._framed == sim.steps:
            return
        numbers, fields = sim.diagnostics, sim.snapshot.all_fields | sim.own_fields
        self._framed = sim.steps
        self._writer.write(sim.time, fields, numbers)
        dt, name = self._plan.dt, sim.config.stepper
        self._writer.checkpoint(restart_arrays(sim), dt * sim.steps, sim.steps, name)
