"""A sweep while it goes on: standards, then the grid or the searches, all of it resumable."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from swe_sphere.equations.scene import Scene
from swe_sphere.simulation.interrupt import Interruption
from swe_sphere.studies.sweep.benches import Benches
from swe_sphere.studies.sweep.case import Case, Schedule
from swe_sphere.studies.sweep.contenders import Contender, contenders
from swe_sphere.studies.sweep.freshness import fresh, stale_note, sweep_sources
from swe_sphere.studies.sweep.header import write_header
from swe_sphere.studies.sweep.journal import RECORDS, Journal
from swe_sphere.studies.sweep.jury import Jury
from swe_sphere.studies.sweep.memory import settled_objects
from swe_sphere.studies.sweep.plan import SweepPlan
from swe_sphere.studies.sweep.runner import Runner
from swe_sphere.studies.sweep.search import Target, longest_accurate, longest_working
from swe_sphere.studies.sweep.standards import Standards
from swe_sphere.studies.sweep.truths import choose_truth
from swe_sphere.studies.sweep.watcher import SweepWatcher

__all__ = ["Campaign"]

STANDARDS = "converged"

SHORTEST = 64.0
"""A search for an error goes down to this part of the longest step or of the gravity limit."""
TRIAL_GROWTH = {True: 1.12, False: 2.0}
"""Between trials while a limit is sought: where theory names one, and where it names none."""
NEAR_BEST = 1.5
"""Runs up to so many times the time of the cheapest good one are timed again."""


class Campaign:
    """Carries out a plan in a folder; what the folder holds already is not made again.

    Raises ConfigError for a plan that cannot be carried out, or a folder of another scene.
    """

    def __init__(self, plan: SweepPlan, folder: Path, watcher: SweepWatcher) -> None:
        self._plan, self._watcher = plan, watcher
        self._benches = Benches(plan)
        scene = self._benches.first.scene
        days = scene.days if plan.days is None else plan.days
        self._schedule = Schedule.of(days, plan.report_days)
        truth = choose_truth(
            scene, self._schedule.report_days, plan.reference, plan.finer, self._benches.largest_ne
        )
        self._sources = sweep_sources(plan.scene, scene, truth)
        self._journal = self._begun(folder, scene)
        self._interruption = Interruption()
        self._runner = Runner(
            self._journal, self._sources, self._interruption, watcher, plan.time_limit
        )
        self._jury = Jury(
            plan,
            self._benches,
            truth,
            Standards(self._runner, folder / STANDARDS, self._schedule, truth.name),
        )

    def _begun(self, folder: Path, scene: Scene) -> Journal:
        """The journal with the plan noted in it; the user is told what of it counts no more."""
        journal = Journal(folder / RECORDS)
        stale = stale_note(journal.records, self._sources)
        write_header(journal, self._plan, scene, self._sources)
        if stale:
            self._watcher.note(f"{folder}: {stale}")
        return journal

    @property
    def has_runs(self) -> bool:
        """Whether the journal holds any run of these sources."""
        records = fresh(self._journal.records, self._sources)
        return any(record["record"] == "run" for record in records)

    def run(self) -> None:
        """Make all runs that are still missing.

        Raises:
            Interrupted: the user asked to stop; all finished runs are kept.
            RunFailed: the disk does not take the results.
        """
        benches = self._benches.all()
        everyone = contenders(self._plan, benches, self._schedule, self._jury.names)
        with settled_objects(), self._interruption:
            for bench in benches:
                self._jury.same_mesh(bench)
            if self._plan.target_error is None:
                self._grid(everyone)
            else:
                self._search(everyone, self._plan.target_error)
            if self._plan.find_limit:
                for contender in everyone:
                    self._find_limit(contender)

    # --- grid

    def _grid(self, everyone: list[Contender]) -> None:
        cases = [case for contender in everyone for case in contender.cases(self._plan)]
        self._watcher.expect(len(cases) * self._plan.repeats)
        self._repeat(cases)

    def _repeat(self, cases: list[Case]) -> None:
        """Rounds through all cases, so that a busy moment of the machine meets many of them."""
        for repeat in range(self._plan.repeats):
            for case in _ordered(cases):
                self._make(case, repeat)

    def _make(self, case: Case, repeat: int) -> None:
        """One run; what failed the first time is not tried again."""
        first = self._runner.known(case)
        if repeat and first is not None and first["row"]["status"] != "completed":
            self._watcher.done(case, first)
            return
        self._runner.run(case, None if repeat else self._jury, repeat)

    # --- the longest stable step

    def _find_limit(self, contender: Contender) -> None:
        if contender.refusal is not None:
            return
        limit, longest = contender.stable_dt, contender.longest
        known = math.isfinite(limit)
        guess = limit if known else 8.0 * contender.bench.limits.gravity
        shortest = min(guess, contender.bench.limits.gravity) / 8.0
        ends: set[str] = set()

        def works(dt: float) -> bool:
            self._watcher.expect(1)
            status = self._runner.run(contender.trial(dt))["row"]["status"]
            ends.add(status)
            return bool(status == "completed")

        growth = TRIAL_GROWTH[known]
        found = longest_working(works, guess, shortest, longest, growth=growth)
        hurried = " (some trials ran out of time)" if "timed-out" in ends else ""
        self._watcher.note(_limit_found(contender, found, longest) + hurried)

    # --- the longest step with an error

    def _search(self, everyone: list[Contender], target: float) -> None:
        for contender in everyone:
            cases: dict[str, Case] = {}
            found = self._longest_accurate(contender, target, cases)
            if found.dt is None:
                self._watcher.note(f"{contender.label}: {found.reason}")
                continue
            good = self._worth_timing(cases.values(), target)
            self._watcher.expect(len(good) * (self._plan.repeats - 1))
            self._repeat(good)

    def _longest_accurate(
        self, contender: Contender, target: float, cases: dict[str, Case]
    ) -> Target:
        """Search along the step; the runs made are left in `cases`."""
        if contender.refusal is not None:
            return Target(None, contender.refusal)

        def error(dt: float) -> float:
            case = contender.case(dt, role="target")
            if case.key not in cases:
                self._watcher.expect(1)
                cases[case.key] = case
            return self._error(self._runner.run(case, self._jury))

        longest = min(contender.ladder(1)[0], contender.schedule.interval)
        shortest = min(longest, contender.bench.limits.gravity) / SHORTEST
        return longest_accurate(error, target, longest, shortest)

    def _worth_timing(self, cases: Iterable[Case], target: float) -> list[Case]:
        """The good runs that may turn out to be the cheapest."""
        records = {case: self._runner.known(case) for case in cases}
        walls = {
            case: float(record["row"]["wall_seconds"])
            for case, record in records.items()
            if record is not None and self._error(record) <= target
        }
        best = min(walls.values(), default=math.inf)
        return [case for case, wall in walls.items() if wall <= NEAR_BEST * best]

    def _error(self, record: dict[str, Any]) -> float:
        """The error at the end of a run that the plan's target speaks of; infinite if it failed."""
        plan, end = self._plan, self._schedule.report_days[-1]
        found = {entry["kind"]: entry for entry in record["errors"] if entry["day"] == end}
        kind = plan.target_kind
        if kind == "auto":
            kind = "total" if found.get("total", {}).get(plan.target_field) else "time"
        value = found.get(kind, {}).get(plan.target_field, {}).get(plan.target_norm)
        return math.inf if value is None else float(value)


def _ordered(cases: list[Case]) -> list[Case]:
    """Round the contenders: first the longest step of each, then the next."""
    rank: dict[tuple[int, object, object], int] = {}
    placed = []
    for number, case in enumerate(cases):
        who = (id(case.bench), case.config.stepper, case.config.preconditioner)
        rank[who] = rank.get(who, -1) + 1
        placed.append((rank[who], number, case))
    return [case for _, _, case in sorted(placed, key=lambda item: item[:2])]


def _limit_found(contender: Contender, found: float | None, longest: float) -> str:
    if found is None:
        return f"{contender.label}: no step gets to the end"
    if found >= longest:
        return f"{contender.label}: stable at every step up to {longest:.4g} s"
    gravity = found / contender.bench.limits.gravity
    return f"{contender.label}: longest stable step {found:.4g} s, {gravity:.3g} gravity limits"
