"""`swe-sphere sweep`: flags and recipes to plans, runs with a progress bar, and the answer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swe_sphere.cli.options import given, with_flags
from swe_sphere.cli.show_sweep import show_sweep, watched
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import clear_errors
from swe_sphere.studies.pages import MARK
from swe_sphere.studies.sweep import SweepPlan, make_plan, run_plan
from swe_sphere.studies.sweep.sweep_plan import Recipe, folder_of, load_recipe

if TYPE_CHECKING:
    import xarray as xr

RECIPES_ONLY = ("converged_stepper", "converged_part", "slow", "spin", "longest", "enough", "name")
"""Fields of a plan without a flag."""
REPORT, PAGE = {"index.html": MARK, "table.csv": "dataset,number,"}, {"README.md": MARK}
"""What is written of a sweep, and what of a recipe too, and a text in it by which it is known."""


@with_flags(SweepPlan, argument="scene", without=RECIPES_ONLY)
def sweep(
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the runs; one that is there goes on."),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE.toml", help="Options from there; flags go first."),
    ] = None,
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Make the report again, but no runs.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
    **values: Any,
) -> int:
    """Run steppers over a range of steps, and show what accuracy costs in time."""
    if out is None:
        raise ConfigError("out: say in which folder the sweep is kept (--out DIR)")
    loaded = Recipe("What accuracy costs in time", ()) if recipe is None else load_recipe(recipe)
    if not report_only:
        sweeps = _planned(given(values, SweepPlan), loaded, out)
    else:
        sweeps = [] if loaded.mapped else [(folder, None) for folder in _begun(out)]
    folders = dict.fromkeys(folder for folder, _ in sweeps)
    single = loaded.single and [*folders] == [out]
    joined = single or len(folders) > 1
    pages = REPORT | PAGE if joined and not loaded.mapped else PAGE if loaded.mapped else {}
    _check_pages([] if loaded.mapped else folders, REPORT)
    _check_pages([out], pages)
    datasets, completed = {}, report_only
    for folder, plan in sweeps:
        dataset = datasets[folder] = _carried_out(plan, folder, quiet)
        compared = dataset["status"].where(dataset["role"].isin(["grid", "target"]))
        completed |= bool((compared == "completed").any())
        if not loaded.mapped:
            _finish(dataset, None if single else folder, plan, quiet)
    page = None
    if loaded.mapped:
        from swe_sphere.studies.regimes import write_map

        page = write_map(out, title=loaded.title, introduction=loaded.introduction)
    elif joined:
        page = _join(datasets, out, loaded)
    if page is not None and not quiet:
        typer.echo(page)
    return 0 if completed else RunFailed.exit_status


def _planned(
    flags: Mapping[str, object], recipe: Recipe, out: Path
) -> list[tuple[Path, SweepPlan | None]]:
    """Return plans, each with its folder; flags take precedence over the recipe."""
    if not recipe.sweeps:
        return [(out, make_plan(flags))]
    plans = recipe.plans(flags)
    if recipe.mapped and any(plan.jobs > 1 for plan in plans):
        raise ConfigError("jobs: a map ranks by CPU time, which only runs alone have: leave it out")
    return [(out if recipe.single else out / folder_of(dict(plan)), plan) for plan in plans]


def _begun(out: Path) -> list[Path]:
    """Folders of the sweeps in a folder; of those that have runs, if any has."""
    from swe_sphere.studies.sweep.record import HEADER, RUNS, runs_of

    kept = [path for of in ("", "*/") for name in (HEADER, RUNS) for path in out.glob(of + name)]
    folders = sorted({path.parent for path in kept})
    if not folders:
        raise ConfigError(f"there is no sweep in {out}: leave report-only out to make one")
    return [folder for folder in folders if runs_of(folder).records] or folders


def _check_pages(folders: Iterable[Path], marks: Mapping[str, str]) -> None:
    """ConfigError where a page would take the place of one that no sweep has made.

    marks: a text that is in the pages of sweeps, by their names.
    """
    for path, mark in ((folder / name, mark) for folder in folders for name, mark in marks.items()):
        with clear_errors(f"cannot write to {path}"):
            if path.exists() and mark.encode() not in path.read_bytes():
                raise ConfigError(
                    f"out: {path} is of no sweep, and would be replaced: choose another"
                )


def _carried_out(plan: SweepPlan | None, folder: Path, quiet: bool) -> xr.Dataset:
    """The dataset of a sweep; without a plan that of the runs in the folder."""
    if plan is None:
        from swe_sphere.studies.sweep.dataset import write_dataset

        return write_dataset(folder)
    interrupted = (
        f"interrupted by Ctrl-C; {folder} keeps the runs that are finished, and the same command"
        " goes on from there"
    )
    with watched(plan.scene, quiet, interrupted) as terminal:
        return run_plan(plan, folder, terminal)


def _finish(dataset: xr.Dataset, folder: Path | None, plan: SweepPlan | None, quiet: bool) -> None:
    """Write the report and show the table; of a search its answer.

    folder: of the report; None: it is that of the recipe.
    """
    from swe_sphere.studies.report import write_report  # matplotlib takes its time to import

    page = None if folder is None else write_report(dataset, folder)
    if not quiet:
        show_sweep(dataset, plan if plan and plan.target_error else None)
        if page is not None:
            typer.echo(page)


def _join(datasets: Mapping[Path, xr.Dataset], out: Path, recipe: Recipe) -> Path:
    """One report of several scenes, in HTML and in Markdown, in the order of the recipe."""
    from swe_sphere.studies.report import write_markdown, write_report

    order = [folder_of(values) for values in recipe.sweeps]
    named = {order[0] if recipe.single and folder == out else folder.name: dataset
             for folder, dataset in datasets.items()}  # fmt: skip
    names = sorted(named, key=lambda name: order.index(name) if name in order else len(order))
    ordered = {name: named[name] for name in names}
    page = write_report(ordered, out, title=recipe.title, notes=recipe.notes)
    write_markdown(
        ordered, out, title=recipe.title, introduction=recipe.introduction, notes=recipe.notes,
        claims=recipe.claims,
    )  # fmt: skip
    return page
