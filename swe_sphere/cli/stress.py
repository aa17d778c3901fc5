"""`swe-sphere stress`: run the stability cases, print each outcome, keep a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swe_sphere.cli.options import AsJson, Jobs, check_resumed
from swe_sphere.cli.show import Stopped, show_line
from swe_sphere.settings.values import names_in
from swe_sphere.simulation.loop import Interrupted

if TYPE_CHECKING:
    from swe_sphere.studies.cases import Case, Measure, Row
    from swe_sphere.studies.cases.store import StabilityStore


def stress(
    quick: Annotated[
        bool, typer.Option("--quick", help="A short form of some cases, in less than a minute.")
    ] = False,
    groups: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only these groups of cases.")
    ] = None,
    steppers: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only cases of these steppers.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.md", help="Write the page after each case, and FILE.json."),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Leave out cases whose result FILE.json has, of this code."),
    ] = False,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Run what is hard to survive, against criteria decided beforehand; fail where one fails."""
    from swe_sphere.studies.cases import OUTCOMES, cases_of, choose_stability
    from swe_sphere.studies.cases.store import StabilityStore
    from swe_sphere.studies.jobs import checked_jobs
    from swe_sphere.studies.pages import check_page

    checked_jobs(jobs)
    check_resumed(resume, out)
    if out is not None:
        check_page(out, "Stability")
    cases = cases_of(choose_stability(names_in(groups), names_in(steppers), quick))
    store = None if out is None else StabilityStore(out, quick)
    known = store.known if store is not None and resume else {}
    try:
        with nullcontext() if store is None else store.unfinished():
            rows = _run(cases, known, store, jobs, quiet=as_json)
    except Interrupted as error:
        rest = "" if store is None else "; resume with --resume"
        raise Stopped(f"{error}{rest}") from None
    counts = {name: sum(row.outcome == name for row in rows) for name in OUTCOMES}
    results = [row.as_result() for row in rows]
    text = ", ".join(f"{count} {name}" for name, count in counts.items())
    typer.echo(json.dumps({"quick": quick, **counts, "results": results}) if as_json else text)
    return 1 if counts["failed"] else 0


def _run(
    cases: Sequence[Case],
    known: dict[str, Measure],
    store: StabilityStore | None,
    jobs: int,
    quiet: bool,
) -> list[Row]:
    """Run all cases that are not known; print their outcomes."""
    from swe_sphere.studies.cases import run_cases

    left = sum(case.fingerprint(case.levels[0]) not in known for case in cases)
    rows: list[Row] = []
    count = 0

    def tick(text: str) -> None:
        if not quiet:
            show_line(f"[{count + 1}/{left}] {text}")

    for row in run_cases(cases, known, None if store is None else store.add, jobs, tick):
        rows.append(row)
        if row.measure.fingerprint in known or quiet:
            continue
        count += 1
        show_line("")
        typer.echo(f"[{count}/{left}] {row.case.name}: {_in_words(row)}")
    return rows


def _in_words(row: Row) -> str:
    """Return the outcome in a line."""
    seconds = row.quantities.get("seconds", 0.0)
    reason = f": {row.reason}" if row.reason else ""
    return f"{row.outcome} ({seconds:.1f} s){reason}"
