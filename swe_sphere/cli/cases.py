"""`swe-sphere verify` and `stress`: run cases, print their outcomes, keep pages of them."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from itertools import groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from swe_sphere.cli.options import AsJson, Jobs, check_resumed, flag, option
from swe_sphere.cli.show import Stopped, print_table, show_line
from swe_sphere.errors import ConfigError
from swe_sphere.files.durable import clear_errors, write_whole
from swe_sphere.settings.values import names_in
from swe_sphere.simulation.loop import Interrupted

if TYPE_CHECKING:
    from swe_sphere.studies.cases import Case, Measure, Row
    from swe_sphere.studies.record_store import Store

PAGE = "verification.md"
NUMBERS = "verification.json"
HEADS = ("case", "ne", "np", "Δt [s]", "l2(h)", "l2(v)", "order", "of bound", "")


def verify(
    context: typer.Context,
    quick: bool = flag("quick", "Only the cheap rows, in less than a minute."),
    scenes: str | None = option("A,B", "Only these scenes, or cases by name."),
    launch: str | None = option("element|node", "Shape of kernel launches; GPUs have node."),
    out: Path | None = option("DIR|FILE.md", "Write the page; into a folder, numbers too."),
    resume: bool = flag("resume", "Go on after an interrupted run of this code."),
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Measure errors, orders and invariants of the scenes; fail where a bound does not hold."""
    from swe_sphere.studies.cases import Measure, choose_verification, run_cases
    from swe_sphere.studies.cases.page import verification_page
    from swe_sphere.studies.record_store import Store

    _check(jobs, resume, out)
    cases = choose_verification(names_in(scenes), quick, launch)
    files = [] if out is None else _files(out)
    if not cases:
        raise ConfigError(f"nothing of {scenes} is in the quick form: leave out --quick")
    store = Store(files[0].with_suffix(".runs"), Measure) if files else None
    tick = None if as_json else show_line
    with _held(store):
        found = run_cases(cases, _known(store, resume), store, jobs, tick)
        rows = list(found) if as_json else _shown_by_family(cases, found)
        failed = sum(not row.passed for row in rows)
        result = {
            "passed": not failed, "quick": quick, "seconds": sum(row.seconds for row in rows),
            "rows": [row.as_dict() for row in rows], **({"jobs": jobs} if jobs > 1 else {}),
        }  # fmt: skip
        words = [word for word in context.obj if word != "--resume"]
        for file in files[:1]:
            write_whole(file, verification_page(rows, shlex.join(["swe-sphere", *words])))
        for file in files[1:]:
            write_whole(file, json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    if as_json:
        typer.echo(json.dumps(result))
    else:
        text = f"{failed} of {len(rows)} rows failed" if failed else f"all {len(rows)} rows passed"
        typer.echo(text + (f"; written: {', '.join(map(str, files))}" if files else ""))
    return 1 if failed else 0


def stress(
    quick: bool = flag("quick", "A short form of some cases, in less than a minute."),
    groups: str | None = option("A,B", "Only these groups of cases."),
    steppers: str | None = option("A,B", "Only cases of these steppers."),
    out: Path | None = option("FILE.md", "Write the page after each case, and FILE.json."),
    resume: bool = flag("resume", "Leave out cases whose result FILE.json has, of this code."),
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Run what is hard to survive, against criteria decided beforehand; fail where one fails."""
    from swe_sphere.studies.cases import OUTCOMES, choose_stability, run_cases
    from swe_sphere.studies.cases.store import StabilityStore
    from swe_sphere.studies.pages import check_page

    _check(jobs, resume, out)
    if out is not None:
        check_page(out, "Stability")
    cases = choose_stability(names_in(groups), names_in(steppers), quick)
    store = None if out is None else StabilityStore(out, quick)
    known = _known(store, resume)
    left = sum(case.fingerprint(case.levels[0]) not in known for case in cases)
    rows: list[Row] = []
    made: list[Row] = []

    def tick(text: str) -> None:
        show_line(f"[{len(made) + 1}/{left}] {text}")

    with _held(store):
        for row in run_cases(cases, known, store, jobs, None if as_json else tick):
            rows.append(row)
            if row.measure.fingerprint not in known and not as_json:
                made.append(row)
                show_line("")
                reason = f": {row.reason}" if row.reason else ""
                text = f"{row.outcome} ({row.quantities.get('seconds', 0.0):.1f} s){reason}"
                typer.echo(f"[{len(made)}/{left}] {row.case.name}: {text}")
    counts = {name: sum(row.outcome == name for row in rows) for name in OUTCOMES}
    if as_json:
        results = [row.as_result() for row in rows]
        typer.echo(json.dumps({"quick": quick, **counts, "results": results}))
    else:
        typer.echo(", ".join(f"{count} {name}" for name, count in counts.items()))
    return 1 if counts["failed"] else 0


def _check(jobs: int, resume: bool, out: Path | None) -> None:
    from swe_sphere.studies.jobs import checked_jobs

    checked_jobs(jobs)
    check_resumed(resume, out)


def _known(store: Store[Measure] | None, resume: bool) -> Mapping[str, Measure]:
    """Return the stored measures that count, by fingerprint."""
    return {found.fingerprint: found for found in store.records} if store and resume else {}


@contextmanager
def _held(store: Store[Measure] | None) -> Iterator[None]:
    """Hold the folder of measures while the block makes and writes them."""
    try:
        with nullcontext() if store is None else store.unfinished():
            yield
    except Interrupted as error:
        hint = "" if store is None else "; resume with --resume"
        raise Stopped(f"{error}{hint}") from None


def _files(out: Path) -> list[Path]:
    """Return the page, and in a folder the numbers, checked before anything is run."""
    from swe_sphere.studies.pages import check_page

    files = [out] if out.suffix == ".md" else [out / PAGE, out / NUMBERS]
    with clear_errors(f"cannot write to {files[0].parent}"):
        files[0].parent.mkdir(parents=True, exist_ok=True)
    check_page(files[0], "Verification")
    return files


def _shown_by_family(cases: Sequence[Case], found: Iterator[Row]) -> list[Row]:
    """Return all rows; print the table of each family as soon as it is complete."""
    from swe_sphere.studies.cases import families

    rows: list[Row] = []
    for family, mine in groupby(cases, lambda case: case.family):
        complete = [*islice(found, sum(len(case.levels) for case in mine))]
        show_line("")
        title = families("verification")[family].title
        styles = ["" if row.passed else "bold red" for row in complete]
        print_table(HEADS, map(_cells, complete), title=title, row_styles=styles)
        rows += complete
    return rows


def _cells(row: Row) -> Iterator[str]:
    numbers, config = row.quantities, row.config
    yield from (row.case.name, str(config.ne), str(config.np))
    yield "" if row.case.method == "start" else f"{row.dt:.4g}"
    yield from (f"{numbers[name]:.2e}" if name in numbers else "" for name in ("l2_h", "l2_v"))
    yield f"{numbers['order']:.1f}" if "order" in numbers else ""
    yield f"{row.worst.used:.2f}"
    yield "" if row.passed else f"FAILED: {row.measure.reason or row.worst}"
