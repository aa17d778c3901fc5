"""A sweep: reference runs, then the grid or the searches, all of it resumable; to one dataset."""

import gc
import math
import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext, suppress
from functools import partial
from itertools import zip_longest
from operator import itemgetter
from pathlib import Path

import xarray as xr

from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError, Interrupted
from swe_sphere.planet import DAY
from swe_sphere.ranks.communicator import refuse_ranks
from swe_sphere.steppers import Stepper
from swe_sphere.studies.jobs import in_processes
from swe_sphere.studies.pages import prose
from swe_sphere.studies.record_store import locked
from swe_sphere.studies.sweep.record import REPEATABLE, RunRecord, note_plan, runs_of, write_dataset
from swe_sphere.studies.sweep.runner import Evaluator, Runner, SweepWatcher
from swe_sphere.studies.sweep.runs import TRIAL_DAYS, TRIAL_STEPS, RunSpec, Setup, Study
from swe_sphere.studies.sweep.sweep_plan import SweepPlan, make_plan

SHORTEST_SEARCHED = 64.0
"""A search for an error tries no step below min(longest step, gravity limit) over this number."""
TRIAL_GROWTH = {True: 1.12, False: 2.0}
"""Ratio of trial steps in the search for a limit, with and without a limit from theory."""
LONGEST_SEARCHED = {"gravity_limit": 64.0, "advective_limit": 8.0}
"""A search for an error begins with a step of at most the largest of these multiples of limits."""
FINEST = 0.1
"""Shortest permitted `Study.interval`, in units of the gravity limit or, if shorter, of the run."""
MOST_REPEATS = 3
"""Runs are repeated at most this many times as often as the plan requests."""
SEARCHING = 0.7
"""Fraction of the remaining budget that the remaining searches share equally."""
NEAR_BEST = 1.5
"""Runs up to this many times the time of the cheapest accurate run are timed again."""
REFINEMENTS = 6
"""Largest number of runs that refine a search between two known steps."""
LIMIT_KNOWN, ACCURATE_KNOWN = 0.02, 0.05
"""Relative accuracy with which searches find the longest working, or accurate, step."""
PLATEAU, SATURATED = 0.9, 0.3
"""If halving the step leaves more than the first fraction of the error, the step does not matter,
unless the relative error is above the second: an error as large as the flow grows no further.
"""

Part = tuple[int, int | None]
"""A task of one process: number of a setup, and index in its grid, or None for searches."""


def sweep(
    scene: str | os.PathLike[str] | Scene,
    steppers: str | type[Stepper] | Sequence[str | os.PathLike[str] | type[Stepper]], *,
    out: str | os.PathLike[str] | None = None, watcher: SweepWatcher | None = None,
    **options: object,
) -> xr.Dataset:  # fmt: skip
    """Run steppers over a range of steps on a scene, and return the results.

    Args:
        scene: name of a scene, path of a file that defines one, or a `Scene`.
        steppers: names, paths of files, or classes, in a list; names also separated by commas.
        out: folder that keeps the runs, so that a sweep can be stopped and extended; None: none.
        watcher: receives the progress.
        options: those of `SweepPlan`: dt [s], ne, np, days, repeats, ...

    Numbers registered with `diagnostic` become variables of the dataset.

    Returns:
        The dataset of `build_dataset`: a row (dimension `run`) for each run, of the `role` grid,
        target, stability or converged. `error` is (run, kind, field, norm, report_day [days]).

    Raises:
        ConfigError: the sweep cannot be run as requested.
        KeyboardInterrupt: on Ctrl-C; finished runs stay in `out`.

    Examples:
        >>> from swe_sphere import sweep
        >>> ds = sweep("williamson2", ["rk4", "tr-bdf2"], ne=2, np=4, days=0.05, dt=[2160, 1080],
        ...            repeats=1)
        >>> grid = ds.isel(run=ds.role.values == "grid")
        >>> grid.stepper.values.tolist()
        ['rk4', 'tr-bdf2', 'rk4', 'tr-bdf2']
        >>> bool((grid.error.sel(kind="time", field="v", norm="l2") < 1e-3).all())
        True
    """
    refuse_ranks()
    own = scene if isinstance(scene, Scene) else None
    name = str(scene) if own is None else own.name
    plan = make_plan({"scene": name, "steppers": steppers, **options}, own)
    try:
        with tempfile.TemporaryDirectory() if out is None else nullcontext(out) as folder:
            return run_sweep(plan, Path(folder), watcher, own)
    except Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None


