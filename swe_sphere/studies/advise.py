"""Advice before a run: a short search with some steppers on the user's own scene and mesh."""

import math
import shlex
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import warp as wp
from pydantic import BeforeValidator, Field

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY
from swe_sphere.settings.values import flag_of
from swe_sphere.simulation.config import Days, Number, Positive, RunConfig, make_config
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.sweep import SweepWatcher, make_plan, run_sweep
from swe_sphere.studies.sweep.runs import Discretisation
from swe_sphere.studies.sweep.sweep_plan import stepper_names

if TYPE_CHECKING:
    from swe_sphere.studies.report import Ranking

REPRESENTATIVES = ("forward-backward", "rk4", "semi-implicit", "epi2", "tr-bdf2")
"""Steppers that are measured by default: of each family the stepper that is cheapest in most
cases of docs/results/resolution, and rk4."""
RUNS = 200.0
"""Estimated cost of a search, in runs of rk4 with its automatic step over the same days."""
TIMED_STEPS = 8
"""Number of steps that are timed to estimate the time of a run."""


class Question(RunConfig):
    """The run to advise on, and its required error."""

    error: Annotated[Number, Field(gt=0.0, lt=1.0)]
    """Required time error at the end (l2, relative): of potential vorticity, or of depth where the
    flow begins at rest or has no gravity waves.
    """
    budget: Positive = 60.0
    """Wall time that the steps of all runs may take [s] (60)."""
    steppers: Annotated[tuple[str, ...], BeforeValidator(stepper_names)] = REPRESENTATIVES
    """Steppers to measure: names, .py files or families; by default one or two of each family."""
    days: Annotated[Days, Field(gt=0.0)] | None = None
    """Length of the run [days]."""


class Advice(NamedTuple):
    """The answer: the measured steppers, and the advised run."""

    days: float
    """Length of the measured runs [days]."""
    of_days: float
    """Length of the run to advise on [days]."""
    ranking: "Ranking"
    """All steppers at the target error of the measured runs; one of them reaches it."""
    config: RunConfig
    """The configuration of the advised run."""

    @property
    def command(self) -> str:
        """Shell command of the advised run."""
        words = ["swe-sphere", "run", self.config.scene]
        for name, value in self.config.given().items():
            for each in value if isinstance(value, tuple) else (value,):
                text = f"{each:.12g}" if isinstance(each, float) else str(each)
                words += [] if name == "scene" else [f"--{flag_of(name)}", text]
        return shlex.join(words)


def advise(question: Question, watcher: SweepWatcher | None = None) -> Advice:
    """Measure steppers, and return the cheapest one with a step that keeps to the required error.

    If the budget does not cover all days, the runs are shorter and the required error is smaller in
    proportion, on the assumption that errors grow linearly with time.

    Raises ConfigError if the scene cannot be built, or the error cannot be reached or measured.
    """
    from swe_sphere.studies.report import sweep_rankings  # matplotlib is slow to import

    apart = {"error", "budget", "steppers"}
    common = question.model_dump(exclude=apart, exclude_unset=True, exclude_none=True)
    space = Discretisation(make_config(common))
    whole = days = space.scene.days if question.days is None else question.days
    seconds_a_day = RUNS * _seconds_a_day(space, common)
    while days * seconds_a_day > question.budget and days > 0.1:
        days *= 0.5
    # the error of the slow flow if gravity waves are present as well, otherwise of depth
    waves = space.scene.effect("pressure-gradient") is not None
    slow = waves and math.isfinite(space.limits["advective_limit"])
    target = question.error * days / whole
    plan = make_plan(common | {
        "steppers": question.steppers, "days": days, "budget": question.budget,
        "target_error": target, "target_kind": "slow" if slow else "time", "slow": slow,
    })  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        dataset = run_sweep(plan, Path(folder), watcher)
    reference = dataset.isel(run=(dataset["role"] == "converged").values)
    if (failed := reference["reason"][(reference["status"] != "completed").values]).size:
        raise ConfigError(f"the reference run fails: {failed.values[0]}")
    for ranking in sweep_rankings(dataset):
        if target < 2.0 * ranking.floor:
            raise ConfigError(
                f"error: {target:.2g} cannot be measured, as the error of the reference run is"
                f" {ranking.floor:.2g}: give an error of more than twice this"
            )
        for best in ranking.winners(0).to_dict("records"):
            named = {get_stepper(name).name: name for name in question.steppers}
            chosen = {"stepper": named[best["stepper"]], "dt": float(f"{best['dt']:.5g}")}
            if best["preconditioner"]:
                chosen["preconditioner"] = best["preconditioner"]
            return Advice(days, whole, ranking, make_config(common | chosen))
    raise ConfigError(
        f"error: no step keeps the error to {question.error:g} over {whole:g} days: give a larger"
        f" error, or a budget of more than {question.budget:g} s"
    )


def _seconds_a_day(space: Discretisation, common: dict[str, Any]) -> float:
    """Return the time [s] of a day of rk4 with its automatic step: CPU time, on a GPU wall time."""
    explicit = {"stepper": "rk4", "settings": space.config.scene_settings}
    sim = space.simulation(make_config(common | explicit))
    clock = time.process_time if sim.model.device == "cpu" else time.perf_counter
    times = []
    for _ in range(TIMED_STEPS):
        began = clock()
        sim.step()
        wp.synchronize_device(sim.model.device)
        times.append(clock() - began)
    return min(times) * DAY / sim.plan.dt
