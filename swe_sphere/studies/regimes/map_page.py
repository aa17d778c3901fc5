"""The page of a map: the rule of thumb with its numbers, heat maps, slices, and tables."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from swe_sphere.files.durable import write_whole
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.regimes.figures import by_error, by_refinement, by_step, slices
from swe_sphere.studies.regimes.points import (
    BASE,
    OTHERS,
    UNIT,
    Point,
    Series,
    break_even,
    ratio,
    read_points,
    series,
)
from swe_sphere.studies.report.figures import save_svg
from swe_sphere.studies.sweep.record import read_header, runs_of

ERRORS = (1e-2, 3e-3, 1e-3)
USUAL = 3e-3
"""The slow-flow error of the tables and figures that are for one."""
PAGE = "README.md"


def write_map(folder: Path, out: Path | None = None, *, title: str, introduction: str = "") -> Path:
    """Write README.md and its figures (SVG) of the sweeps of a map; returns its path.

    out: where, None: beside the sweeps.

    Raises:
        ConfigError: there are no sweeps in the folder.
        RunFailed: the disk does not take the files.
    """
    found, shown = series(read_points(folder)), [*product(OTHERS, ERRORS)]
    out = out or folder
    drawn = _figures(found)
    for name, _, figure in drawn:
        write_whole(out / f"{name}.svg", save_svg(figure, name))
    text = rendered(
        "swe_sphere.studies.regimes", "page.md.j2", title=title, introduction=introduction,
        rules=[_rule(found, family) for family in OTHERS],
        heads=[f"{family} {words.level(error)}" for family, error in shown],
        limits=[[of.title, *(_limit(of, *each) for each in shown)] for of in found],
        figures={caption: f"{name}.svg" for name, caption, _ in drawn},
        tables=[(of.title, [_row(point) for point in of.points]) for of in found],
        families=OTHERS, base=BASE, unit=UNIT, usual=words.level(USUAL), made=_made(folder),
    )  # fmt: skip
    write_whole(out / PAGE, text)
    return out / PAGE


def _figures(found: Sequence[Series]) -> list[tuple[str, str, Figure]]:
    """Names, captions and figures, those of more places first."""
    made = []
    usual = words.level(USUAL)
    for key in dict.fromkeys((of.scene, of.diffusive) for of in found):
        lines = [of for of in found if (of.scene, of.diffusive) == key]
        what = f"{key[0]}{', hyperviscosity' if key[1] else ''}"
        name = what.replace(", ", "-")
        if len(lines) > 1:
            caption = f"{what}: cost ratios at a slow-flow error of {usual}, by refinement"
            made.append((f"{name}-refinement", caption, by_refinement(lines, USUAL)))
        caption = f"{what}: cost ratios by slow-flow error, on the uniform mesh"
        made.append((f"{name}-error", caption, by_error(lines[0], ERRORS)))
    points = [point for of in found for point in of.points]
    caption = f"Cost ratio against the step, at a slow-flow error of {usual}; open: hyperviscosity"
    made.insert(0, ("steps", caption, by_step(points, USUAL)))
    chosen = _chosen(found)
    made.append(("slices", f"All steppers: {'; '.join(chosen)}", slices(chosen)))
    return made


def _chosen(found: Sequence[Series]) -> dict[str, Point]:
    """The slowest and the fastest wind of the first series, and the slowest of the most refined."""
    first = found[0]
    lines = [of for of in found if (of.scene, of.diffusive) == (first.scene, first.diffusive)]
    last = max(lines, key=lambda of: of.stretch)
    ends = [(first, first.points[0]), (first, first.points[-1]), (last, last.points[0])]
    return {f"{of.title}, U/c = {words.number(p.froude, 2)}": p for of, p in ends}


def _limit(of: Series, family: str, error: float) -> str:
    """A break-even Froude number in a cell."""
    froude = break_even(of, family, error)
    if froude == 0.0:
        return f"< {words.number(of.points[0].froude, 2)}"
    return f"> {words.number(of.points[-1].froude, 2)}" if math.isinf(froude) else _two(froude)


def _two(value: float) -> str:
    """A number with two digits."""
    return words.number(value, 2)


def _rule(found: Sequence[Series], family: str) -> dict[str, Any]:
    """Ratios of a family to explicit steps and to `UNIT`, and the steps at which it is cheaper."""
    places = [(of, point) for of in found for point in of.points]
    steps = {True: list[float](), False: list[float]()}
    ratios = []
    for _, point in places:
        offer, value = point.best(family, USUAL), ratio(point, family, USUAL)
        if offer and math.isfinite(value):
            ratios.append(value)
            steps[value <= 1.0].append(offer.dt / point.gravity_limit)
    beside = {
        f"{of.title}, U/c = {_two(point.froude)}": value
        for of, point in places
        if math.isfinite(value := ratio(point, family, USUAL, UNIT))
    }
    return {
        "family": family, "ratios": ratios, "beside": beside,
        "cheaper": steps[True], "dearer": steps[False],
    }  # fmt: skip


def _named(point: Point, family: str) -> str:
    """The cheapest step of a family in words."""
    offer = point.best(family, USUAL)
    return words.NOTHING if offer is None else f"`{offer.stepper}` {words.step(offer.dt)}"


def _row(point: Point) -> list[str]:
    """The cheapest of each family at one place."""
    base = point.best(BASE, USUAL)
    cost = math.nan if base is None else base.cost / point.days
    cells = [_two(point.froude), f"{_named(point, BASE)}, {words.number(cost)}"]
    for family in OTHERS:
        value = ratio(point, family, USUAL)
        told = f"{_two(value)}, {_named(point, family)}"
        cells.append(told if math.isfinite(value) else words.NOTHING)
    return cells


def _made(folder: Path) -> Mapping[str, Any]:
    """Of what the sweeps were made, told by the first of them."""
    paths = sorted(folder.glob("*/sweep.json"))
    headers = [header for path in paths if (header := read_header(path.parent)) is not None]
    first = headers[0]
    versions = ", ".join(f"{name} {version}" for name, version in first.versions.items())
    plan = {key: value for key, value in first.plan.items() if key not in ("scene", "name")}
    runs = [run for path in paths for run in runs_of(path.parent).records]
    return {
        "runs": len(runs), "sweeps": len(headers), "machine": first.machine, "cores": first.cores,
        "versions": versions, "plan": json.dumps(plan),
        "days": sorted({header.created[:10] for header in headers}),
    }  # fmt: skip
