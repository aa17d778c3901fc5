"""The runs that others are judged by: converged in time, and on a finer mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from swe_sphere.simulation.plan import TimePlan
from swe_sphere.studies.sweep.bench import Bench, Fields
from swe_sphere.studies.sweep.case import Case, Schedule
from swe_sphere.studies.sweep.execute import Outcome
from swe_sphere.studies.sweep.fields import load_fields, save_fields
from swe_sphere.studies.sweep.judge import Errors, field_errors
from swe_sphere.studies.sweep.record import Verdict
from swe_sphere.studies.sweep.runner import Judge, Runner

if TYPE_CHECKING:
    from swe_sphere.steppers import Stepper

__all__ = ["Standards"]

LONGEST = 2.8
"""Step, in gravity limits, that stands for the stability limit of an implicit converged run."""
FINER = ("rk4", 0.85)
"""Stepper of the finer run, and its step as a part of its stability limit."""

History = dict[float, Fields]
"""Fields by report day."""


class Standards:
    """Makes standard runs, keeps their fields in the folder, and reads them again.

    A standard run has no time limit; where it fails there is a row that tells why, and None here.
    """

    def __init__(self, runner: Runner, folder: Path, schedule: Schedule, truth: str) -> None:
        """truth: name of what the total errors are taken against."""
        self._runner, self._folder, self._schedule = runner, folder, schedule
        self._judges = ("standard", truth)

    def converged(self, bench: Bench, stepper: str, part: float, total: Judge) -> History | None:
        """A run converged in time: its step is that part of the stability limit.

        A run of twice the step tells by Richardson's rule how large its own error in time is; the
        rows of both hold these errors, and those that `total` finds.
        """
        kind = _stepper(stepper)
        limit = min(bench.stable_dt(kind), LONGEST * bench.limits.gravity)
        twice = self._schedule.steps(2.0 * part * limit)
        coarse, fine = (self._case(bench, stepper, steps) for steps in (twice, _halved(twice)))
        if self._runner.known(fine) is None or load_fields(self._file(fine)) is None:
            self._compare(coarse, fine, kind.order, total)
        return self._found(fine)

    def finer(self, bench: Bench) -> History | None:
        """A run on a finer mesh, for the total error."""
        stepper, part = FINER
        steps = self._schedule.steps(part * bench.stable_dt(_stepper(stepper)))
        return self._single(self._case(bench, stepper, steps))

    def _case(self, bench: Bench, stepper: str, steps: TimePlan) -> Case:
        config = bench.config.model_copy(update={"stepper": stepper})
        return Case(bench, config, self._schedule, steps, role="converged", judges=self._judges)

    def _file(self, case: Case) -> Path:
        return self._folder / f"{case.key}.nc"

    def _compare(self, coarse: Case, fine: Case, order: int, total: Judge) -> None:
        """Make both runs and keep what each says of the other."""
        outcomes = {case: self._runner.outcome(case) for case in (coarse, fine)}
        truth = outcomes[fine].snapshots
        apart = {
            day: field_errors(fine.bench, fields, truth[day])
            for day, fields in outcomes[coarse].snapshots.items()
            if day in truth
        }
        parts = {coarse: 1.0, fine: 1.0 / 2.0**order}
        share = 1.0 / (1.0 - 2.0**-order)
        for case, outcome in outcomes.items():
            time = {day: _scaled(errors, share * parts[case]) for day, errors in apart.items()}
            self._keep(case, outcome, {"time": time} | total(case, outcome))

    def _single(self, case: Case) -> History | None:
        if self._runner.known(case) is None or load_fields(self._file(case)) is None:
            self._keep(case, self._runner.outcome(case), {})
        return self._found(case)

    def _keep(self, case: Case, outcome: Outcome, verdict: Verdict) -> None:
        """Fields first: what the journal knows of has been written."""
        if outcome.status == "completed":
            save_fields(self._file(case), outcome.snapshots, case.label)
        if self._runner.known(case) is None:
            self._runner.keep(case, outcome, verdict, 0)

    def _found(self, case: Case) -> History | None:
        record = self._runner.known(case)
        assert record is not None
        return load_fields(self._file(case)) if record["row"]["status"] == "completed" else None


def _stepper(name: str) -> type[Stepper]:
    from swe_sphere.steppers import get_stepper

    return get_stepper(name)


def _halved(steps: TimePlan) -> TimePlan:
    return replace(
        steps, dt=0.5 * steps.dt, steps=2 * steps.steps, frame_steps=2 * steps.frame_steps
    )


def _scaled(errors: Errors, factor: float) -> Errors:
    return {name: {n: factor * x for n, x in norms.items()} for name, norms in errors.items()}
