"""Which stepper, step and preconditioner a scene wants for an error, by what is known of each."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY
from swe_sphere.settings.values import flag_of
from swe_sphere.simulation.config import Days, Number, RunConfig, SharedConfig, Whole, make_config
from swe_sphere.simulation.time_plan import stepper_options
from swe_sphere.studies.advice.method import Method, Setting, setting_of
from swe_sphere.studies.sweep.discretisation import Discretisation


class Question(SharedConfig):
    """What advice is asked for; None means: as the scene recommends."""

    scene: str
    """Name of a scene, or a .py or .toml file with one."""
    error: Annotated[Number, Field(gt=0.0, lt=1.0)]
    """Slow-flow error at the end that is wanted (l2 of potential vorticity, relative)."""
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

    def run_config(self, **values: object) -> RunConfig:
        """The configuration of a run, with these values too."""
        given = {name: getattr(self, name) for name in self.model_fields_set if name != "error"}
        return make_config({key: of for key, of in given.items() if of is not None} | values)


@dataclass(frozen=True)
class Advice:
    """The answer: every method at its best, and what it follows from."""

    question: Question
    space: Discretisation
    setting: Setting
    candidates: tuple[Candidate, ...]
    """The cheapest first; there is one at least."""

    @property
    def config(self) -> RunConfig:
        """The configuration of the run that is advised."""
        from swe_sphere.steppers import STEPPERS

        best = self.candidates[0]
        stepper = best.method.stepper
        options = stepper_options(STEPPERS[stepper], self.question.run_config(stepper=stepper))
        chosen: dict[str, Any] = {"stepper": stepper, "dt": float(f"{best.dt:.4g}")}
        if "preconditioner" in options:
            chosen["preconditioner"] = options["preconditioner"]
        return self.question.run_config(**chosen)

    @property
    def command(self) -> str:
        """The command of that run."""
        words = ["swe-sphere", "run", self.config.scene]
        for name, value in self.config.given().items():
            for each in value if isinstance(value, tuple) else (value,):
                text = f"{each:.12g}" if isinstance(each, float) else str(each)
                words += [] if name == "scene" else [f"--{flag_of(name)}", text]
        return shlex.join(words)


def advise(question: Question) -> Advice:
    """What the known methods are predicted to do for a scene, the cheapest first.

    Raises:
        ConfigError: the scene cannot be made, has no gravity waves or begins at rest, or no method
            reaches the error.
    """
    space = Discretisation(question.run_config())
    days = space.scene.days if question.days is None else question.days
    setting = setting_of(space, days * DAY)
    methods = known_methods()
    limits = safe_steps(space, [method.stepper for method in methods])
    found = candidates(setting, limits, question.error, methods)
    if not found:
        raise ConfigError(
            f"error: no step of any method is predicted to keep to {question.error:g} over"
            f" {days:g} days: ask for more"
        )
    return Advice(question, space, setting, tuple(found))


def safe_steps(space: Discretisation, steppers: list[str]) -> dict[str, float]:
    """The longest safe step [s] of each stepper that can run the scene; infinite if any is."""
    from swe_sphere.steppers import STEPPERS

    found = {}
    for kind in (STEPPERS[name] for name in steppers if name in STEPPERS):
        with suppress(ConfigError):
            found[kind.name] = kind.safety * space.stable_dt(kind)
    return found


DATA = "methods.json"
SHORTEST = 1.0 / 64.0
"""No step is shorter than this part of the gravity limit."""
RATIO = 2.0**0.125
"""Between the steps that are looked at."""
LIMIT, ERROR, REACH, FAILURE = "stability", "error", "longest tried", "runs that failed"


@dataclass(frozen=True)
class Candidate:
    """A method with its best step for an error."""

    method: Method
    dt: float
    """[s]"""
    error: float
    """Predicted, without a margin."""
    cost: float
    """Predicted, of a day [right-hand sides]."""
    bound: str
    """What keeps the step from being longer."""


def candidates(
    setting: Setting, limits: Mapping[str, float], error: float, methods: Iterable[Method]
) -> list[Candidate]:
    """For each method that reaches the error its cheapest step, the cheapest method first.

    limits: longest step [s] of each stepper that is safe, by name; steppers without one there are
    left out.  A predicted error counts as met where it is so many times smaller as errors scatter
    about the prediction.
    """
    found = [
        best
        for method in methods
        if method.stepper in limits
        and (best := _best(method, setting, limits[method.stepper], error)) is not None
    ]
    return sorted(found, key=lambda candidate: candidate.cost)


def _best(method: Method, setting: Setting, limit: float, error: float) -> Candidate | None:
    courant, seen = method.reach
    reach = min(courant * setting.advective_limit, seen, 0.5 * setting.seconds)
    longest = limit if math.isfinite(limit) else reach
    count = int(math.log(longest / (SHORTEST * setting.gravity_limit)) / math.log(RATIO))
    steps = [longest / RATIO**n for n in range(max(count, 0) + 1)]
    safe = [dt for dt in steps if method.works(setting, dt)]
    good = [dt for dt in safe if method.error(setting, dt) * method.doubt <= error]
    if not good:
        return None
    dt = min(good, key=lambda dt: method.step_cost(setting, dt) / dt)
    bound = LIMIT if math.isfinite(limit) else REACH
    if dt < longest:
        bound = ERROR if dt < safe[0] else FAILURE
    cost = method.step_cost(setting, dt) * DAY / dt
    return Candidate(method, dt, method.error(setting, dt), cost, bound)


@cache
def known_methods() -> tuple[Method, ...]:
    """The methods whose constants come with the package."""
    text = files("swe_sphere.studies.advice").joinpath(DATA).read_text()
    return TypeAdapter(tuple[Method, ...]).validate_json(text)
