"""A sweep while it goes on: reference runs, then the grid or the searches, all of it resumable."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from itertools import zip_longest
from pathlib import Path

from swe_sphere.equations.scene import Scene
from swe_sphere.simulation.loop import Interruption
from swe_sphere.studies.jobs import Tell, in_processes
from swe_sphere.studies.sweep.errors import Evaluator, choose_reference, sweep_sources
from swe_sphere.studies.sweep.record import RunRecord, current, header_of, note_plan, runs_of
from swe_sphere.studies.sweep.runner import Runner
from swe_sphere.studies.sweep.runs import (
    Discretisations,
    Integrator,
    RunSpec,
    integrators,
    users_methods,
)
from swe_sphere.studies.sweep.steps import Target, longest_accurate, longest_working
from swe_sphere.studies.sweep.sweep_plan import SweepPlan
from swe_sphere.studies.sweep.watcher import SweepWatcher

CONVERGED = "converged"
"""Folder of the fields of reference runs."""

SHORTEST = 64.0
"""A search for an error goes down to this part of the longest step or of the gravity limit."""
TRIAL_GROWTH = {True: 1.12, False: 2.0}
"""Between trials while a limit is sought: where theory names one, and where it names none."""
DEAR = 5.0
"""Where a run costs so many times as much as one that is good enough, shorter steps are tried only
if it was cheaper than the one before: solvers that struggle with long steps are."""
AGREE = 0.03
"""Runs are repeated until their two shortest times differ by at most this part of the shorter,"""
MOST_REPEATS = 3
"""and at most so many times as often as the plan says."""
SEARCHING = 0.7
"""Part of a budget for searches; the rest is for repeats."""
NEAR_BEST = 1.5
"""Runs up to so many times the time of the cheapest good one are timed again."""


Part = tuple[str, int, int, int | None]
"""Runs that one process makes one after the other: what they are for (grid, search or limit), the
number of their integrator, and the first and the one after the last of its grid."""


class BudgetSpent(Exception):
    """The budget of a search is used up."""


class Sweep:
    """Carries out a plan in a folder; what the folder holds already is not made again.

    Raises ConfigError for a plan that cannot be carried out, or a folder of another scene.
    """

    def __init__(
        self,
        plan: SweepPlan,
        folder: Path,
        watcher: SweepWatcher,
        own: Scene | None = None,
        tell: Tell | None = None,
    ) -> None:
        """tell: passes records on to the process that keeps them, beside which this one runs."""
        self._plan, self._folder, self._watcher = plan, folder, watcher
        self._spaces = Discretisations(plan, own)
        total = choose_reference(self._spaces)
        common = sweep_sources(self._spaces, total)
        self._sources = common | users_methods(plan.steppers, plan.preconditioner)
        self._store = runs_of(folder, tell)
        if tell is None:
            header = header_of(plan, self._spaces.scene, self._sources)
            if stale := note_plan(folder, self._store.records, header):
                watcher.note(stale)
        self._least: dict[object, float] = {}
        self._target = plan.target_error or 0.0
        self._interruption = Interruption()
        self._runner = Runner(
            self._store, common, self._interruption, watcher, plan.time_limit,
            plan.jobs if tell else 1,
        )  # fmt: skip
        self._evaluator = Evaluator(self._spaces, total, self._runner, folder / CONVERGED)

    @property
    def has_runs(self) -> bool:
        """Whether there is a record of any run of these sources."""
        return bool(current(self._store.records, self._sources))

    def run(self) -> None:
        """Make all runs that are still missing.

        Raises:
            Interrupted: the user asked to stop; all finished runs are kept.
            RunFailed: the disk does not take the results.
        """
        everyone = self._everyone
        with _settled_objects(), self._interruption:
            for space in self._spaces.all():
                self._evaluator.converged(space)
            if self._plan.jobs > 1:
                self._beside()
            if self._plan.target_error is None:
                self._grid([run for each in everyone for run in each.grid(self._plan)])
            else:
                self._search(everyone)
            if self._plan.find_limit:
                for integrator in everyone:
                    self._find_limit(integrator)

    @cached_property
    def _everyone(self) -> list[Integrator]:
        return integrators(self._spaces, self._evaluator.names)

    # --- in processes beside each other

    def _beside(self) -> None:
        """Have all runs made by others: from here on they are known."""
        plan = self._plan
        for record in in_processes(plan.jobs, making_parts, (plan, self._folder), self._parts()):
            self._watcher.beside(self._runner.take(record))

    def _parts(self) -> list[Part]:
        """All parts; the shortest steps come first, so that nobody is left with them at the end."""
        found: list[Part] = []
        for n, integrator in enumerate(self._everyone):
            if self._plan.find_limit:
                found.append(("limit", n, 0, None))
            if self._plan.target_error is not None:
                found.append(("search", n, 0, None))
            elif self._plan.enough is not None:  # which runs are needed shows on the way
                found.append(("grid", n, 0, None))
            else:
                grid = integrator.grid(self._plan)
                found += [("grid", n, i, i + 1) for i in range(len(grid))]
        return sorted(found, key=lambda part: part[2], reverse=True)

    def make(self, part: Part) -> None:
        """Make a part of all runs."""
        what, number, first, last = part
        integrator = self._everyone[number]
        if what == "limit":
            self._find_limit(integrator)
        elif what == "search":
            self._search([integrator])
        else:
            self._grid(integrator.grid(self._plan)[first:last])

    # --- grid

    def _grid(self, runs: list[RunSpec]) -> None:
        self._watcher.expect(len(runs))
        finished: set[Integrator] = set()
        costs: dict[Integrator, list[float]] = {}
        made = []
        for run in _ordered(runs):
            if run.integrator in finished:
                self._watcher.expect(-1)
                continue
            record = self._runner.run(run, self._evaluator)
            made.append(run)
            if self._is_last(record, costs.setdefault(run.integrator, [])):
                finished.add(run.integrator)
        self._time(made)

    def _time(self, runs: list[RunSpec]) -> None:
        """Rounds through all runs, so that a busy moment of the machine meets many of them.

        Each completed run is repeated until its shortest times agree.
        """
        while self._left > 0.0 and (pending := [run for run in runs if self._wants_repeat(run)]):
            self._watcher.expect(len(pending))
            for run in pending:
                self._runner.run(run, repeat=self._runner.repeats(run))

    def _wants_repeat(self, run: RunSpec) -> bool:
        """Whether the shortest time of a run is not yet known to AGREE."""
        record, wanted = self._runner.known(run), self._plan.repeats
        if self._plan.jobs > 1 or record is None or record.status != "completed":
            return False
        times = self._runner.timings(run)
        if self._runner.repeats(run) > MOST_REPEATS * wanted:  # some of which failed
            return False
        if len(times) < wanted:
            return True
        agree = wanted < 2 or times[1] <= (1.0 + AGREE) * times[0]
        return not agree and len(times) < MOST_REPEATS * wanted

    def _good_enough(self, record: RunRecord) -> bool:
        enough = self._plan.enough
        return enough is not None and self._error(record) <= enough

    def _is_last(self, record: RunRecord, costs: list[float]) -> bool:
        """Whether shorter steps of its stepper can be no better buy.

        costs: seconds with longer steps; those of the run are added.
        """
        if record.status != "completed" or self._plan.enough is None:
            return False
        costs.append(record.seconds)
        least, good = self._least.get(record.mesh, math.inf), self._good_enough(record)
        if good and record.seconds < least:
            self._least[record.mesh] = record.seconds
        rising = costs[-1] >= min(costs[:-1], default=math.inf)
        return good or (rising and costs[-1] > DEAR * least)

    # --- the longest stable step

    def _find_limit(self, integrator: Integrator) -> None:
        if integrator.refusal is not None:
            return
        limit, gravity = integrator.stable_dt, integrator.space.gravity_limit
        known = math.isfinite(limit)
        guess = limit if known else 8.0 * gravity
        ends: set[str] = set()

        def works(dt: float) -> bool:
            self._watcher.expect(1)
            status = self._runner.run(integrator.trial(dt)).status
            ends.add(status)
            return status == "completed"

        found = longest_working(
            works, guess, min(guess, gravity) / 8.0, integrator.longest, growth=TRIAL_GROWTH[known]
        )
        hurried = " (some trials ran out of time)" if "timed-out" in ends else ""
        self._watcher.note(_limit_found(integrator, found) + hurried)

    # --- the longest step with an error

    def _search(self, everyone: list[Integrator]) -> None:
        good: list[RunSpec] = []
        for left, integrator in zip(range(len(everyone), 0, -1), everyone, strict=True):
            tried: dict[RunSpec, None] = {}
            found = self._longest_accurate(integrator, tried, SEARCHING * self._left / left)
            worth = self._worth_timing(tried)
            if not worth:
                self._watcher.note(f"{integrator.label}: {found.reason}")
            good += worth
        self._runner.time_limit = self._plan.time_limit
        self._time(good)

    @property
    def _left(self) -> float:
        """Wall time of steps that is left of the budget [s]."""
        return math.inf if self._plan.budget is None else self._plan.budget - self._runner.spent

    def _longest_accurate(
        self, integrator: Integrator, tried: dict[RunSpec, None], budget: float
    ) -> Target:
        """Search along the step within a budget [s]; the runs made are left in `tried`."""
        if integrator.refusal is not None:
            return Target(None, integrator.refusal)
        end = self._runner.spent + budget

        def error(dt: float) -> float:
            run = integrator.run(dt, role="target")
            left = min(end - self._runner.spent, self._plan.time_limit or math.inf)
            if left <= 0.0:
                raise BudgetSpent
            if run not in tried:
                self._watcher.expect(1)
                tried[run] = None
            self._runner.time_limit = left if math.isfinite(left) else None
            return self._error(self._runner.run(run, self._evaluator))

        longest = integrator.dt_sequence(1)[0]
        shortest = min(longest, integrator.space.gravity_limit) / SHORTEST
        try:
            return longest_accurate(error, self._target, longest, shortest)
        except BudgetSpent:
            share = max(budget, 0.0)
            return Target(None, f"no step is good enough that its share of {share:.3g} s allows")

    def _worth_timing(self, tried: Iterable[RunSpec]) -> list[RunSpec]:
        """The good runs that may turn out to be the cheapest."""
        records = {run: self._runner.known(run) for run in tried}
        costs = {
            run: record.seconds
            for run, record in records.items()
            if record is not None and self._error(record) <= self._target
        }
        best = min(filter(math.isfinite, costs.values()), default=math.inf)
        return [run for run, cost in costs.items() if not cost > NEAR_BEST * best]

    def _error(self, record: RunRecord) -> float:
        """The error at the end of a run that the plan's target speaks of; infinite if it failed."""
        plan = self._plan
        field = "vorticity" if plan.target_kind == "slow" else plan.target_field
        found: dict[str, float | None] = {
            error.kind: getattr(error, plan.target_norm)
            for error in record.errors
            if (error.field, error.day) == (field, self._spaces.schedule.days)
        }
        auto = "total" if "total" in found else "time"
        value = found.get(auto if plan.target_kind == "auto" else plan.target_kind)
        return math.inf if value is None else value


def making_parts(tell: Tell, plan: SweepPlan, folder: Path) -> Callable[[Part], None]:
    """Gets a process beside others ready to make parts of a sweep."""
    return Sweep(plan, folder, SweepWatcher(), tell=tell).make


def _ordered(runs: Iterable[RunSpec]) -> list[RunSpec]:
    """Round the integrators: first the longest step of each, then the next."""
    by_integrator: dict[Integrator, list[RunSpec]] = {}
    for run in runs:
        by_integrator.setdefault(run.integrator, []).append(run)
    return [run for each in zip_longest(*by_integrator.values()) for run in each if run]


def _limit_found(integrator: Integrator, found: float | None) -> str:
    if found is None:
        return f"{integrator.label}: no step gets to the end"
    if found >= integrator.longest:
        return f"{integrator.label}: stable at every step up to {found:.4g} s"
    gravity = found / integrator.space.gravity_limit
    return f"{integrator.label}: longest stable step {found:.4g} s, {gravity:.3g} gravity limits"


@contextmanager
def _settled_objects() -> Iterator[None]:
    """Within the block, garbage is looked for only among what is made in it, which is quick."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
