"""`swe-sphere sweep`: flags and recipes to plans, runs with a progress bar, and the answer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swe_sphere.cli.errors import Stopped
from swe_sphere.cli.run import is_given
from swe_sphere.cli.show_sweep import SweepTerminal, show_sweep
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.studies.sweep import SweepPlan, make_plan, run_plan
from swe_sphere.studies.sweep.recipes import Recipe, load_recipe

if TYPE_CHECKING:
    from collections.abc import Mapping

    import xarray as xr

__all__ = ["sweep"]

OWN = ("recipe", "out", "report_only", "quiet")
"""Flags that are not part of a plan."""


def _option(flag: str, unit: str, text: str) -> Any:
    """A flag; the brackets of units in its text are no markup."""
    return typer.Option(flag, metavar=unit, help=text.replace("[", r"\["))


def sweep(
    context: typer.Context,
    scene: Annotated[
        str | None, typer.Argument(help="Name of a scene, or of a file that defines one.")
    ] = None,
    out: Annotated[
        Path | None, _option("--out", "DIR", "Folder of the runs; one that is there goes on.")
    ] = None,
    steppers: Annotated[str | None, _option("--steppers", "A,B,...", "What to compare.")] = None,
    dt: Annotated[
        str | None,
        _option("--dt", "LIST|auto", "Steps [s]. auto (the default): some for each stepper."),
    ] = None,
    levels: Annotated[
        int | None, _option("--levels", "N", "How many steps auto takes (6).")
    ] = None,
    ne: Annotated[
        str | None, _option("--ne", "LIST", "Elements along an edge of the cube.")
    ] = None,
    np: Annotated[str | None, _option("--np", "LIST", "Nodes along an edge of an element.")] = None,
    precision: Annotated[
        str | None, _option("--precision", "LIST", "float64, float32 or both.")
    ] = None,
    preconditioner: Annotated[
        str | None, _option("--preconditioner", "LIST", "Of the implicit steppers.")
    ] = None,
    tolerance: Annotated[
        float | None, _option("--tolerance", "T", "Of the implicit steppers' solves.")
    ] = None,
    days: Annotated[float | None, _option("--days", "D", "Length of the runs.")] = None,
    report_days: Annotated[
        str | None, _option("--report-days", "LIST", "When errors are taken, besides the end.")
    ] = None,
    repeats: Annotated[
        int | None, _option("--repeats", "R", "How often each setting is timed (3).")
    ] = None,
    time_limit: Annotated[
        float | None, _option("--time-limit", "SECONDS", "Most time of the steps of one run.")
    ] = None,
    find_limit: Annotated[
        bool, typer.Option("--find-limit", help="Also search for the longest stable steps.")
    ] = False,
    target_error: Annotated[
        float | None,
        _option("--target-error", "E", "Search for the cheapest way to this error, no grid."),
    ] = None,
    target_kind: Annotated[
        str | None, _option("--target-kind", "time|total|slow", "Which error is meant.")
    ] = None,
    target_field: Annotated[
        str | None, _option("--target-field", "h|v|vorticity", "Of which field (h).")
    ] = None,
    target_norm: Annotated[
        str | None, _option("--target-norm", "l1|l2|linf", "In which norm (l2).")
    ] = None,
    reference: Annotated[
        list[Path] | None, _option("--reference", "FILE.nc", "Lat-lon reference; repeatable.")
    ] = None,
    finer: Annotated[
        int | None, _option("--finer", "NE", "Total error against a run of that ne; 0: none.")
    ] = None,
    alpha: Annotated[
        float | None, _option("--alpha", "RADIANS", "Angle between flow and equator.")
    ] = None,
    stretch: Annotated[
        float | None, _option("--stretch", "S", "Refine the mesh S times at the centre.")
    ] = None,
    centre_lon: Annotated[
        float | None, _option("--centre-lon", "RADIANS", "Longitude of the centre.")
    ] = None,
    centre_lat: Annotated[
        float | None, _option("--centre-lat", "RADIANS", "Latitude of the centre.")
    ] = None,
    device: Annotated[str | None, _option("--device", "cpu|cuda:0", "Where to run.")] = None,
    launch: Annotated[
        str | None, _option("--launch", "element|node", "Threads of the kernels.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        _option("--set", "EFFECT.PARAMETER=VALUE", "Change an effect or the scene; repeatable."),
    ] = None,
    recipe: Annotated[
        str | None, _option("--recipe", "NAME|FILE.toml", "Options from there; flags go first.")
    ] = None,
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Make the report again, but no runs.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> int:
    """Run steppers over a range of steps, and show what accuracy costs in time."""
    if out is None:
        raise ConfigError("out: say in which folder the sweep is kept (--out DIR)")
    loaded = None if recipe is None else load_recipe(recipe)
    if report_only:
        return _report_again(out, loaded, quiet)
    datasets, completed = {}, False
    plans = _plans(context, loaded)
    for plan in plans:
        folder = out / Path(plan.scene).stem if len(plans) > 1 else out
        dataset = datasets[plan.scene] = _carried_out(plan, folder, quiet)
        _finish(dataset, folder, None if plan.target_error is None else plan, quiet)
        completed |= _any_completed(dataset)
    if len(datasets) > 1:
        _join(datasets, out, loaded, quiet)
    return 0 if completed else RunFailed.exit_status


def _any_completed(dataset: xr.Dataset) -> bool:
    """Whether a run that stands for a setting has come to its end."""
    compared = dataset["role"].isin(["grid", "target"])
    return bool((dataset["status"] == "completed").where(compared, False).any())


def _plans(context: typer.Context, recipe: Recipe | None) -> list[SweepPlan]:
    """What the flags say, and for the rest the recipe."""
    flags = {name: value for name, value in context.params.items() if name not in OWN}
    asked = {name: value for name, value in flags.items() if is_given(value)}
    return [make_plan(asked)] if recipe is None else recipe.plans(asked)


def _carried_out(plan: SweepPlan, folder: Path, quiet: bool) -> xr.Dataset:
    terminal = SweepTerminal(plan, quiet)
    try:
        with terminal:
            return run_plan(plan, folder, terminal)
    except (Interrupted, KeyboardInterrupt):
        raise Stopped(
            f"interrupted by Ctrl-C; {folder} keeps the runs that are finished, and the same"
            " command goes on from there"
        ) from None


def _report_again(out: Path, recipe: Recipe | None, quiet: bool) -> int:
    """Datasets and reports of all sweeps in a folder, anew from their records."""
    from swe_sphere.studies.sweep.dataset import write_dataset
    from swe_sphere.studies.sweep.record import HEADER, RUNS

    kept = [path for of in ("", "*/") for name in (HEADER, RUNS) for path in out.glob(of + name)]
    folders = sorted({path.parent for path in kept})
    if not folders:
        raise ConfigError(f"there is no sweep in {out}: leave report-only out to make one")
    datasets = {folder: write_dataset(folder) for folder in folders}
    for folder, dataset in datasets.items():
        _finish(dataset, folder, None, quiet)
    if len(datasets) > 1:
        by_scene = {folder.name: dataset for folder, dataset in datasets.items()}
        _join(by_scene, out, recipe, quiet)
    return 0


def _finish(dataset: xr.Dataset, folder: Path, search: SweepPlan | None, quiet: bool) -> None:
    """Write the report and show the table; of a search its answer."""
    from swe_sphere.studies.report import write_report  # matplotlib takes its time to import

    page = write_report(dataset, folder)
    if not quiet:
        show_sweep(dataset, search)
        typer.echo(page)


def _join(
    datasets: Mapping[str, xr.Dataset], out: Path, recipe: Recipe | None, quiet: bool
) -> None:
    """One report of several scenes, in HTML and in Markdown, in the order of the recipe."""
    from swe_sphere.studies.report import write_markdown, write_report

    recipe = recipe or Recipe("What accuracy costs in time", ())
    order = [str(values.get("scene")) for values in recipe.sweeps]
    names = sorted(datasets, key=lambda name: order.index(name) if name in order else len(order))
    ordered = {name: datasets[name] for name in names}
    page = write_report(ordered, out, title=recipe.title, notes=recipe.notes)
    write_markdown(
        ordered, out, title=recipe.title, introduction=recipe.introduction, notes=recipe.notes
    )
    if not quiet:
        typer.echo(page)
