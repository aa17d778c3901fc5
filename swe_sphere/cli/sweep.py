"""`swe-sphere sweep`: flags and recipes to plans, runs with a progress bar, and the answer."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import TypeAdapter, ValidationError

from swe_sphere.cli.options import given, with_flags
from swe_sphere.cli.show import Stopped
from swe_sphere.cli.show_sweep import SweepTerminal, show_sweep
from swe_sphere.compiling import COMPILING, on_compile
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import clear_errors
from swe_sphere.settings.values import place_and_complaint
from swe_sphere.simulation.loop import Interrupted
from swe_sphere.studies.pages import MARK
from swe_sphere.studies.sweep import SweepPlan, make_plan, run_plan
from swe_sphere.studies.sweep.sweep_plan import Recipe, folder_of, load_recipe

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import xarray as xr

    from swe_sphere.studies.report import Claim

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
    loaded = None if recipe is None else load_recipe(recipe)
    if report_only:
        return _report_again(out, loaded, quiet)
    datasets, completed = {}, False
    plans, mapped = _plans(values, loaded), loaded if loaded and loaded.mapped else None
    if mapped and any(plan.jobs > 1 for plan in plans):
        raise ConfigError("jobs: a map ranks by CPU time, which only runs alone have: leave it out")
    _claims(loaded)
    single = loaded is not None and loaded.single
    apart = loaded is not None and not single
    folders = {plan.folder: out / plan.folder if apart else out for plan in plans}
    _check_pages([out, *folders.values()], REPORT)
    _check_pages([out] if loaded else [], PAGE)
    for plan in plans:
        folder = folders[plan.folder]
        dataset = datasets[plan.folder] = _carried_out(plan, folder, quiet)
        completed |= _any_completed(dataset)
        if not mapped:
            search = None if plan.target_error is None else plan
            _finish(dataset, None if single else folder, search, quiet)
    if mapped:
        _map(out, mapped, quiet)
    elif single or len(datasets) > 1:
        _join(datasets, out, loaded, quiet)
    return 0 if completed else RunFailed.exit_status


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


def _any_completed(dataset: xr.Dataset) -> bool:
    """Whether a run that stands for a setting has come to its end."""
    compared = dataset["role"].isin(["grid", "target"])
    return bool((dataset["status"] == "completed").where(compared, False).any())


def _plans(values: dict[str, Any], recipe: Recipe | None) -> list[SweepPlan]:
    """What the flags say, and for the rest the recipe."""
    flags = given(values, SweepPlan)
    return [make_plan(flags)] if recipe is None else recipe.plans(flags)


def _carried_out(plan: SweepPlan, folder: Path, quiet: bool) -> xr.Dataset:
    terminal = SweepTerminal(plan.scene, quiet)
    try:
        with closing(terminal), on_compile(lambda: terminal.note(COMPILING)):
            return run_plan(plan, folder, terminal)
    except (Interrupted, KeyboardInterrupt):
        raise Stopped(
            f"interrupted by Ctrl-C; {folder} keeps the runs that are finished, and the same"
            " command goes on from there"
        ) from None


def _map(out: Path, recipe: Recipe, quiet: bool) -> None:
    """One page on all sweeps of a recipe."""
    from swe_sphere.studies.regimes import write_map

    page = write_map(out, title=recipe.title, introduction=recipe.introduction)
    if not quiet:
        typer.echo(page)


def _report_again(out: Path, recipe: Recipe | None, quiet: bool) -> int:
    """Datasets and reports of all sweeps in a folder, anew from their records."""
    if recipe is not None and recipe.mapped:
        _check_pages([out], PAGE)
        _map(out, recipe, quiet)
        return 0
    from swe_sphere.studies.sweep.dataset import write_dataset
    from swe_sphere.studies.sweep.record import HEADER, RUNS, runs_of

    kept = [path for of in ("", "*/") for name in (HEADER, RUNS) for path in out.glob(of + name)]
    folders = sorted({path.parent for path in kept})
    if not folders:
        raise ConfigError(f"there is no sweep in {out}: leave report-only out to make one")
    begun = [folder for folder in folders if runs_of(folder).records] or folders
    single = recipe is not None and recipe.single and begun == [out]
    joined = single or len(begun) > 1
    _check_pages([*begun, out] if joined else begun, REPORT)
    _check_pages([out] if joined else [], PAGE)
    datasets = {folder: write_dataset(folder) for folder in begun}
    names = [folder.name for folder in datasets]
    if recipe is not None and single:
        names = [folder_of({"scene": datasets[out].scene, **recipe.sweeps[0]})]
    for folder, dataset in datasets.items():
        _finish(dataset, None if single else folder, None, quiet)
    if joined:
        _join(dict(zip(names, datasets.values(), strict=True)), out, recipe, quiet)
    return 0


def _finish(
    dataset: xr.Dataset, folder: Path | None, search: SweepPlan | None, quiet: bool
) -> None:
    """Write the report and show the table; of a search its answer.

    folder: of the report; None: it is that of the recipe.
    """
    from swe_sphere.studies.report import write_report  # matplotlib takes its time to import

    page = None if folder is None else write_report(dataset, folder)
    if not quiet:
        show_sweep(dataset, search)
        if page is not None:
            typer.echo(page)


def _join(
    datasets: Mapping[str, xr.Dataset], out: Path, recipe: Recipe | None, quiet: bool
) -> None:
    """One report of several scenes, in HTML and in Markdown, in the order of the recipe."""
    from swe_sphere.studies.report import write_markdown, write_report

    recipe = recipe or Recipe("What accuracy costs in time", ())
    order = [folder_of(values) for values in recipe.sweeps]
    names = sorted(datasets, key=lambda name: order.index(name) if name in order else len(order))
    ordered = {name: datasets[name] for name in names}
    page = write_report(ordered, out, title=recipe.title, notes=recipe.notes)
    write_markdown(
        ordered, out, title=recipe.title, introduction=recipe.introduction, notes=recipe.notes,
        claims=_claims(recipe),
    )  # fmt: skip
    if not quiet:
        typer.echo(page)


def _claims(recipe: Recipe | None) -> dict[str, Claim]:
    """Those of a recipe by folder; ConfigError for what is none."""
    if recipe is None or not recipe.claims:
        return {}
    from swe_sphere.studies.report import Claim  # matplotlib takes its time to import

    try:
        return TypeAdapter(dict[str, Claim]).validate_python(recipe.claims)
    except ValidationError as error:
        raise ConfigError(f"claim: {place_and_complaint(error)}") from None
