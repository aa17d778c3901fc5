"""Time of a day with the cheapest steps of the map along resolution, measured again.

    python benchmarks/break_even.py [NE ...]

The steps are those that the searches of `resolution.toml` found for williamson5 with np 4 and a
slow-flow error of 1e-2, on the machine of the page (benchmarks/results/resolution.csv).  The errors
of steps do not depend on the machine; times do, and on the version of the code.  Steppers take
their days in turns.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from resolution import by_machine, read_table
from sections import Section, load, measure
from threadpoolctl import threadpool_limits

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene

MESHES = (30, 60, 120)
FAMILIES = ("explicit", "imex", "implicit")
SEMI_IMPLICIT_UP_TO = 60
"""Largest ne at which IMEX steps are timed, whose days take longest."""
REPEATS = 2


def steps_of(ne: int) -> pd.DataFrame:
    """Return the cheapest steps of the families on a mesh, slow winds first."""
    table = by_machine(read_table())[0]
    meant = (table["group"] == "williamson5, np4") & (table["ne"] == ne) & (table["target"] == 1e-2)
    families = [f for f in FAMILIES if f != "imex" or ne <= SEMI_IMPLICIT_UP_TO]
    return table[meant & table["family"].isin(families)].sort_values("froude")


def day(stepper: str, ne: int, speed: float, dt: float) -> float:
    """Return the CPU time [s] of the steps of a day."""
    model = Model(Mesh.build(ne, 4), get_scene("williamson5", speed=speed))
    count = round(DAY / dt)
    run = STEPPERS[stepper](model, DAY / count)
    run.start(model.initial_state())
    run.take(1)  # compiling
    run.start(model.initial_state())
    began = time.process_time()
    while run.steps < count:
        run.take(count - run.steps)
    return time.process_time() - began


def times(ne: int) -> Section:
    """Measure the days of all winds on a mesh."""
    rows, steps = [], steps_of(ne)
    for froude in np.unique(steps["froude"]):
        of_wind = steps[steps["froude"] == froude]
        speed = float(of_wind["series"].iloc[0].rpartition("=")[2])
        found: dict[str, list[float]] = {family: [] for family in of_wind["family"]}
        with threadpool_limits(1, user_api="blas"):
            for _ in range(REPEATS):
                for each in of_wind.itertuples():
                    found[each.family].append(day(each.stepper, ne, speed, each.dt))
        least = {family: min(seconds) for family, seconds in found.items()}
        for each in of_wind.itertuples():
            ratio = least[each.family] / least["explicit"]
            rows.append([f"{speed:g} m/s", each.stepper, f"{each.dt:.4g}",
                         f"{least[each.family]:.3g}", f"{ratio:.2f}"])  # fmt: skip
            print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a day takes a while
    return Section(
        f"williamson5, ne{ne} np4: a day with the cheapest steps of the map",
        f"CPU time of the steps of a day, the lesser of {REPEATS} days in turns on one core.",
        ["wind", "stepper", "Δt [s]", "CPU [s]", "over the explicit step"],
        rows,
    )


def main(
    meshes: Annotated[
        list[int] | None, typer.Argument(help="Values of ne; by default all.")
    ] = None,
) -> None:
    """Measure and store the tables."""
    wanted: Iterable[int] = meshes or MESHES
    names = [*load("break_even"), *(f"ne{ne}" for ne in wanted)]
    sections = {name: (lambda ne=int(name[2:]): times(ne)) for name in dict.fromkeys(names)}
    measure("break_even", sections, [f"ne{ne}" for ne in wanted])


if __name__ == "__main__":
    typer.run(main)
