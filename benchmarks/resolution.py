"""The map along resolution: what each family of steppers costs over explicit ones on finer meshes.

    python -m swe_sphere sweep --recipe benchmarks/resolution.toml --out build/resolution
    python benchmarks/resolution.py build/resolution
    python -m benchmarks --pages

The first command runs the sweeps of the recipe, and resumes them.  The second one stores their
cheapest steps in benchmarks/results/resolution.csv; rows of other places and machines remain.  The
third one fits a power law of ne and the Froude number to the ratios of cost, which gives the ne at
which a family begins to pay, and writes the page with its figures.  The page is about the machine
with the most places; the ratios of the other machines follow at its end.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import pandas as pd
import typer
import xarray as xr
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib import style
from matplotlib.figure import Figure
from sections import DATA, PAGES, Sections, load, stamp_text
from xarray import Dataset

from swe_sphere.errors import ConfigError
from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies import words
from swe_sphere.studies.pages import in_table
from swe_sphere.studies.report.figures import STYLE, finish, svg_text
from swe_sphere.studies.report.page import slug, sweep_rankings
from swe_sphere.studies.sweep.sweep_plan import Recipe, folder_of, load_recipe

RECIPE = Path(__file__).with_suffix(".toml")
FINDINGS = RECIPE.with_name("resolution_findings.md")
"""What the measurement shows, and its limits, in Markdown."""
TABLE = DATA / "resolution.csv"
PAGE = PAGES / "resolution" / "README.md"
BASES = {"explicit": "the best explicit step", "rk4": "`rk4`"}
"""What other families are compared with."""
OTHERS = tuple(name for name in get_args(Family) if name not in BASES)
MACHINE = ["machine", "cores"]
PLACE = ["series", "ne", "target"]
COLUMNS = [
    *PLACE, "family", "stepper", "dt", "cost", "froude", "repeated", *MACHINE, "date",
]  # fmt: skip
"""Columns of the table.  series: scene, np and settings; froude: U/c, the largest wind over the
speed of the fastest gravity waves; repeated: whether the step was timed more than once."""


def best_steps(sweeps: Iterable[Dataset]) -> pd.DataFrame:
    """Return the cheapest step of each family to each target of sweeps, on each mesh and machine.

    Its columns are `COLUMNS`; steps of rk4 are also a family of their own.  Raises ConfigError
    where no timed run reaches a target, or an initial state has no wind or no gravity waves.
    """
    found = [
        ranking.reached(i).assign(target=target, date=sweep.attrs["created"][:10],
                                  **{name: sweep.attrs[name] for name in MACHINE})
        for sweep in sweeps for ranking in sweep_rankings(sweep)
        for i, target in enumerate(ranking.targets)
    ]  # fmt: skip
    runs = pd.concat(found) if found else pd.DataFrame({"cost": []})
    if runs.empty:
        raise ConfigError("map: no timed run of these sweeps reaches a target-error")
    waves = runs["advective_limit"] / runs["gravity_limit"] - 1.0
    for name in runs.loc[~(np.isfinite(waves) & (waves > 0.0)), "scene"]:
        raise ConfigError(f"map: {name} begins without wind or without gravity waves")
    mesh = runs["mesh"].str.replace(r"^ne\d+ ", "", regex=True)
    runs["series"] = (runs["scene"] + ", " + mesh + ", " + runs["settings"]).str.rstrip(", ")
    runs["froude"], runs["repeated"] = 1.0 / waves, runs["spread"].notna()
    runs["family"] = runs["stepper"].map({name: kind.family for name, kind in STEPPERS.items()})
    runs = pd.concat([runs, runs[runs["stepper"] == "rk4"].assign(family="rk4")])
    best = runs.sort_values("cost", kind="stable").drop_duplicates([*MACHINE, *PLACE, "family"])
    return best[COLUMNS].reset_index(drop=True)


def read_table() -> pd.DataFrame:
    """Return the stored table."""
    return pd.read_csv(TABLE)


def merged(table: pd.DataFrame, steps: pd.DataFrame) -> pd.DataFrame:
    """Return a table with these steps instead of its steps at the same places on their machine."""
    place = [*MACHINE, *PLACE]
    replaced = table.set_index(place).index.isin(steps.set_index(place).index)
    rows = pd.concat([table[~replaced], steps]) if not replaced.all() else steps
    order = dict.fromkeys([*place, "cost"], True) | {"target": False}
    return rows.sort_values([*order], ascending=[*order.values()], ignore_index=True)


def by_machine(table: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the steps of each machine, beginning with the machine of the most places.

    Further columns: group: series without settings of the scene, such as its wind; explicit and
    rk4: cost over that of the best explicit step and of rk4, NaN where these miss the target;
    order: 1 on the finest mesh of a group, then 2.
    """
    found = [_compared(steps) for _, steps in table.groupby(MACHINE)]
    return sorted(found, key=lambda steps: -len(steps[PLACE[:2]].drop_duplicates()))


