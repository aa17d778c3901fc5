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
        families=OTHERS, base=BASE, usual=words.level(USUAL), made=_made(folder),
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
    if math.isnan(froude):
        return words.NOTHING
    if froude == 0.0:
        return f"< {words.number(of.points[0].froude, 2)}"
    last = of.points[-1].froude
    return f"> {words.number(last, 2)}" if math.isinf(froude) else words.number(froude, 2)


def _rule(found: Sequence[Series], family: str) -> str:
    """From how many gravity limits a step on a family is cheaper than explicit steps."""
    pairs = []
    for point in (point for of in found for point in of.points):
        offer, value = point.best(family, USUAL), ratio(point, family, USUAL)
        if offer and math.isfinite(value):
            pairs.append((offer.dt / point.gravity_limit, value))
    cheap, dear = (
        sorted(g for g, value in pairs if (value <= 1.0) == is_) for is_ in (True, False)
    )
    if not pairs:
        return f"**{family}**: no such step has the error at a price worth trying."
    least = words.number(min(value for _, value in pairs), 2)
    where = f"cheaper at {len(cheap)} of {len(pairs)} places, down to {least} times the price"
    text = f"**{family}**: {where if cheap else f'dearer everywhere, {least} times and more'}"
    for spans, what in ((cheap, "cheaper"), (dear, "dearer")):
        if spans:
            ends = dict.fromkeys(words.number(g, 2) for g in (spans[0], spans[-1]))
            text += f"; {what} with steps of {' to '.join(ends)} gravity limits"
    return f"{text}. {_beside_unit(found, family)}"


def _beside_unit(found: Sequence[Series], family: str) -> str:
    """Where it is cheaper than one explicit stepper that everybody knows."""
    ratios = {
        f"{of.title}, U/c = {words.number(point.froude, 2)}": value
        for of in found
        for point in of.points
        if math.isfinite(value := ratio(point, family, USUAL, UNIT))
    }
    if not ratios:
        return f"`{UNIT}` alone has nothing to be compared with."
    cheap = sum(value <= 1.0 for value in ratios.values())
    best = min(ratios, key=ratios.__getitem__)
    text = f"Against `{UNIT}` alone: cheaper at {cheap} of {len(ratios)}"
    return f"{text}, {words.number(ratios[best], 2)} times at best ({best})."


def _named(point: Point, family: str) -> str:
    """The cheapest step of a family in words."""
    offer = point.best(family, USUAL)
    return words.NOTHING if offer is None else f"`{offer.stepper}` {words.step(offer.dt)}"


def _row(point: Point) -> list[str]:
    """The cheapest of each family at one place."""
    base = point.best(BASE, USUAL)
    cost = math.nan if base is None else base.cost / point.days
    cells = [words.number(point.froude, 2), f"{_named(point, BASE)}, {words.number(cost)}"]
    for family in OTHERS:
        value = ratio(point, family, USUAL)
        told = f"{words.number(value, 2)}, {_named(point, family)}"
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
