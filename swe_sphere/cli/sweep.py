"""`swe-sphere sweep` and `advise`: plans, runs with a progress bar, and the answer."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
import xarray as xr

from swe_sphere.cli.options import flag, given, option, with_flags
from swe_sphere.cli.show import print_table
from swe_sphere.compiling import COMPILING, on_compile
from swe_sphere.errors import ConfigError, Interrupted, RunFailed
from swe_sphere.settings.values import flag_of, validate
from swe_sphere.simulation.config import RunConfig, SharedConfig
from swe_sphere.studies.advise import Question
from swe_sphere.studies.advise import advise as advice_on
from swe_sphere.studies.pages import check_ours
from swe_sphere.studies.sweep import SweepPlan, SweepWatcher, make_plan, run_sweep
from swe_sphere.studies.sweep.record import HEADER, RUNS, runs_of, write_dataset
from swe_sphere.studies.sweep.sweep_plan import Recipe, folder_of, load_recipe

if TYPE_CHECKING:
    from swe_sphere.studies.report import Ranking

NOT_ADVISED = {*RunConfig.model_fields} - {
    *SharedConfig.model_fields, "scene", "ne", "np", "days", "precision", "settings",
}  # fmt: skip
"""Options of runs without a flag of `advise`."""
REPORT, PAGE = "index.html", "README.md"
"""Names of the page of a sweep, and of the additional page of a recipe."""


@with_flags(SweepPlan, argument="scene", without=("slow", "spin", "name"))
def sweep(
    out: Path | None = option("DIR", "Folder of the runs; an existing sweep is resumed."),
    recipe: str | None = option("NAME|FILE.toml", "Options from a recipe; flags override them."),
    report_only: bool = flag("report-only", "Write the report again without runs."),
    quiet: bool = flag("quiet", "Print errors only."),
    **values: Any,
) -> int:
    """Run steppers over a range of steps, and show what accuracy costs in time."""
    if out is None:
        raise ConfigError("out: give the folder of the sweep (--out DIR)")
    loaded = None if recipe is None else load_recipe(recipe)
    plans: list[tuple[Path, SweepPlan]] = []
    flags = given(values, SweepPlan)
    if report_only and flags:
        raise ConfigError(f"report-only: {flag_of(next(iter(flags)))} has no effect: leave it out")
    if not report_only:
        found = loaded.plans(flags) if loaded else [make_plan(flags)]
        plans = [(out / folder_of(dict(plan)) if loaded else out, plan) for plan in found]
    for name in [REPORT, *([PAGE] if loaded else [])]:
        check_ours(out / name)
    datasets, completed = {}, report_only
    for folder, plan in plans:
        kept = f"; {folder} keeps all finished runs; the same command resumes the sweep"
        with _watched(plan.scene, quiet, kept) as terminal:
            dataset = datasets[folder] = run_sweep(plan, folder, terminal)
        completed |= terminal.completed
        if not quiet:
            _show_sweep(dataset)
    from swe_sphere.studies.report import write_report  # matplotlib is slow to import

    for folder in _begun(out) if report_only or loaded else ():
        if folder not in datasets:
            datasets[folder] = write_dataset(folder)
            if report_only and not quiet:
                _show_sweep(datasets[folder])
    page = write_report(_by_name(datasets, out, loaded), out, recipe=loaded)
    if not quiet:
        typer.echo(page)
    if quiet and not completed:
        raise RunFailed(f"no run of the sweep was completed: see {page}")
    return 0 if completed else RunFailed.exit_status


@with_flags(Question, argument="scene", without=NOT_ADVISED)
def advise(**values: Any) -> None:
    """Measure which stepper and step are cheapest for an error, and print the command."""
    if values["error"] is None:
        raise ConfigError("error: give the largest error at the end (--error 1e-3)")
    question = validate(Question, given(values, Question))
    with _watched(question.scene) as terminal:
        advice = advice_on(question, terminal)
    shorter = (
        f"of {advice.of_days:g} days, with {advice.ranking.targets[0]:.2g} in the place of"
        f" {question.error:g}, as if errors grew in proportion to the days. In unstable flows they"
        " grow much faster: give a larger budget there."
    )
    rest = "days." if advice.days == advice.of_days else shorter
    typer.echo(f"Measured over {advice.days:g} {rest}")
    _show_rankings([advice.ranking])
    typer.echo(f"  {advice.command}")


def _begun(out: Path) -> list[Path]:
    """Return the folders of the sweeps in a folder; only those with runs, if any has."""
    kept = [path for of in ("", "*/") for name in (HEADER, RUNS) for path in out.glob(of + name)]
    if not (folders := sorted({path.parent for path in kept})):
        raise ConfigError(f"there is no sweep in {out}: leave report-only out to run one")
    return [folder for folder in folders if runs_of(folder).records] or folders


def _by_name(
    datasets: Mapping[Path, xr.Dataset], out: Path, recipe: Recipe | None
) -> dict[str, xr.Dataset]:
    """Return datasets by the names of their sections, in the order of the recipe."""
    named = {
        folder.name if folder != out else str(dataset.attrs["scene"]): dataset
        for folder, dataset in datasets.items()
    }
    order = map(folder_of, recipe.sweeps if recipe else ())
    return {name: named[name] for name in (*order, *named) if name in named}


@contextmanager
def _watched(title: str, quiet: bool = False, kept: str = "") -> Iterator[SweepWatcher]:
    """Show the progress of a sweep in the block; the message of a stop signal ends with `kept`."""
    terminal = SweepWatcher(title, quiet)
    try:
        with closing(terminal), on_compile(lambda: terminal.note(f"swe-sphere: {COMPILING}")):
            yield terminal
    except (Interrupted, KeyboardInterrupt) as error:
        raise Interrupted(f"{str(error) or 'interrupted by Ctrl-C'}{kept}") from None


def _show_sweep(dataset: xr.Dataset) -> None:
    """Print the costs at which steppers reach errors, mesh by mesh, and the runs that failed."""
    from swe_sphere.studies.report import sweep_rankings

    found = sweep_rankings(dataset)
    _show_rankings(found)
    if not found:
        typer.echo(f"{dataset.attrs['scene']}: no run has an error that could be compared")
    ends = dataset[["stepper", "status", "reason"]].to_dataframe()
    for (stepper, status, reason), count in Counter(ends.itertuples(False, None)).items():
        times = f"{count} × " if count > 1 else ""
        if reason:
            typer.echo(f"{times}{stepper}, {status}: {reason}")


def _show_rankings(found: Sequence["Ranking"]) -> None:
    """Print the headline and the table of each ranking, and at the end how to read a table."""
    for ranking in found:
        typer.echo(ranking.headline)
        if ranking.answered is not None:
            # each part of a cell on its own line, so that five targets fit into 80 columns
            heads, *lines = ([cell.replace(", ", "\n") for cell in line]
                             for line in (ranking.heads, *ranking.body))  # fmt: skip
            print_table([*heads[:-1], "smallest\nerror"], lines)
    if tables := [ranking for ranking in found if ranking.answered is not None]:
        typer.echo(tables[-1].caption)