def run_sweep(
    plan: SweepPlan, folder: Path, watcher: SweepWatcher | None = None, own: Scene | None = None
) -> xr.Dataset:
    """Carry out a plan in a folder and write its dataset there; finished runs are not repeated.

    own: a scene that replaces the one that the plan names.

    Raises:
        ConfigError: the plan does not suit that folder, or another sweep is running there.
        RunFailed: the results cannot be written.
        Interrupted: the user asked to stop; the dataset of finished runs has been written.
    """
    with locked(folder), ExitStack() as stack:
        gc.freeze()  # so that collections between runs skip older objects
        stack.callback(gc.unfreeze)
        work = Sweep(plan, folder, watcher, own)
        try:
            work.run()
        except Interrupted:
            with suppress(ConfigError):  # no run is finished
                write_dataset(folder)
            raise
        return write_dataset(folder)


class NoStepError(Exception):
    """No step is accurate enough; the text states why."""


def longest_working(
    works: Callable[[float], bool], guess: float, shortest: float, longest: float, growth: float
) -> float | None:
    """Return the longest step [s] that works, to LIMIT_KNOWN; None if none does.

    works: tests a step; if it fails for one, longer ones are assumed to fail. guess: first trial;
    shortest, longest: the ends of the search; growth: ratio of steps until the limit is enclosed.
    """
    low = high = min(max(guess, shortest), longest)
    if works(low):
        while low < longest and works(high := min(growth * low, longest)):
            low = high
        if low >= longest:
            return longest
    else:
        while high > shortest and not works(low := max(high / growth, shortest)):
            high = low
        if high <= shortest:
            return None
    while high > (1.0 + LIMIT_KNOWN) * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if works(middle) else (low, middle)
    return low


def longest_accurate(
    error: Callable[[float], float], target: float, longest: float, shortest: float
) -> float:
    """Return the longest step [s] with an error of at most the target, to ACCURATE_KNOWN.

    error: error of a step, not finite if the run fails; it is assumed to grow with the step. The
    search halves the longest step, then applies the secant method to the logarithms. Raises
    NoStepError if halving the step no longer helps, and at the shortest step.
    """
    step, found = longest, error(longest)
    too_long: tuple[float, float] | None = None
    flat = 0
    while not found <= target:
        if step <= shortest:
            raise NoStepError(f"the error is {found:.3g} even at dt = {step:.4g} s")
        too_long = (step, found)
        step = max(0.5 * step, shortest)
        found = error(step)
        flat = flat + 1 if PLATEAU * too_long[1] < found < SATURATED else 0
        if flat == 2 and not found <= target:
            raise NoStepError(f"the error stays at {found:.3g} however short the step")
    for _ in range(REFINEMENTS):
        if too_long is None or too_long[0] <= (1.0 + ACCURATE_KNOWN) * step:
            break
        share = 0.5  # the middle where an error is not finite
        if math.isfinite(too_long[1]) and 0.0 < found < too_long[1]:
            share = math.log(target / found) / math.log(too_long[1] / found)
        tried = step * (too_long[0] / step) ** min(max(share, 0.15), 0.85)
        if (value := error(tried)) <= target:
            step, found = tried, value
        else:
            too_long = (tried, value)
    return step


