"""What a sweep says, in sentences; every number with the row it comes from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from swe_sphere.studies.report import words
from swe_sphere.studies.report.palette import curves
from swe_sphere.studies.report.rows import Metric, Row
from swe_sphere.studies.report.saturation import Plateau, plateau
from swe_sphere.studies.report.statistics import (
    cheapest,
    error_levels,
    smallest,
    tiers,
    time_interval,
)

__all__ = ["Answer", "answers", "noise_sentence", "saturation_sentence", "settings"]


@dataclass(frozen=True)
class Answer:
    """A sentence on an error level."""

    text: str
    steppers: int
    """How many reach the level."""


LOUD = 0.3
"""A spread of wall times from which on they are of little use."""
PLACES = 3
"""So many places of a ranking are told in full."""


def answers(
    rows: Sequence[Row], metric: Metric, where: str, noise: float, levels: Sequence[float] = (),
    resolved: float = 0.0,
) -> list[Answer]:  # fmt: skip
    """Who reaches each error level, by wall time; levels with one answer share a sentence.

    rows: of one mesh.  where: for example "williamson5 at ne16 np4".  levels: None given, those
    of `error_levels`.  resolved: of smaller levels nothing is said, as the errors are not known
    that well.
    """
    names = settings(rows)
    levels = sorted(levels, reverse=True) or error_levels(rows, metric)
    levels = [level for level in levels if not level < resolved]
    same: dict[str, list[float]] = {}
    for level in levels:
        found = _ranking(cheapest(rows, metric, level), names, noise)
        same.setdefault(found or _nobody(rows, metric, names), []).append(level)
    told = [
        Answer(
            f"To reach {metric.symbol} ≤ {' or '.join(map(words.level, group))} on {where}: {text}",
            len(cheapest(rows, metric, group[-1])),
        )
        for text, group in same.items()
    ]
    return told + _smallest_of_all(rows, metric, levels)


def settings(rows: Iterable[Row]) -> dict[int, str]:
    """Row number -> the stepper and what tells its curve from the stepper's others."""
    return {row.number: curve.label for curve in curves(rows) for row in curve.rows}


def _ranking(found: list[Row], names: dict[int, str], noise: float) -> str:
    ranked = tiers(found, noise)
    parts = [_tier(tier, names, noise) for tier in ranked[:PLACES]]
    if not parts:
        return ""
    text = parts[0] + "".join(
        f"; {lead} {part}" for lead, part in zip(("next best", "then"), parts[1:], strict=False)
    )
    later = [names[row.number] for tier in ranked[PLACES:] for row in tier]
    return text + (f"; slower: {', '.join(later)}" if later else "") + "."


def _tier(tier: list[Row], names: dict[int, str], noise: float) -> str:
    entries = [
        f"{names[row.number]} at {words.step(row.dt)}, {words.seconds(row.wall_seconds)} "
        f"(row {row.number})"
        for row in tier
    ]
    if len(entries) == 1:
        return entries[0]
    spread = max(_uncertainty(row, noise) for row in tier)
    return (
        f"{', '.join(entries[:-1])} and {entries[-1]} – too close to rank, as the wall times are "
        f"uncertain by up to ±{words.percent(spread)}"
    )


def _uncertainty(row: Row, noise: float) -> float:
    low, high = time_interval(row, noise)
    return 0.5 * (high - low) / row.wall_seconds


def _nobody(rows: Sequence[Row], metric: Metric, names: dict[int, str]) -> str:
    best = smallest(rows, metric)
    if best is None:
        return "no run has such an error."
    return f"no stepper reaches it. The smallest error is {_best(best, metric, names)}."


def _smallest_of_all(rows: Sequence[Row], metric: Metric, levels: Sequence[float]) -> list[Answer]:
    """The smallest error of all, where every level is reached by somebody."""
    best = smallest(rows, metric)
    if best is None or not levels or best.error(metric) > min(levels):
        return []
    return [Answer(f"The smallest error of all is {_best(best, metric, settings(rows))}.", 0)]


def _best(row: Row, metric: Metric, names: dict[int, str]) -> str:
    return (
        f"{words.error(row.error(metric))}: {names[row.number]} at {words.step(row.dt)}, "
        f"{words.seconds(row.wall_seconds)} (row {row.number})"
    )


def saturation_sentence(rows: Sequence[Row], metric: Metric, where: str, slow: bool) -> str:
    """What an error that does not depend on the step means; empty where it does depend on it.

    slow: whether the slow-flow error was measured too.
    """
    found = plateau(rows, metric)
    if found is None:
        return ""
    if found.everywhere:
        return _mesh_error(found, metric, where)
    text = (
        f"On {where} {metric.symbol} saturates: at steps from {words.step(found.shortest.dt)} to "
        f"{words.step(found.longest.dt)} it stays between {words.error(found.lowest.error(metric))}"
        f" (row {found.lowest.number}) and {words.error(found.highest.error(metric))} "
        f"(row {found.highest.number}), while {found.best.stepper} at "
        f"{words.step(found.best.dt)} reaches {words.error(found.best.error(metric))} "
        f"(row {found.best.number})."
    )
    return text + (_TRANSIENT if slow else _FAST)


_RULE = "Steppers are ranked only where they differ by more."
_LOUD = (
    "That was too noisy a machine to compare steppers by wall time unless they differ greatly; "
    "iterations and right-hand sides do not depend on it. "
)
_TRANSIENT = (
    " The start sheds gravity waves, which every long step damps or dephases: this error is "
    "their size whatever the step and says nothing on the flow that stays. The slow-flow error "
    "below ranks the steppers by that."
)
_FAST = " Long steps do not follow the fast waves, whatever the step; what is slow may be as good."


def _mesh_error(found: Plateau, metric: Metric, where: str) -> str:
    return (
        f"On {where} {metric.symbol} does not depend on the step: up to "
        f"{words.step(found.longest.dt)} it stays below {words.error(found.highest.error(metric))} "
        f"(row {found.highest.number}), and no shorter step gets below half of "
        f"{words.error(found.lowest.error(metric))} (row {found.lowest.number}). This is the error "
        "of the mesh."
    )


def noise_sentence(rows: Iterable[Row], noise: float) -> str:
    """How far wall times can be trusted."""
    compared = [row for row in rows if row.compared]
    spreads = [row.wall_spread for row in compared if math.isfinite(row.wall_spread)]
    repeats = max((len(row.walls) for row in compared), default=0)
    timed = {0: "", 1: "Each run was timed once. "}.get(
        repeats, f"Wall times are medians of up to {repeats} repeats. "
    )
    worst = f"Repeats of a run differed by up to {words.percent(max(spreads))}. " if spreads else ""
    calibration = (
        f"A calibration run on this machine varied by {words.percent(noise)}. "
        if math.isfinite(noise)
        else "No calibration run says how noisy the machine was. "
    )
    loud = max([noise, *spreads], default=math.nan) > LOUD
    return timed + worst + calibration + (_LOUD if loud else "") + _RULE
