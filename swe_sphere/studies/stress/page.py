"""The page of the stress trials, in Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from swe_sphere.studies.markdown import anchor, filled, table
from swe_sphere.studies.stress.groups import groups
from swe_sphere.studies.stress.result import OUTCOMES, Result
from swe_sphere.studies.stress.trial import Group, Trial

__all__ = ["page"]

Results = Mapping[str, Result]


def page(results: Results, quick: bool) -> str:
    """The page of these results, by name of trial, in the order of the groups."""
    return filled(
        "swe_sphere.studies.stress",
        "page.md",
        quick=" --quick" if quick else "",
        seconds=sum(result.numbers.get("seconds") or 0.0 for result in results.values()),
        summary="\n".join(_summary(results)).rstrip("\n"),
        groups="\n".join(line for group in groups().values() for line in _group(group, results)),
    )


def _summary(results: Results) -> Iterator[str]:
    """How many trials of each group came to which outcome."""
    counts = {
        group.title: Counter(
            results[trial.name].outcome if trial.name in results else "not run"
            for trial in group.trials
        )
        for group in groups().values()
    }
    columns = (*OUTCOMES, "not run")
    yield from table(
        ("group", *columns),
        [
            (f"[{title}](#{anchor(title)})", *(str(count[name]) for name in columns))
            for title, count in counts.items()
            if count.keys() - {"not run"}
        ],
    )


def _group(group: Group, results: Results) -> Iterator[str]:
    mine = [trial for trial in group.trials if trial.name in results]
    if not mine:
        return
    yield f"## {group.title}\n"
    yield f"{group.text}\n"
    rows = [_row(trial, results[trial.name]) for trial in mine]
    yield from table(("trial", "Δt [s]", "× 1/ρ", "outcome", "numbers"), rows)
    yield from _reasons([results[trial.name] for trial in mine])


def _row(trial: Trial, result: Result) -> list[str]:
    numbers, outcome = result.numbers, result.outcome
    names = dict.fromkeys([*(bound.quantity for bound in trial.all_bounds), *trial.report])
    told = [f"{name} {_short(numbers[name], name)}" for name in names if name in numbers]
    if outcome != "passed" and numbers.get("last_day") is not None:
        told.append(f"last_day {_short(numbers['last_day'])}")
    marked = f"**{outcome}**" if outcome in ("broke", "failed") else outcome
    steps = [_short(numbers[x]) if x in numbers else "" for x in ("dt", "dt_over_gravity")]
    return [trial.name, *steps, marked, ", ".join(told)]


def _reasons(results: list[Result]) -> Iterator[str]:
    """Each reason once, with the trials that it is of."""
    reasons: dict[str, list[str]] = {}
    for result in results:
        if result.reason:
            reasons.setdefault(f"{result.outcome}: {result.reason}", []).append(result.name)
    for reason, names in reasons.items():
        yield f"* `{'`, `'.join(names)}` {reason}"
    if reasons:
        yield ""


def _short(value: float | None, name: str = "") -> str:
    if value is None:
        return "none" if name == "symmetry_day" else "–"
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.4g}"