class Sweep:
    """Carries out a plan in a folder without repeating the runs in it.

    beside: True in each of the processes that share the runs. Raises ConfigError for a plan that
    cannot be carried out, or a folder of another scene.
    """

    def __init__(
        self, plan: SweepPlan, folder: Path, watcher: SweepWatcher | None = None,
        own: Scene | None = None, beside: bool = False,
    ) -> None:  # fmt: skip
        self._plan, self._folder = plan, folder
        self._watcher = watcher = watcher or SweepWatcher()
        self._study = study = Study(plan, own)
        solved = study.days in study.files if study.files else study.scene.exact is not None
        if plan.target_kind == "total" and not solved:
            raise ConfigError(
                f"target-kind: {study.scene.name} has no solution at day {study.days:g}, and thus"
                " no total error: give its --reference, or choose time or slow"
            )
        store = runs_of(folder, f"-{os.getpid()}" if beside else "")
        if not beside and (stale := note_plan(folder, store.records, study)):
            watcher.note(stale)
        self._runner = Runner(study, store, watcher, plan.jobs if beside else 1)
        self._evaluator = Evaluator(study, self._runner, folder)
        self._everyone = study.setups()

    def run(self) -> None:
        """Run all missing runs; Interrupted if the user stops them, RunFailed if the disk fails."""
        plan = self._plan
        with self._runner.interruption:
            for space in self._study.spaces():
                several, gravity = len(self._study.report_days) > 1, space.limits["gravity_limit"]
                if several and self._study.interval < FINEST * min(gravity, self._study.days * DAY):
                    raise ConfigError(
                        f"report-days: steps of {self._study.interval:.4g} s would be needed to"
                        " meet all of these days: take multiples of a longer time"
                    )
                self._evaluator.converged(space)
            if plan.jobs > 1:
                parts = self._parts()
                self._watcher.expect(len(parts))
                begin = partial(Sweep, plan, self._folder, beside=True)
                for _ in in_processes(plan.jobs, begin, parts):
                    self._watcher.done()
                self._runner.read(runs_of(self._folder))
            if plan.target_error:
                self._search(self._everyone)
            else:
                self._grid([each.grid() for each in self._everyone])
            for setup in self._everyone:
                self._find_limit(setup)

    def _parts(self) -> list[Part]:
        """Return all parts; the shortest steps come first, so that they do not delay the end."""
        everyone, search = [*enumerate(self._everyone)], self._plan.target_error
        whole: list[Part] = [(n, None) for n, _ in everyone if search or self._plan.find_limit]
        if search:
            return whole
        places = [(n, i) for n, setup in everyone for i in range(len(setup.grid()))]
        return [*sorted(places, key=itemgetter(1), reverse=True), *whole]

    def __call__(self, part: Part) -> None:
        """Run a part of all runs."""
        number, place = part
        setup = self._everyone[number]
        if place is not None:
            self._grid([[setup.grid()[place]]])
        else:
            self._search([setup])
            self._find_limit(setup)

    def _grid(self, grids: list[list[RunSpec]]) -> None:
        """Run the longest step of each setup first, then the next of each, and so on."""
        runs = [run for each in zip_longest(*grids) for run in each if run]
        self._watcher.expect(len(runs))
        for run in runs:
            self._runner.run(run, self._evaluator)
        self._time(runs)

    def _time(self, runs: list[RunSpec]) -> None:
        """Repeat all runs in rounds, so that a busy phase of the machine affects many of them.

        Each completed run is timed as often as the plan requests, then until its two shortest times
        agree, at most MOST_REPEATS times as often. There are no repeats once the budget is spent.
        """
        while self._left > 0.0 and (pending := [run for run in runs if self._wants_repeat(run)]):
            self._watcher.expect(len(pending))
            for run in pending:
                last = max(record.repeat for record in self._runner.repeats(run))
                self._runner.run(run, repeat=last + 1)

    def _wants_repeat(self, run: RunSpec) -> bool:
        """Return whether a run lacks requested repeats, or its shortest times do not agree yet."""
        first, wanted = self._runner.known(run), self._plan.repeats
        if self._plan.jobs > 1 or first is None or first.status != "completed":
            return False
        repeats = self._runner.repeats(run)
        completed = (each.seconds for each in repeats if each.status == "completed")
        times = sorted(filter(math.isfinite, completed))
        if len(repeats) > MOST_REPEATS * wanted:  # some of which failed
            return False
        agree = wanted < 2 or (len(times) > 1 and times[1] <= (1.0 + REPEATABLE) * times[0])
        return len(times) < (wanted if agree else MOST_REPEATS * wanted)

    def _find_limit(self, setup: Setup) -> None:
        """Search for the longest stable step, if the plan asks for it."""
        if not self._plan.find_limit or setup.refusal is not None:
            return
        study = self._study
        limit, gravity = setup.stable_dt, setup.space.limits["gravity_limit"]
        known, longest = math.isfinite(limit), min(study.interval, 0.5 * study.days * DAY)
        guess = limit if known else 8.0 * gravity
        ends: set[str] = set()

        def works(dt: float) -> bool:
            self._watcher.expect(1)
            status = self._runner.run(setup.spec(dt, "stability")).status
            ends.add(status)
            return status == "completed"

        shortest, growth = min(guess, gravity) / 8.0, TRIAL_GROWTH[known]
        found = longest_working(works, guess, shortest, longest, growth)
        trial = TRIAL_STEPS, max(study.days, TRIAL_DAYS), limit if known else None
        sentence = prose("stable_step", found, longest, gravity, *trial, "timed-out" in ends)
        self._watcher.note(f"{setup.label}: {sentence}")

    def _search(self, everyone: list[Setup]) -> None:
        """Search for the errors of the plan, the largest first; then time the cheapest runs."""
        good: dict[RunSpec, None] = {}
        for left, setup in zip(range(len(everyone), 0, -1), everyone, strict=True):
            tried: dict[RunSpec, RunRecord] = {}
            end = self._runner.spent + SEARCHING * self._left / left
            for target in sorted(self._plan.target_error, reverse=True):
                reason = self._longest_accurate(setup, target, tried, end)
                costs = {run: of.seconds for run, of in tried.items() if self._error(of) <= target}
                best = min(filter(math.isfinite, costs.values()), default=math.inf)
                good |= dict.fromkeys(run for run in costs if not costs[run] > NEAR_BEST * best)
                if not costs:
                    self._watcher.note(f"{setup.label}: {reason}")
                    break
        self._runner.time_limit = self._plan.time_limit
        self._time([*good])

    @property
    def _left(self) -> float:
        """Return the remaining wall time of steps in the budget [s]."""
        return math.inf if self._plan.budget is None else self._plan.budget - self._runner.spent

    def _longest_accurate(
        self, setup: Setup, target: float, tried: dict[RunSpec, RunRecord], end: float
    ) -> str:
        """Search along the step until the time `end` [s] is spent; the runs are left in `tried`.

        Returns why no step has the error, in words; empty if one has.
        """
        if setup.refusal is not None:
            return setup.refusal

        def error(dt: float) -> float:
            run = setup.spec(dt, "target")
            left = min(end - self._runner.spent, self._plan.time_limit or math.inf)
            if run not in tried and left <= 0.0:
                raise NoStepError(f"no step is accurate enough within its share of {budget}")
            self._watcher.expect(1)
            self._runner.time_limit = left if math.isfinite(left) else None
            record = tried[run] = self._runner.run(run, self._evaluator)
            late = [of for of in tried.values() if of.status == "timed-out"]
            if len(late) > 1:  # still shorter steps take longer
                raise NoStepError(f"dt = {dt:.4g} s: {record.reason}")
            return self._error(record)

        limits, budget = setup.space.limits, f"{self._plan.budget or math.inf:g} s"
        longest = max(part * limits[name] for name, part in LONGEST_SEARCHED.items())
        longest = min(longest, setup.safe_dt, self._study.interval)
        shortest = min(longest, limits["gravity_limit"]) / SHORTEST_SEARCHED
        try:
            longest_accurate(error, target, longest, shortest)
        except NoStepError as none:
            last = [*tried.values()][-1:]
            if last and last[0].status not in ("completed", "timed-out"):
                return f"even with dt = {last[0].config.dt:.4g} s: {last[0].reason}"
            return str(none)
        return ""

    def _error(self, record: RunRecord) -> float:
        """Return the error at the end of a run in the plan's norm; infinite if the run failed."""
        value = getattr(self._study.searched(record.errors), self._plan.target_norm, None)
        return math.inf if value is None else float(value)
