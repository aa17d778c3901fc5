"""`swe-sphere verify`: run the verification cases and compare their numbers with the bounds."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swe_sphere.cli.options import AsJson, Jobs, check_resumed
from swe_sphere.cli.show import Stopped, print_table, show_line
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import clear_errors, write_whole
from swe_sphere.settings.values import names_in
from swe_sphere.simulation.loop import Interrupted

if TYPE_CHECKING:
    from swe_sphere.studies.cases import Family, Measure, Row
    from swe_sphere.studies.record_store import Store

PAGE = "verification.md"
NUMBERS = "verification.json"


def verify(
    context: typer.Context,
    quick: Annotated[
        bool, typer.Option("--quick", help="Only the cheap rows, in less than a minute.")
    ] = False,
    scenes: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only these scenes, or cases by name.")
    ] = None,
    launch: Annotated[
        str | None,
        typer.Option(metavar="element|node", help="Shape of kernel launches; GPUs have node."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR|FILE.md", help="Write the page; into a folder, numbers too."),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on after an interrupted run of this code.")
    ] = False,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Measure errors, orders and invariants of the scenes; fail where a bound does not hold."""
    from swe_sphere.studies.cases import choose_verification
    from swe_sphere.studies.jobs import checked_jobs

    checked_jobs(jobs)
    check_resumed(resume, out)
    chosen = choose_verification(names_in(scenes), quick, launch)
    files = _files(out)
    if not chosen:
        raise ConfigError(f"nothing of {scenes} is in the quick form: leave out --quick")
    try:
        with _kept(files, resume) as runs:
            rows = _run(chosen, as_json, runs, jobs)
            result = _result(rows, quick) | ({"jobs": jobs} if jobs > 1 else {})
            words = [word for word in context.obj if word != "--resume"]
            _write(files, rows, result, shlex.join(["swe-sphere", *words]))
    except Interrupted as error:
        hint = "; resume with --resume" if files else ""
        raise Stopped(f"{error}{hint}") from None
    typer.echo(json.dumps(result) if as_json else _conclusion(rows, files))
    return 0 if result["passed"] else 1


def _result(rows: Sequence[Row], quick: bool) -> dict[str, object]:
    return {
        "passed": all(row.passed for row in rows),
        "quick": quick,
        "seconds": sum(row.seconds for row in rows),
        "rows": [row.as_dict() for row in rows],
    }


@contextmanager
def _kept(files: Sequence[Path], resume: bool) -> Iterator[Store[Measure] | None]:
    """Hold the folder of measures until the page is written; resume: whether old ones count."""
    from swe_sphere.studies.cases import Measure
    from swe_sphere.studies.record_store import Store

    if not files:
        yield None
        return
    runs = Store(files[0].with_suffix(".runs"), Measure)
    with runs.unfinished():
        if not resume:
            runs.records.clear()
        yield runs


def _write(files: Sequence[Path], rows: Sequence[Row], result: object, command: str) -> None:
    from swe_sphere.studies.cases.page import verification_page

    if files:
        write_whole(files[0], verification_page(rows, command))
    for file in files[1:]:
        write_whole(file, json.dumps(result, indent=1, ensure_ascii=False) + "\n")


def _run(
    chosen: Sequence[Family], quiet: bool, runs: Store[Measure] | None, jobs: int
) -> list[Row]:
    """Run all cases; print the table of each family as soon as it is complete."""
    from swe_sphere.studies.cases import cases_of, run_cases

    known = {found.fingerprint: found for found in (runs.records if runs else ())}
    tick = None if quiet else show_line
    found = run_cases(cases_of(chosen), known, None if runs is None else runs.add, jobs, tick)
    rows: list[Row] = []
    for family in chosen:
        mine = [*islice(found, sum(len(case.levels) for case in family.cases))]
        rows += mine
        if not quiet:
            show_line("")
            styles = ["" if row.passed else "bold red" for row in mine]
            print_table(HEADS, map(_cells, mine), title=family.title, row_styles=styles)
    return rows


HEADS = ("case", "ne", "np", "Δt [s]", "l2(h)", "l2(v)", "order", "of bound", "")


def _cells(row: Row) -> Iterator[str]:
    numbers, config = row.quantities, row.config
    yield from (row.case.name, str(config.ne), str(config.np))
    yield "" if row.case.method == "start" else f"{row.dt:.4g}"
    yield from (f"{numbers[name]:.2e}" if name in numbers else "" for name in ("l2_h", "l2_v"))
    yield f"{numbers['order']:.1f}" if "order" in numbers else ""
    yield f"{row.worst.used:.2f}"
    yield "" if row.passed else f"FAILED: {row.measure.reason or row.worst}"


def _conclusion(rows: Sequence[Row], files: Sequence[Path]) -> str:
    failed = sum(not row.passed for row in rows)
    verdict = f"{failed} of {len(rows)} rows failed" if failed else f"all {len(rows)} rows passed"
    written = f"; written: {', '.join(map(str, files))}" if files else ""
    return verdict + written


def _files(out: Path | None) -> list[Path]:
    """Return the page, and in a folder the numbers, checked before anything is run."""
    from swe_sphere.studies.pages import check_page

    if out is None:
        return []
    folder = out.parent if out.suffix == ".md" else out
    with clear_errors(f"cannot write to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    files = [out] if out.suffix == ".md" else [out / PAGE, out / NUMBERS]
    check_page(files[0], "Verification")
    return files
