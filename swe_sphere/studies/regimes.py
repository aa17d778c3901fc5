"""Maps of sweeps: which family of steppers is cheapest along an axis, a wind or a resolution."""

import math
import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd
from matplotlib import style
from matplotlib.figure import Figure
from xarray import Dataset

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies import words
from swe_sphere.studies.pages import rendered, write_made
from swe_sphere.studies.report.figures import INK, STYLE, finish, svg_text
from swe_sphere.studies.report.page import sweep_rankings
from swe_sphere.studies.sweep.sweep_plan import FROUDE, PLACE, Recipe

BASE = "explicit"
OTHERS = tuple(name for name in get_args(Family) if name != BASE)
CLASSIC = "rk4"
"""The stepper with which families are compared as well."""


def best_steps(datasets: Mapping[str, Dataset], axis: str) -> pd.DataFrame:
    """Return the cheapest step of each family to each target of sweeps, along an axis.

    Columns: x, the value of the axis; series, what places have in common otherwise; target; family;
    ratio and beside, the cost over that of the best explicit step and of `CLASSIC`, NaN where they
    do not reach the target; froude; and those of `read_runs`.

    Args:
        datasets: Of searches for errors.
        axis: ne, np, stretch, froude, or a setting such as "scene.speed".

    Raises ConfigError if no timed run reaches a target, or a sweep has no such axis.
    """
    found = [
        ranking.reached(i).assign(target=target)
        for ranking in sweep_rankings(datasets)
        for i, target in enumerate(ranking.targets)
    ]
    runs = pd.concat(found) if found else pd.DataFrame({"cost": []})
    if runs.empty:
        raise ConfigError("map: no timed run of these sweeps reaches a target-error")
    runs[FROUDE] = 1.0 / (runs["advective_limit"] / runs["gravity_limit"] - 1.0)
    of_settings = runs["settings"].str.extract(rf"(?:^| ){re.escape(axis)}=(\S+)")[0]
    runs["x"] = pd.to_numeric(runs.get(axis, of_settings), errors="coerce")
    for name in runs.loc[runs["x"].isna(), "scene"]:
        raise ConfigError(f"map: a sweep of {name} has no axis {axis}")
    runs["series"] = [_series(run, axis) for run in runs.to_dict("records")]
    runs["family"] = [STEPPERS[name].family if name in STEPPERS else "" for name in runs["stepper"]]
    place = ["series", "x", "target"]
    runs = runs.sort_values([*place, "cost"], ascending=[True, True, False, True])
    classic = runs[runs["stepper"] == CLASSIC].drop_duplicates(place).set_index(place)["cost"]
    best = runs.drop_duplicates([*place, "family"])
    base = best[best["family"] == BASE].set_index(place)["cost"]
    best = best.join(base.rename("base"), on=place).join(classic.rename("classic"), on=place)
    return best.assign(ratio=best["cost"] / best["base"], beside=best["cost"] / best["classic"])


def _series(run: Mapping[str, object], axis: str) -> str:
    """Return the scene, the mesh and the settings of a run, without the value of the axis."""
    apart = "scene." if axis == FROUDE else f"{axis}="
    mesh = [f"{name} {run[name]:g}" for name in PLACE if name != axis and run[name] != 1.0]
    settings = [each for each in str(run["settings"]).split() if not each.startswith(apart)]
    return ", ".join([str(run["scene"]), *mesh, *settings])


def break_even(x: Array, ratios: Array) -> tuple[float, float]:
    """Return the part of an axis on which a family is at most as expensive as another one.

    Between places logarithms are interpolated, of the axis where its values there are positive;
    beyond them the part is unbounded: 0 and infinity.

    Args:
        x: Values of the axis, rising.
        ratios: Ratios of costs there, NaN where no step has the error.

    Returns: its ends, NaN where there is no such part.
    """
    cheaper = np.flatnonzero(ratios <= 1.0)
    if not cheaper.size:
        return math.nan, math.nan

    def end(inside: int, outside: int, beyond: float) -> float:
        if not 0 <= outside < len(x):
            return beyond
        (r0, r1), (x0, x1) = ratios[[inside, outside]], x[[inside, outside]]
        share = math.log(r0) / math.log(r0 / r1) if math.isfinite(r1) else 0.0
        return float(x0 * (x1 / x0) ** share if min(x0, x1) > 0.0 else x0 + share * (x1 - x0))

    return end(cheaper[0], cheaper[0] - 1, 0.0), end(cheaper[-1], cheaper[-1] + 1, math.inf)


def write_map(datasets: Mapping[str, Dataset], out: Path, *, recipe: Recipe) -> Path:
    """Write the page of a map, README.md, and its figures (SVG); return the path of the page.

    Raises as `best_steps` and `write_made`.
    """
    best, figures, files = best_steps(datasets, recipe.axis), {}, {}
    for target, of in best[best["ratio"].notna() & (best["family"] != BASE)].groupby(
        "target", sort=False
    ):
        name = f"{recipe.axis}-{words.level(target)}.svg"
        figures[f"Cost over the best explicit step, for an error of {words.level(target)}"] = name
        files[name] = svg_text(_figure(of, recipe.axis), name)
    targets = sorted({*best["target"]}, reverse=True)
    ratios = best.pivot(
        index=["series", "x"], columns=["family", "target"], values=["ratio", "beside"]
    )
    parts = {
        base: ratios[base].reindex(columns=[*product(OTHERS, targets)]).groupby("series").agg(_part)
        for base in ("ratio", "beside")
    }
    files["README.md"] = rendered(
        "swe_sphere.studies", "regimes.md.j2", recipe=recipe, parts=parts, figures=figures,
        series=best.groupby("series"), families=OTHERS, base=BASE, classic=CLASSIC,
        attributes=[dataset.attrs for dataset in datasets.values()],
    )  # fmt: skip
    write_made(out, files)
    return out / "README.md"


def _part(ratios: pd.Series) -> str:
    """Return in words where on the axis, the last level of the index, a family is cheaper."""
    x = ratios.index.get_level_values(-1).to_numpy()
    low, high = break_even(x, ratios.to_numpy())
    if math.isnan(low):
        return "nowhere" if ratios.notna().any() else words.NOTHING
    inside = ratios[(x >= low) & (x <= high)]
    gaps = "" if (inside <= 1.0).all() else ", with gaps"
    lower, upper = words.number(low, 2), words.number(high, 2)
    if math.isinf(high):
        return (f"from {lower}" if low else "everywhere") + gaps
    return (f"{lower} to {upper}" if low else f"up to {upper}") + gaps


def _figure(best: pd.DataFrame, axis: str) -> Figure:
    """Draw the ratios of the costs for one target along the axis, a panel for each family."""
    with style.context(STYLE):
        families = [name for name in OTHERS if name in {*best["family"]}]
        figure = Figure(figsize=(2.7 * len(families) + 1.0, 3.6), layout="constrained")
        panels = figure.subplots(1, len(families), sharey=True, squeeze=False)[0]
        for axes, family in zip(panels, families, strict=True):
            for n, (name, of) in enumerate(best.groupby("series")):
                line = of[of["family"] == family]
                look = {"color": COLOURS[n % len(COLOURS)], "marker": "osD^v"[n % 5]}
                axes.plot(line["x"], line["ratio"], label=name, markersize=5.0, **look)
            axes.axhline(1.0, color=INK, linewidth=1.0)
            finish(axes, "U/c" if axis == FROUDE else axis, f"{family} / {BASE}")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", fontsize=8.0)
    return figure