def _compared(best: pd.DataFrame) -> pd.DataFrame:
    """Return the steps of a machine with the columns of `by_machine`, slow winds first."""
    froude = best.groupby("series")["froude"].transform("median")
    group = best["series"].str.replace(r",? scene\.\S+", "", regex=True)
    best = best.assign(froude=froude, group=group).sort_values(
        ["froude", *PLACE, "cost"], ascending=[True, True, True, False, True]
    )
    costs = best.pivot(index=PLACE, columns="family", values="cost")
    best = best.join(costs.reindex(columns=[*BASES]), on=PLACE)
    best[[*BASES]] = 1.0 / best[[*BASES]].div(best["cost"], axis=0)
    return best.assign(order=best.groupby("group")["ne"].rank("dense", ascending=False))


class Law(NamedTuple):
    """A rule: ratio = factor ne^by_ne (U/c)^by_froude."""

    factor: float
    by_ne: float
    by_froude: float
    scatter: float
    """Factor by which places lie off the rule (exponential of the root mean square)."""
    places: int
    """Number of places that the rule is fitted to."""

    def ratio(self, ne: float, froude: float) -> float:
        """Return the ratio of costs that the rule predicts."""
        return self.factor * math.pow(ne, self.by_ne) * math.pow(froude, self.by_froude)

    def even(self, froude: float) -> float:
        """Return the ne from which on the ratio is below 1; infinite where it does not fall."""
        ratio = self.ratio(1.0, froude)
        return math.pow(ratio, -1.0 / self.by_ne) if self.by_ne < 0.0 else math.inf


def fitted(places: pd.DataFrame, base: str) -> Law | None:
    """Return the rule of the ratios in the column `base`; None for places on a single mesh.

    It is fitted by least squares to logarithms. Places with one Froude number determine its
    exponent only up to the factor; the rule is still valid for that number.
    """
    places = places[places[base].notna()]
    if places["ne"].nunique() < 2:
        return None
    logs = np.log(places[["ne", "froude", base]].to_numpy(float))
    terms = np.column_stack([np.ones(len(logs)), logs[:, :2]])
    law = np.linalg.lstsq(terms, logs[:, 2], rcond=None)[0]
    scatter = np.exp(np.sqrt(np.mean((terms @ law - logs[:, 2]) ** 2)))
    return Law(float(np.exp(law[0])), float(law[1]), float(law[2]), float(scatter), len(places))


def break_even(steps: pd.DataFrame, base: str) -> float:
    """Return the ne from which on the ratios of a family in one series are below 1.

    It is interpolated between the measured meshes, on logarithms; infinite if the ratio on the
    finest mesh is not below 1.
    """
    steps = steps[steps[base].notna()].sort_values("ne")
    ne, ratio = np.log(steps[["ne", base]].to_numpy(float)).T
    above = np.flatnonzero(ratio >= 0.0)
    if not len(ratio) or ratio[-1] >= 0.0:
        return math.inf
    if not len(above):
        return float(np.exp(ne[0]))
    i = above[-1]
    return float(np.exp(ne[i] + (ne[i + 1] - ne[i]) * ratio[i] / (ratio[i] - ratio[i + 1])))


