"""`swe-sphere stress`: run the stress trials, tell each outcome, keep a page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from itertools import compress
from operator import not_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swe_sphere.cli.options import AsJson, Jobs, check_resumed
from swe_sphere.cli.show import Stopped, show_line
from swe_sphere.settings.values import names_in
from swe_sphere.simulation.interrupt import Interrupted

if TYPE_CHECKING:
    from swe_sphere.studies.stress import Result, Store, Trial


def stress(
    quick: Annotated[
        bool, typer.Option("--quick", help="A short form of some trials, in less than a minute.")
    ] = False,
    groups: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only these groups of trials.")
    ] = None,
    steppers: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only trials of these steppers.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.md", help="Write the page after each trial, and FILE.json."),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Leave out trials whose result FILE.json has, of this code."),
    ] = False,
    jobs: Jobs = 1,
    as_json: AsJson = False,
) -> int:
    """Run what is hard to survive, against criteria decided beforehand; fail where one fails."""
    from swe_sphere.studies.jobs import checked_jobs
    from swe_sphere.studies.pages import check_page
    from swe_sphere.studies.stress import OUTCOMES, Store, choose

    checked_jobs(jobs)
    check_resumed(resume, out)
    if out is not None:
        check_page(out, "Stability")
    chosen = choose(names_in(groups), names_in(steppers), quick)
    trials = [trial for group in chosen for trial in group.trials]
    store = None if out is None else Store(out, quick)
    kept: list[Result] = []
    if store is not None and resume:
        known = [store.known(trial.name, trial.fingerprint) for trial in trials]
        trials = [*compress(trials, (result is None for result in known))]
        kept = [result for result in known if result is not None]
    try:
        with nullcontext() if store is None else store.unfinished():
            results = kept + _run(trials, store, jobs, quiet=as_json)
    except Interrupted as error:
        rest = "" if store is None else "; --resume goes on after the last trial"
        raise Stopped(f"{error}{rest}") from None
    counts = {name: sum(result.outcome == name for result in results) for name in OUTCOMES}
    plain = [json.loads(result.as_text()) for result in results]  # NaN is null
    told = ", ".join(f"{count} {name}" for name, count in counts.items())
    typer.echo(json.dumps({"quick": quick, **counts, "results": plain}) if as_json else told)
    return 1 if counts["failed"] else 0


def _run(trials: list[Trial], store: Store | None, jobs: int, quiet: bool) -> list[Result]:
    """Make them, those that are timed alone and last."""
    results: list[Result] = []

    def tick(text: str) -> None:
        if not quiet:
            show_line(f"[{len(results) + 1}/{len(trials)}] {text}")

    for result in _results(trials, jobs, tick):
        results.append(result)
        if store is not None:
            store.add(result)
        if not quiet:
            show_line("")
            typer.echo(f"[{len(results)}/{len(trials)}] {result.name}: {_told(result)}")
    return results


def _results(trials: list[Trial], jobs: int, tick: Callable[[str], None]) -> Iterator[Result]:
    from swe_sphere.studies.stress import tried_beside, try_out

    alone = [jobs == 1 or trial.timed for trial in trials]
    yield from tried_beside(jobs, [*compress(trials, map(not_, alone))])
    for trial in compress(trials, alone):
        yield try_out(trial, partial(_tick, tick, trial.name))


def _tick(tick: Callable[[str], None], name: str, text: str) -> None:
    tick(f"{name}: {text}")


def _told(result: Result) -> str:
    """The outcome in a line."""
    seconds = result.numbers.get("seconds") or 0.0
    reason = f": {result.reason}" if result.reason else ""
    return f"{result.outcome} ({seconds:.1f} s){reason}"
