"""Writes a run down while it goes on: frames, series of numbers, checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.simulation.plan import TimePlan
from swe_sphere.simulation.sampler import Sampler
from swe_sphere.simulation.snapshot import Moment

if TYPE_CHECKING:
    from swe_sphere.io.netcdf import FrameWriter

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
    """Samples a run and, where there is a file, writes all that it sees.

    counts: gives the counters of the run so far; they travel with the checkpoints, so that a run
    in two parts counts like one.
    """

    def __init__(
        self,
        sampler: Sampler,
        plan: TimePlan,
        writer: FrameWriter | None,
        stepper: str,
        counts: Callable[[], Mapping[str, float]],
    ) -> None:
        self._sampler, self._plan, self._writer = sampler, plan, writer
        self._stepper, self._counts = stepper, counts
        self._every = _interval(plan)
        self._framed: int | None = None
        self.latest: dict[str, float] = {}
        """The numbers sampled last."""

    def due(self, step: int) -> bool:
        """At frames, and in between about `SAMPLES` times a run; without a file only at the end."""
        return self._writer is not None and (self._plan.is_frame(step) or step % self._every == 0)

    def observe(self, moment: Moment) -> None:
        """Sample, and write a frame if one is due."""
        if self._plan.is_frame(moment.step):
            self.frame(moment)
            return
        self.latest = self._sampler(moment)
        if self._writer is not None:
            self._writer.record(moment.time, self.latest)

    def frame(self, moment: Moment) -> None:
        """Sample, and write a frame and a checkpoint, unless there is a frame of this step."""
        if self._framed == moment.step:
            return
        self.latest = self._sampler(moment)
        self._framed = moment.step
        if self._writer is None:
            return
        self._writer.write(moment.time, moment.all_fields, self.latest)
        counters = {f"counter_{name}": np.array(n) for name, n in self._counts().items()}
        memory = moment.memory() | counters
        self._writer.checkpoint(memory, self._plan.dt * moment.step, moment.step, self._stepper)
