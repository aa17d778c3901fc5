"""The page of the map of regimes, and the constants of `swe-sphere advise`, from its sweeps.

swe-sphere sweep --recipe regimes --out DIR      the sweeps; again: goes on, or after changes anew
python benchmarks/regimes.py DIR                 docs/regimes/ and the constants
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
import warp as wp
from fit_methods import Observation, as_text, fitted
from rich.console import Console

from swe_sphere.planet import DAY
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.advice.advise import DATA, safe_steps
from swe_sphere.studies.advice.method import Method, setting_of
from swe_sphere.studies.regimes import Point, read_points, write_map
from swe_sphere.studies.sweep.discretisation import Discretisation
from swe_sphere.studies.sweep.sweep_plan import load_recipe

ROOT = Path(__file__).parents[1]
CHECK = ROOT / "tests" / "data" / "advice.json"
FEWEST = 8
"""Runs that a method must have been seen in."""
MOST_DOUBT = 4.0
"""Factor by which errors may scatter about the law of a method that advice is given of."""


def main(
    folder: Annotated[Path, typer.Argument(help="Of the sweeps of a map.")],
    recipe: Annotated[str, typer.Option(help="That they were made of.")] = "regimes",
    check: Annotated[bool, typer.Option("--check", help="Sweeps to hold advice to.")] = False,
) -> None:
    """Write the page and the constants; or what advice is held to."""
    wp.config.log_level = wp.LOG_WARNING
    if check:
        CHECK.parent.mkdir(exist_ok=True)
        lines = ",\n".join(json.dumps(told(point)) for point in read_points(folder))
        CHECK.write_text(f"[\n{lines}\n]\n")
        return
    plan = load_recipe(recipe)
    page = ROOT / "docs" / "regimes"
    page.mkdir(exist_ok=True)
    write_map(folder, page, title=plan.title, introduction=plan.introduction)
    methods = fitted_to(read_points(folder))
    (ROOT / "swe_sphere" / "studies" / "advice" / DATA).write_text(as_text(methods))
    for method in methods:
        Console().print(method)


def fitted_to(points: list[Point]) -> list[Method]:
    """A method for each stepper that was seen often enough, and that keeps to a law."""
    runs: dict[str, list[Observation]] = {}
    failures: dict[str, list[tuple[float, float]]] = {}
    for point in points:
        for stepper, observation in observed(point):
            runs.setdefault(stepper, []).append(observation)
        for stepper, dt in point.failures:
            courant = dt / point.gravity_limit, dt / point.advective_limit
            failures.setdefault(stepper, []).append(courant)
    kinds = {name: STEPPERS[name] for name in runs if len(runs[name]) >= FEWEST}
    methods = [
        fitted(name, kind.order, kind.family == "explicit", runs[name], failures.get(name, ()))
        for name, kind in kinds.items()
    ]
    return [method for method in methods if method.doubt < MOST_DOUBT]


def observed(point: Point) -> Iterator[tuple[str, Observation]]:
    """The runs at a place of the map as observations."""
    setting = setting_of(Discretisation(point.config), point.days * DAY)
    for run in point.runs:
        yield run.stepper, Observation(setting, run.dt, run.cost, run.error)


def told(point: Point) -> dict[str, object]:
    """A place with all that advice is made of, and the runs there."""
    space = Discretisation(point.config)
    setting = setting_of(space, point.days * DAY)
    runs = [[run.stepper, run.dt, run.cost, run.error] for run in point.runs]
    limits = safe_steps(space, list(point.by_stepper))
    known = {name: dt for name, dt in limits.items() if math.isfinite(dt)}
    return {"name": point.name, "setting": asdict(setting), "limits": known, "runs": runs}


if __name__ == "__main__":
    typer.run(main)
