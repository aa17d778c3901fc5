"""`swe-sphere verify`, `stress` and `ensemble`: cases with their pages, and members of a scene."""

import json
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from swe_sphere.cli.options import AsJson, Jobs, flag, given, option, with_flags
from swe_sphere.cli.show import print_table, show_line
from swe_sphere.errors import ConfigError, Interrupted
from swe_sphere.files.durable import contents_of, translate_errors, write_whole
from swe_sphere.settings.values import names_in
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.summary import finite

if TYPE_CHECKING:
    from swe_sphere.studies.cases import Case, Row

HEADS = ("case", "ne", "np", "Δt [s]", "l2(h)", "l2(v)", "order(h)", "of bound")
NOT_OF_MEMBERS = (
    "out", "outputs", "plot", "live", "restart", "trust", "initial", "initial_time", "reference",
    "as_json", "quiet", "log",
)  # fmt: skip
"""Options of runs that do not apply to members of an ensemble."""
Describe = Callable[[Sequence["Row"]], dict[str, object]]


def verify(
    context: typer.Context,
    quick: bool = flag("quick", "Only inexpensive rows, in less than a minute."),
    scenes: str | None = option("A,B", "Only these scenes, or cases by name."),
    launch: str | None = option("element|node", "Shape of kernel launches; GPUs use node."),
    out: Path | None = option("DIR|FILE.md", "Write the page, and its numbers as FILE.json."),
    resume: bool = flag("resume", "Resume an interrupted run of the same code."),
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Measure errors, orders and invariants of the scenes; fail if a bound does not hold."""
    from swe_sphere.studies.cases import choose

    def describe(rows: Sequence["Row"]) -> dict[str, object]:
        return {
            "passed": all(row.passed for row in rows), "quick": quick,
            "seconds": sum(row.seconds for row in rows), "rows": [row.as_dict() for row in rows],
            **({"jobs": jobs} if jobs > 1 else {}),
        }  # fmt: skip

    cases = choose("verification", names_in(scenes), quick=quick, launch=launch)
    return _run(context, "verification", cases, describe)


def stress(
    context: typer.Context,
    quick: bool = flag("quick", "Short forms of some cases, in less than a minute."),
    groups: str | None = option("A,B", "Only these groups of cases, or cases by name."),
    steppers: str | None = option("A,B", "Only cases of these steppers."),
    out: Path | None = option("DIR|FILE.md", "Write the page, and its numbers as FILE.json."),
    resume: bool = flag("resume", "Resume an interrupted run of the same code."),
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Run hard cases, check them against bounds, and fail if one of them fails."""
    from swe_sphere.studies.cases import choose, count_outcomes

    def describe(rows: Sequence["Row"]) -> dict[str, object]:
        results = [row.as_result() for row in rows]
        return {"quick": quick, **count_outcomes(rows), "results": results}

    cases = choose("stability", names_in(groups), names_in(steppers), quick)
    return _run(context, "stability", cases, describe)


def _run(context: typer.Context, folder: str, cases: Sequence["Case"], describe: Describe) -> int:
    """Run cases of a folder, print them and write them as a page; return the exit status."""
    from swe_sphere.studies.cases import Measure, count_outcomes, page, run_cases
    from swe_sphere.studies.jobs import checked_jobs
    from swe_sphere.studies.record_store import Store

    options = ("quick", "out", "resume", "jobs", "as_json")
    quick, out, resume, jobs, as_json = (context.params[name] for name in options)
    checked_jobs(jobs)
    if resume and out is None:
        raise ConfigError("resume: name the page to resume with --out, or leave resume out")
    words = ["swe-sphere", str(context.info_name), *(["--quick"] if quick else [])]
    for name in ("scenes", "groups", "steppers", "launch"):
        if value := context.params.get(name):
            words += [f"--{name}", ",".join(names_in(value))]
    chosen = any(context.params.get(name) for name in ("scenes", "groups", "steppers"))
    file = None if out is None else _page_file(out, folder, quick, words if chosen else [])
    store = None if file is None else Store(file.with_suffix(".runs"), Measure)
    known = store.records if store and resume else ()
    try:
        with nullcontext() if store is None else store.unfinished():
            if file is not None and resume and file.exists() and not known:
                raise ConfigError(f"resume: {file} is finished: leave resume out to measure again")
            found = run_cases(cases, [*known], store, jobs, None if as_json else show_line)
            rows = list(found if as_json else _shown(found))
            result = finite(describe(rows))
            if file is not None:
                write_whole(file, page(folder, rows, shlex.join([*words, "--out", str(out)])))
                text = json.dumps(result, indent=1, ensure_ascii=False)
                write_whole(file.with_suffix(".json"), text + "\n")
    except Interrupted as error:
        raise Interrupted(f"{error}{'; resume with --resume' if file else ''}") from None
    counts = count_outcomes(rows)
    summary = ", ".join(f"{count} {name}" for name, count in counts.items())
    typer.echo(json.dumps(result) if as_json else summary)
    return 1 if counts["failed"] else 0


def _page_file(out: Path, folder: str, quick: bool, words: Sequence[str]) -> Path:
    """Return the file of the page, checked before anything is run.

    words: first words of the command for a page of chosen cases, which replaces no full page.
    """
    from swe_sphere.studies.pages import check_ours

    file = out if out.suffix == ".md" else out / f"{folder}.md"
    numbers = file.with_suffix(".json")
    with translate_errors(f"cannot write to {file.parent}"):
        file.parent.mkdir(parents=True, exist_ok=True)
    check_ours(file, f"# {folder.capitalize()}\n", what=f"is no {folder} page")
    if numbers.exists() and not file.exists():
        raise ConfigError(f"out: {numbers} belongs to another page and would be replaced: move it")
    with translate_errors(f"cannot read {numbers} or {file}"):
        if quick and numbers.exists() and b'"quick": true' not in contents_of(numbers):
            raise ConfigError(f"out: {numbers} is of the full form: choose another name")
        command = f"{shlex.join(words)} --out ".encode()
        if words and file.exists() and command not in contents_of(file):
            raise ConfigError(f"out: {file} is a page of other cases: choose another name")
    return file


def _shown(found: Iterator["Row"]) -> Iterator["Row"]:
    """Yield the rows; print each group's table, and why rows did not pass, after its last row."""
    from swe_sphere.studies.cases.rows import cells_of

    for _, group in groupby(found, lambda row: row.case.group):
        rows = [*group]
        show_line("")
        styles = ["" if row.passed else "bold red" for row in rows]
        cells = [*map(cells_of, rows)]
        heads = [head for head in HEADS if any(of[head] for of in cells)]
        lines = ([of[head] for head in heads] for of in cells)
        print_table(heads, lines, title=rows[0].case.group, row_styles=styles)
        for row in rows:
            if not row.passed:
                typer.echo(f"{row.case.name}: {row.outcome.upper()}: {row.reason}")
        yield from rows


@with_flags(RunConfig, argument="scene", without=NOT_OF_MEMBERS)
def ensemble(
    seeds: str = option("A,B,...|FIRST-LAST", "Seeds of the members.", "1-8"),
    field: str = option("NAME", "Field of the spread: vorticity, h, u, ...", "vorticity"),
    out: Path | None = option("FOLDER", "Files of the members (SCENE_ensemble)."),
    **values: Any,
) -> None:
    """Run a scene from several seeds, and show how their spread grows."""
    from swe_sphere.io.scalar_fields import check_field, derive
    from swe_sphere.studies.ensemble import MARKS, run_members, spread, spread_files, write_spread
    from swe_sphere.studies.pages import check_ours

    config = make_config(given(values, RunConfig))
    if not config.diagnostics:  # loading them is necessary to know their names
        check_field(field)
    if config.fields:
        derive(dict.fromkeys((*config.fields, "b", "f", "area"), np.ones(1)), field)
    place = out or Path(f"{Path(config.scene).stem}_ensemble")
    for path in () if config.overwrite else spread_files(field, place):
        check_ours(path, *MARKS, what="is not of an ensemble")
    found = spread(run_members(config, _seeds(seeds), place, typer.echo), field)
    typer.echo(f"{'day':>6}  {'spread':>10}  growth [1/day]")
    for day, value, rate in found.itertuples(index=False):
        typer.echo(f"{day:6.4g}  {value:10.4g}  {'–' if np.isnan(rate) else f'{rate:.3f}'}")
    for path in write_spread(found, field, place):
        typer.echo(path)


def _seeds(text: str) -> Sequence[int]:
    first, dash, last = text.partition("-")
    try:
        if dash:
            start = int(first)
            return range(start, min(int(last), start + 1000) + 1)  # over 1000 are refused later
        return [int(part) for part in names_in(text)]
    except ValueError:
        raise ConfigError(f"seeds: give whole numbers, 1,2,3 or 1-8, got {text!r}") from None