def page(
    table: pd.DataFrame, recipe: Recipe, findings: str = "", again: Sections | None = None
) -> str:
    """Return the page of a map in Markdown.

    findings: Markdown: what the measurement shows, and its limits.  Its first paragraph precedes
    the first table, the others follow.  again: the sections of `break_even.py`.
    """
    best, *elsewhere = by_machine(table)
    fits: dict[str, dict[tuple[object, ...], Law]] = {"laws": {}, "checks": {}}
    for kind, base in product(fits, BASES):
        meant = best[best["order"].between(*((1, 3) if kind == "laws" else (2, 4)))]
        meant = meant[meant["family"].isin(OTHERS)]
        for key, of in meant.groupby(["group", "target", "family"], sort=False):
            if (law := fitted(of, base)) is not None:
                fits[kind][base, *key] = law
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    filters = named, in_table, words.number, words.level, words.seconds, words.step
    environment.filters |= {each.__name__: each for each in filters}
    return environment.get_template("resolution.md.j2").render(
        recipe=recipe, figures={name: caption for name, caption, _ in _panels(best)}, **fits,
        best=best, bases=BASES, base="explicit", families=OTHERS, elsewhere=elsewhere,
        findings=findings.rstrip(), break_even=break_even, again=again or {}, stamp=stamp_text,
    )  # fmt: skip


def named(series: str) -> str:
    """Return the name of a series with its wind in words."""
    return re.sub(r"scene\.speed=(\S+)", r"\1 m/s", series)


def stored_page() -> str:
    """Return the page of the stored table."""
    findings = FINDINGS.read_text(encoding="utf-8")
    return page(read_table(), load_recipe(str(RECIPE)), findings, load("break_even"))


def figures(table: pd.DataFrame) -> dict[str, str]:
    """Return the figures (SVG) of the page by the names of their files."""
    return {name: svg_text(_figure(of), name) for name, _, of in _panels(by_machine(table)[0])}


def _panels(best: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield file, caption and steps of each figure."""
    others = best[best["family"].isin(OTHERS)]
    for (group, target), of in others.groupby(["group", "target"], sort=False):
        level = words.level(target)
        yield f"{slug(group)}-{level}.svg", f"{group}, error {level}", of


def _figure(best: pd.DataFrame) -> Figure:
    """Draw the ratios of cost for one target over ne, a panel for each wind."""
    with style.context(STYLE):
        winds = [*best.groupby("series", sort=False)]
        figure = Figure(figsize=(2.4 * len(winds) + 0.8, 3.6), layout="constrained")
        panels = figure.subplots(1, len(winds), sharey=True, squeeze=False)[0]
        for axes, (_, here) in zip(panels, winds, strict=True):
            for n, (family, base) in enumerate(product(OTHERS, BASES)):
                line = here[here["family"] == family]
                look = {"color": COLOURS[n // 2], "marker": "os"[n % 2], "ls": ("-", "--")[n % 2]}
                axes.plot(line["ne"], line[base], label=f"{family} / {base}", ms=4.0, **look)
            axes.axhline(1.0, color="#1b1f24", linewidth=1.0)
            axes.set_title(f"U/c = {words.number(here['froude'].iloc[0], 2)}", fontsize=9.0)
        for axes in panels:  # which share their limits
            finish(axes, "ne", "ratio of CPU time")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8.0)
    return figure


def main(sweeps: list[Path]) -> None:
    """Store the cheapest steps of the recipe's sweeps in these folders."""
    names = [folder_of(sweep) for sweep in load_recipe(str(RECIPE)).sweeps]
    paths = [folder / name / "sweep.nc" for folder in sweeps for name in names]
    steps = best_steps(xr.load_dataset(path) for path in paths if path.exists())
    merged(read_table(), steps).to_csv(TABLE, index=False, float_format="%.6g")


if __name__ == "__main__":
    typer.run(main)
