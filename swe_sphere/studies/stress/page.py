"""The page of the stress trials, in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from swe_sphere.machine import versions
from swe_sphere.studies.stress.groups import GROUPS
from swe_sphere.studies.stress.trial import Group, Trial

__all__ = ["page"]

Results = Mapping[str, Mapping[str, Any]]

HEAD = """# Stability

Hard runs, each with a criterion, for every stepper for which it makes sense. Criteria were decided
before the first runs; those that a first look at results changed are named at the end. Made by

    swe-sphere stress{quick} --out docs/stability.md

which writes this page and the numbers beside it after every trial; `--groups A,B` and
`--steppers A,B` run some of them again, `--resume` those that have not been run. Python {python},
Warp {warp}, one CPU core, {seconds:.0f} s altogether.

A trial **passed** when it ran to its end within all its bounds. It was **refused** when the
program stopped it and said why, where that is an answer that was admitted beforehand: then no state
that makes no sense was shown or written. It **broke** when a bound did not hold in a run without
dissipation that is followed by the same run with a remedy, which must pass. Anything else
**failed**: any other bound that does not hold, a stop that was not admitted, the time limit, an
error that is none of ours. Nothing is switched on silently: a trial whose name has a `+` is the one
before it with that effect switched on, as `--set` does it.

Unless said otherwise: np 4, float64, no dissipation, the step that the model chooses by itself
(0.85 of the stability limit, 0.45 for steppers that treat gravity waves implicitly and the wind
not, and without a limit advective Courant number 2 and at most an hour).
Drifts and winds are the largest of the whole run, depths the least; about 120 samples a run.

| group | passed | refused | broke | failed | not run |
|---|---|---|---|---|---|
{summary}
"""

TAIL = """## Criteria that were changed

After a first look at results, and so not decided beforehand:

* random states: a bound on the growth of the wind became Froude number ≤ 1, and the runs at most a
  day long;
* mountain, 60 days: the drift of energy became its gain, as hyperviscosity drains 0.4 %;
* noise on williamson5: a factor of 1.5 became 2.5;
* meshes stretched by 5 and 10 may break where the same run with viscosity passes;
* waves of 100 days may break where the same run with hyperviscosity passes;
* float32 on williamson6: ne 12 instead of 8;
* modons with tr-bdf2: a solver tolerance of 1e-6 instead of the default;
* steps beyond the limit: 5 days instead of 20, and split steppers may survive;
* the outcome "broke" itself, with the rule that the run with a remedy must pass.
"""


def page(results: Results, quick: bool) -> str:
    """The page of these results, by name of trial, in the order of the groups."""
    found = versions()
    head = HEAD.format(
        quick=" --quick" if quick else "",
        python=found["python"],
        warp=found["warp"],
        seconds=sum(entry["numbers"].get("seconds") or 0.0 for entry in results.values()),
        summary="\n".join(_summary(results)),
    )
    groups = (text for group in GROUPS.values() for text in _group(group, results))
    return "\n".join([head, *groups, TAIL])


def _summary(results: Results) -> Iterator[str]:
    for group in GROUPS.values():
        mine = [results.get(trial.name, {}).get("outcome", "") for trial in group.trials]
        count = Counter(mine)
        if any(mine):
            columns = ("passed", "refused", "broke", "failed", "")
            cells = " | ".join(str(count[name]) for name in columns)
            link = group.title.lower().replace(" ", "-")
            link = "".join(c for c in link if c.isalnum() or c == "-")
            yield f"| [{group.title}](#{link}) | {cells} |"


def _group(group: Group, results: Results) -> Iterator[str]:
    mine = [trial for trial in group.trials if trial.name in results]
    if not mine:
        return
    yield f"## {group.title}\n"
    yield f"{group.text}\n"
    yield "| trial | Δt [s] | × 1/ρ | outcome | numbers |"
    yield "|---|---|---|---|---|"
    yield from (_row(trial, results[trial.name]) for trial in mine)
    yield ""
    yield from _reasons(mine, results)


def _row(trial: Trial, entry: Mapping[str, Any]) -> str:
    numbers, outcome = entry["numbers"], entry["outcome"]
    names = dict.fromkeys([*(bound.quantity for bound in trial.bounds), *trial.report])
    told = [f"{name} {_short(numbers[name], name)}" for name in names if name in numbers]
    if outcome != "passed" and numbers.get("last_day") is not None:
        told.append(f"last_day {_short(numbers['last_day'])}")
    marked = f"**{outcome}**" if outcome in ("broke", "failed") else outcome
    steps = (_short(numbers.get(name, "")) for name in ("dt", "dt_over_gravity"))
    return f"| {trial.name} | {' | '.join(steps)} | {marked} | {', '.join(told)} |"


def _reasons(trials: list[Trial], results: Results) -> Iterator[str]:
    """Each reason once, with the trials that it is of."""
    reasons: dict[str, list[str]] = {}
    for trial in trials:
        entry = results[trial.name]
        if entry["reason"]:
            text = f"{entry['outcome']}: {entry['reason']}"
            reasons.setdefault(text, []).append(trial.name)
    for reason, names in reasons.items():
        yield f"* `{'`, `'.join(names)}` {reason}"
    if reasons:
        yield ""


def _short(value: object, name: str = "") -> str:
    if value is None:
        return "none" if name == "symmetry_day" else "–"
    if not isinstance(value, float):
        return str(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.4g}" if math.isfinite(value) else "–"
