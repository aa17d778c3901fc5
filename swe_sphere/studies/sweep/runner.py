"""Makes the runs of a sweep one after the other, unless the journal has them already."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from swe_sphere.simulation.interrupt import Interruption
from swe_sphere.studies.sweep.case import Case
from swe_sphere.studies.sweep.execute import Outcome, execute, warm_up
from swe_sphere.studies.sweep.freshness import fresh
from swe_sphere.studies.sweep.journal import Journal
from swe_sphere.studies.sweep.record import Verdict, calibration_record, run_record
from swe_sphere.studies.sweep.watcher import SweepWatcher

__all__ = ["Judge", "Runner"]

Judge = Callable[[Case, Outcome], Verdict]
"""Takes the errors of a run."""

EVERY = 2.0
"""Seconds between two looks at how fast the machine is."""


class Runner:
    """Runs cases; every one ends as a record in the journal before the next begins.

    sources: of what the runs are made; what the journal has of others is not known here.
    """

    def __init__(
        self,
        journal: Journal,
        sources: Mapping[str, str],
        interruption: Interruption,
        watcher: SweepWatcher,
        time_limit: float | None,
    ) -> None:
        self._journal, self._interruption = journal, interruption
        self._watcher, self._time_limit = watcher, time_limit
        self._sources = {"sources": dict(sources)}
        runs = [r for r in fresh(journal.records, sources) if r["record"] == "run"]
        self._known = {(run["key"], run["repeat"]): run for run in runs}
        self._warm: dict[tuple[object, ...], float] = {}
        self._calibrated: dict[int, float] = {}

    def known(self, case: Case, repeat: int = 0) -> dict[str, Any] | None:
        """The record of a run that need not be made again.

        One that ran out of time counts only if it would again.
        """
        record = self._known.get((case.key, repeat))
        if record is None or record["row"]["status"] != "timed-out":
            return record
        had, has = record.get("time_limit"), self._time_limit
        return record if has is not None and had is not None and has <= had else None

    def run(self, case: Case, judge: Judge | None = None, repeat: int = 0) -> dict[str, Any]:
        """The record of a run: the known one, or that of a new run.

        judge: takes its errors.

        Raises:
            Interrupted: the user asked to stop.
            RunFailed: the journal cannot be written.
        """
        record = self.known(case, repeat)
        if record is None:
            outcome = self.outcome(case, self._time_limit)
            record = self.keep(case, outcome, judge(case, outcome) if judge else {}, repeat)
        self._watcher.done(case, record)
        return record

    def outcome(self, case: Case, time_limit: float | None = None) -> Outcome:
        """Make a run, warm, with a look at the machine before it."""
        self._interruption.check()
        self._watcher.begin(case)
        compiled = self._warmed(case)
        self._calibrate(case)
        outcome = execute(case, self._interruption, time_limit, self._watcher.tick)
        if "compile_seconds" in outcome.numbers:
            outcome.numbers["compile_seconds"] += compiled
        return outcome

    def keep(self, case: Case, outcome: Outcome, verdict: Verdict, repeat: int) -> dict[str, Any]:
        """Write a run into the journal."""
        record = run_record(case, repeat, outcome, verdict) | {"time_limit": self._time_limit}
        self._journal.append(record | self._sources)
        kept = self._journal.records[-1]
        self._known[case.key, repeat] = kept
        return kept

    def _warmed(self, case: Case) -> float:
        """Seconds of compiling for this kind of run, in the first of which it is done."""
        config = case.config
        kind = (id(case.bench), config.stepper, config.preconditioner)
        if kind in self._warm or case.refusal is not None:
            return 0.0
        self._warm[kind] = warm_up(case)
        return self._warm[kind]

    def _calibrate(self, case: Case) -> None:
        """Time right-hand sides now and then on every mesh."""
        now, bench = time.perf_counter(), case.bench
        if case.refusal is None and now - self._calibrated.get(id(bench), -EVERY) >= EVERY:
            self._journal.append(calibration_record(case, bench.time_rhs()) | self._sources)
            self._calibrated[id(bench)] = now
