"""Advice before a run: a short search on the user's own scene and mesh, one stepper a family."""

from __future__ import annotations

import math
import shlex
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import warp as wp
from pydantic import BeforeValidator, Field

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY
from swe_sphere.settings.values import flag_of
from swe_sphere.simulation.config import (
    Days,
    Number,
    Positive,
    RunConfig,
    SharedConfig,
    Whole,
    make_config,
)
from swe_sphere.steppers import get_stepper
from swe_sphere.studies.report import Ranking, search_rankings
from swe_sphere.studies.sweep import SweepWatcher, make_plan, run_plan
from swe_sphere.studies.sweep.runs import Discretisation
from swe_sphere.studies.sweep.sweep_plan import stepper_names

REPRESENTATIVES = ("forward-backward", "rk4", "semi-implicit", "epi2", "tr-bdf2")
"""Steppers that are measured: of each family the one that is cheapest at most places of the map
of regimes, and the classical explicit one."""
RUNS = 200.0
"""Cost of a search, in runs of rk4 with its longest step over the same days."""
TIMED_STEPS = 8


class Question(SharedConfig):
    """What advice is asked for; None means: as the scene recommends."""

    scene: str
    """Name of a scene, or a .py or .toml file with one."""
    error: Annotated[Number, Field(gt=0.0, lt=1.0)]
    """Error in time at the end that is wanted (l2, relative): of potential vorticity, or of depth
    where the flow begins at rest or has no gravity waves."""
    budget: Positive = 60.0
    """Wall time that the steps of all runs may take [s] (60)."""
    steppers: Annotated[tuple[str, ...], BeforeValidator(stepper_names)] = REPRESENTATIVES
    """What to measure, by names, .py files or families; by default one or two of each family."""
    ne: Whole | None = None
    """Elements along an edge of the cube."""
    np: Whole | None = None
    """Nodes along an edge of an element."""
    days: Annotated[Days, Field(gt=0.0)] | None = None
    """Length of the run [days]."""
    precision: Literal["float64", "float32"] = "float64"
    """Number type of the state."""
    settings: tuple[str, ...] = ()
    """Change an effect or the scene; repeatable."""

    @property
    def common(self) -> dict[str, Any]:
        """Values that were given and that every run of the scene has."""
        names = self.model_fields_set - {"error", "budget", "steppers"}
        return {name: value for name in names if (value := getattr(self, name)) is not None}


@dataclass(frozen=True)
class Advice:
    """The answer: what was measured, and the run that is advised."""

    question: Question
    days: float
    """Length of the measured runs [days]."""
    of_days: float
    """Length of the run that advice is on [days]."""
    ranking: Ranking
    """All steppers at the target error of the measured runs; one of them reaches it."""

    @property
    def config(self) -> RunConfig:
        """The configuration of the run that is advised."""
        best = self.ranking.winners(0)[0]
        steppers = {get_stepper(name).name: name for name in self.question.steppers}
        chosen = {"stepper": steppers[best.stepper], "dt": float(f"{best['dt']:.5g}")}
        if best.preconditioner:
            chosen["preconditioner"] = best.preconditioner
        return make_config(self.question.common | chosen)

    @property
    def command(self) -> str:
        """The command of that run."""
        words = ["swe-sphere", "run", self.config.scene]
        for name, value in self.config.given().items():
            for each in value if isinstance(value, tuple) else (value,):
                text = f"{each:.12g}" if isinstance(each, float) else str(each)
                words += [] if name == "scene" else [f"--{flag_of(name)}", text]
        return shlex.join(words)


def advise(question: Question, watcher: SweepWatcher | None = None) -> Advice:
    """Search for the cheapest stepper and step with an error, over as many days as fit the budget.

    Errors are taken to grow in proportion to the days.

    Raises:
        ConfigError: the scene cannot be made, the error is smaller than that of the reference run,
            or no stepper is found that has the error.
        Interrupted: the user asked to stop.
    """
    space = Discretisation(make_config(question.common))
    whole = space.scene.days if question.days is None else question.days
    days = whole
    while days * _seconds_a_day(space, question) * RUNS > question.budget and days > 0.1:
        days *= 0.5
    # the error of the balanced flow where there is one beside gravity waves, else of depth
    waves = space.scene.wind is None and space.scene.effect("pressure-gradient") is not None
    slow = waves and math.isfinite(space.limits["advective_limit"])
    target = question.error * days / whole
    plan = make_plan(question.common | {
        "steppers": question.steppers, "days": days, "budget": question.budget, "finer": 0,
        "target_error": target, "target_kind": "slow" if slow else "time", "slow": slow,
    })  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        dataset = run_plan(plan, Path(folder), watcher)
    own = float(dataset.attrs["converged_check"])
    if not target >= own:
        raise ConfigError(
            f"error: {target:.2g} cannot be measured, the reference run has {own:.2g}:"
            " ask for a larger one"
        )
    for ranking in search_rankings(dataset, plan):
        if ranking.winners(0):
            return Advice(question, days, whole, ranking)
    raise ConfigError(
        f"error: no step is found that keeps to {question.error:g} over {whole:g} days: ask for a"
        f" larger one, or allow more than {question.budget:g} s (budget)"
    )


def _seconds_a_day(space: Discretisation, question: Question) -> float:
    """Time [s] that rk4 takes for a day with its longest step: CPU time, on a GPU wall time."""
    sim = space.simulation(make_config(question.common | {"stepper": "rk4"}))
    device = sim.model.device
    clock = time.process_time if device == "cpu" else time.perf_counter
    times = []
    for _ in range(TIMED_STEPS):
        began = clock()
        sim.step()
        wp.synchronize_device(device)
        times.append(clock() - began)
    return min(times) * DAY / sim.plan.dt
