"""The page of a map: the rule of thumb with its numbers, heat maps, slices, and tables."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pandas as pd

from swe_sphere.files.durable import write_whole
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.regimes.figures import by_step, heat_maps, slices
from swe_sphere.studies.regimes.places import BASE, OTHERS, UNIT, RegimeMap, break_even, read_map
from swe_sphere.studies.report.figures import save_svg
from swe_sphere.studies.sweep.record import runs_of

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
    found, out = read_map(folder), out or folder
    best = {error: found.best(error) for error in ERRORS}
    usual, figures = best[USUAL], {}
    offers = {(offer.place, offer.family): offer for offer in usual.itertuples()}
    for name, (caption, figure) in _figures(found, best).items():
        write_whole(out / f"{name}.svg", save_svg(figure, name))
        figures[caption] = f"{name}.svg"
    series = [*found.places.groupby("title", sort=False)]
    plan = {key: of for key, of in found.headers[0].plan.items() if key not in ("scene", "name")}
    shown = [(family, error) for family in OTHERS for error in ERRORS]
    text = rendered(
        "swe_sphere.studies.regimes", "page.md.j2", title=title, introduction=introduction,
        rules=[_rule(found.places, usual[usual["family"] == family], family) for family in OTHERS],
        heads=[f"{family} {words.level(error)}" for family, error in shown],
        limits=[[name, *(_limit(of, best[error], family) for family, error in shown)]
                for name, of in series],
        series=series, offers=offers, figures=figures,
        families=OTHERS, base=BASE, unit=UNIT, usual=words.level(USUAL), headers=found.headers,
        days=sorted({header.created[:10] for header in found.headers}), plan=json.dumps(plan),
        runs=sum(len(runs_of(path.parent).records) for path in folder.glob("*/sweep.json")),
    )  # fmt: skip
    write_whole(out / PAGE, text)
    return out / PAGE


def _figures(found: RegimeMap, best: dict[float, pd.DataFrame]) -> dict[str, tuple[str, Any]]:
    """Captions and figures by name."""
    places, usual = found.places, words.level(USUAL)
    caption = f"Cost ratio against the step, at a slow-flow error of {usual}; open: hyperviscosity"
    made: dict[str, tuple[str, Any]] = {"steps": (caption, by_step(places, best[USUAL]))}
    for (scene, diffusive), of in places.groupby(["scene", "diffusive"], sort=False):
        what = f"{scene}{', hyperviscosity' if diffusive else ''}"
        name = what.replace(", ", "-")
        first = of[of["stretch"] == of["stretch"].iloc[0]]
        at = of.reset_index().pivot(index="stretch", columns="settings", values="place")
        lines = [(f"{stretch:g}", best[USUAL], at.loc[stretch, first["settings"]])
                 for stretch in at.index]  # fmt: skip
        if len(lines) > 1:
            caption = f"{what}: cost ratios at a slow-flow error of {usual}, by refinement"
            made[f"{name}-refinement"] = caption, heat_maps(first["froude"], lines, "refinement")
        caption = f"{what}: cost ratios by slow-flow error, on the uniform mesh"
        lines = [(words.level(error), best[error], first.index) for error in ERRORS]
        made[f"{name}-error"] = caption, heat_maps(first["froude"], lines, "slow-flow error")
    # the slowest and the fastest wind of the first series, and the slowest of the most refined
    of = places[
        places[["scene", "diffusive"]].eq(places.iloc[0][["scene", "diffusive"]]).all(axis=1)
    ]
    uniform, refined = (of[of["title"] == of["title"].iloc[n]] for n in (0, -1))
    chosen = {_name(place): place for place in
              (uniform.iloc[0], uniform.iloc[-1], refined.iloc[0])}  # fmt: skip
    made["slices"] = f"All steppers: {'; '.join(chosen)}", slices(found, chosen)
    return made


def _name(place: pd.Series) -> str:
    return f"{place.title}, U/c = {words.number(place.froude, 2)}"


def _limit(places: pd.DataFrame, best: pd.DataFrame, family: str) -> str:
    """The break-even Froude number of a family in a cell."""
    ratios = best[best["family"] == family].set_index("place")["ratio"].reindex(places.index)
    froude = [*places["froude"]]
    limit = break_even(froude, [*ratios])
    if limit == 0.0:
        return f"< {words.number(froude[0], 2)}"
    return f"> {words.number(froude[-1], 2)}" if math.isinf(limit) else words.number(limit, 2)


def _rule(places: pd.DataFrame, best: pd.DataFrame, family: str) -> dict[str, Any]:
    """Ratios of a family to explicit steps and to `UNIT`, and the steps at which it is cheaper."""
    known = best[best["ratio"].notna()]
    steps = known["dt"] / known["place"].map(places["gravity_limit"])
    beside = best[best["beside"].notna()]
    return {
        "family": family, "ratios": [*known["ratio"]],
        "beside": {_name(places.loc[of.place]): of.beside for of in beside.itertuples()},
        "cheaper": [*steps[known["ratio"] <= 1.0]], "dearer": [*steps[known["ratio"] > 1.0]],
    }  # fmt: skip
