"""The map along resolution: what each family of steppers costs over explicit ones on finer meshes.

    swe-sphere sweep --recipe benchmarks/resolution.toml --out build/resolution
    python benchmarks/resolution.py benchmarks/resolution.toml build/resolution PAGE_FOLDER
        [--elsewhere SWEEPS_OF_ANOTHER_MACHINE] [--findings benchmarks/resolution_findings.md]

The first command runs the sweeps of the recipe, and resumes them; benchmarks/resolution_quick.toml
is a small one.  The second fits a power law of ne and the Froude number to the ratios of cost,
which names the ne at which a family begins to pay, and writes the page with its figures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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
from xarray import Dataset

from swe_sphere.errors import ConfigError
from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Family
from swe_sphere.studies import words
from swe_sphere.studies.pages import in_table
from swe_sphere.studies.report.figures import INK, STYLE, finish, svg_text
from swe_sphere.studies.report.page import slug, sweep_rankings
from swe_sphere.studies.sweep.sweep_plan import Recipe, folder_of, load_recipe

BASES = {"explicit": "the best explicit step", "rk4": "`rk4`"}
"""What other families are compared with."""
COLUMNS = ["series", "ne", "target", "family", "stepper", "dt", "cost", "froude", *BASES]
"""Columns of the file steps.csv."""
OTHERS = tuple(name for name in get_args(Family) if name not in BASES)


def best_steps(datasets: Mapping[str, Dataset]) -> pd.DataFrame:
    """Return the cheapest step of each family to each target of sweeps, on each mesh.

    Columns beside those of `read_runs`: family; target; series: scene, np and settings; group: the
    same without settings of the scene, such as its wind; froude: U/c, the largest wind over the
    speed of the fastest gravity waves; explicit and rk4: cost over that of the best explicit step
    and of rk4, NaN where these miss the target; order: 1 on the finest mesh of a group, then 2.

    Raises ConfigError where no timed run reaches a target, or an initial state has no wind or no
    gravity waves.
    """
    found = [
        ranking.reached(i).assign(target=target)
        for ranking in sweep_rankings(datasets)
        for i, target in enumerate(ranking.targets)
    ]
    runs = pd.concat(found) if found else pd.DataFrame({"cost": []})
    if runs.empty:
        raise ConfigError("map: no timed run of these sweeps reaches a target-error")
    waves = runs["advective_limit"] / runs["gravity_limit"] - 1.0
    for name in runs.loc[~(np.isfinite(waves) & (waves > 0.0)), "scene"]:
        raise ConfigError(f"map: {name} begins without wind or without gravity waves")
    mesh, place = runs["mesh"].str.replace(r"^ne\d+ ", "", regex=True), ["series", "ne", "target"]
    runs["series"] = (runs["scene"] + ", " + mesh + ", " + runs["settings"]).str.rstrip(", ")
    runs["group"] = runs["series"].str.replace(r",? scene\.\S+", "", regex=True)
    runs["froude"] = (1.0 / waves).groupby(runs["series"]).transform("median")
    runs["family"] = runs["stepper"].map({name: kind.family for name, kind in STEPPERS.items()})
    runs = pd.concat([runs, runs[runs["stepper"] == "rk4"].assign(family="rk4")])
    best = runs.sort_values(["froude", *place, "cost"], ascending=[True, True, True, False, True])
    best = best.drop_duplicates([*place, "family"])
    costs = best.pivot(index=place, columns="family", values="cost")
    best = best.join(costs.reindex(columns=[*BASES]), on=place)
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


def write_map(
    datasets: Mapping[str, Dataset],
    out: Path,
    *,
    recipe: Recipe,
    elsewhere: Mapping[str, Dataset] | None = None,
    findings: str = "",
) -> Path:
    """Write the page of a map, README.md, its figures (SVG) and steps.csv; return the page's path.

    elsewhere: sweeps on another machine, whose ratios are shown beside those of this one.
    findings: Markdown: what the measurement shows, and its limits.  Its first paragraph precedes
    the first table, the others follow.
    Raises as `best_steps`.
    """
    best = best_steps(datasets)
    others = best[best["family"].isin(OTHERS)]
    figures, files = {}, {}
    for (group, target), of in others.groupby(["group", "target"], sort=False):
        name = f"{slug(group)}-{words.level(target)}.svg"
        figures[name] = f"{group}, error {words.level(target)}"
        files[name] = svg_text(_figure(of), name)
    fits: dict[str, dict[tuple[object, ...], Law]] = {"laws": {}, "checks": {}}
    for kind, base in product(fits, BASES):
        meant = others[others["order"].between(1 if kind == "laws" else 2, 3)]
        for key, of in meant.groupby(["group", "target", "family"], sort=False):
            if (law := fitted(of, base)) is not None:
                fits[kind][base, *key] = law
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    filters = in_table, words.number, words.level, words.seconds, words.step
    environment.filters |= {each.__name__: each for each in filters}
    files["README.md"] = environment.get_template("resolution.md.j2").render(
        recipe=recipe, figures=figures, **fits, best=best, bases=BASES, base="explicit",
        families=OTHERS, attributes=[dataset.attrs for dataset in datasets.values()],
        elsewhere=_other_machine(elsewhere), findings=findings.rstrip(),
    )  # fmt: skip
    files["steps.csv"] = best[COLUMNS].to_csv(index=False, float_format="%.6g")
    out.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (out / name).write_text(text, encoding="utf-8")
    return out / "README.md"


def _other_machine(datasets: Mapping[str, Dataset] | None) -> dict[str, object] | None:
    if not datasets:
        return None
    attributes = next(iter(datasets.values())).attrs
    return {key: attributes[key] for key in ("machine", "cores")} | {"best": best_steps(datasets)}


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
            axes.axhline(1.0, color=INK, linewidth=1.0)
            axes.set_title(f"U/c = {words.number(here['froude'].iloc[0], 2)}", fontsize=9.0)
        for axes in panels:  # which share their limits
            finish(axes, "ne", "ratio of CPU time")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8.0)
    return figure


def main(
    recipe: str,
    sweeps: Path,
    out: Path,
    elsewhere: Path | None = None,
    findings: Path | None = None,
) -> None:
    """Write the map of the sweeps of a recipe, from the folder `sweeps` to the folder `out`.

    elsewhere: folder of sweeps of the same recipe on another machine.
    findings: Markdown file whose first paragraph precedes the first table; its others follow.
    """
    loaded = load_recipe(recipe)

    def sweeps_in(folder: Path) -> dict[str, Dataset]:
        places = [folder / folder_of(sweep) / "sweep.nc" for sweep in loaded.sweeps]
        return {path.parent.name: xr.load_dataset(path) for path in places if path.exists()}

    others = sweeps_in(elsewhere) if elsewhere else None
    text = findings.read_text(encoding="utf-8") if findings else ""
    typer.echo(write_map(sweeps_in(sweeps), out, recipe=loaded, elsewhere=others, findings=text))


if __name__ == "__main__":
    typer.run(main)
