"""From how a trial ended to its outcome: passed, refused, broke or failed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from swe_sphere.studies.stress.attempt import Ended, Tick
from swe_sphere.studies.stress.methods import measure
from swe_sphere.studies.stress.trial import Trial

__all__ = ["Result", "judge", "try_out"]

STOPPED = ("refused", "unstable", "solver-failed")
"""Ways in which a run ends itself and says why."""


@dataclass(frozen=True)
class Result:
    """What came of a trial, in plain numbers and words."""

    name: str
    stepper: str
    outcome: str
    """passed, refused, broke or failed."""
    reason: str
    """Why it did not pass."""
    numbers: dict[str, float] = field(default_factory=dict)
    bounds: tuple[str, ...] = ()
    fingerprint: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For JSON: what is not finite is None."""
        numbers = {n: x if math.isfinite(x) else None for n, x in self.numbers.items()}
        return {**self.__dict__, "numbers": numbers, "bounds": list(self.bounds)}


def try_out(trial: Trial, tick: Tick | None = None) -> Result:
    """Run the trial and judge it."""
    return judge(trial, measure(trial, tick))


def judge(trial: Trial, ended: Ended) -> Result:
    """Compare how it ended with what was decided beforehand."""
    outcome, reason = _verdict(trial, ended)
    return Result(
        trial.name, trial.stepper, outcome, reason, ended.numbers,
        tuple(str(bound) for bound in trial.bounds), trial.fingerprint,
    )  # fmt: skip


def _verdict(trial: Trial, ended: Ended) -> tuple[str, str]:
    if ended.status in STOPPED:
        broken = _broken(trial, ended, refused=True)
        if trial.expect == "pass" or broken:
            return _beyond(trial), "; ".join([*broken, ended.reason])
        return "refused", ended.reason
    if ended.status != "completed":
        return "failed", f"{ended.status}: {ended.reason}"
    if trial.expect == "refuse":
        return "failed", "it was to be refused, but ran to its end"
    broken = _broken(trial, ended, refused=False)
    if broken:
        return _beyond(trial), "; ".join([*broken, *([ended.reason] if ended.reason else [])])
    return "passed", ended.reason


def _beyond(trial: Trial) -> str:
    """What it is called when a bound does not hold."""
    return "broke" if trial.expect == "break" else "failed"


def _broken(trial: Trial, ended: Ended, refused: bool) -> list[str]:
    """The bounds that do not hold, in words."""
    values = {bound: ended.numbers.get(bound.quantity, math.nan) for bound in trial.bounds}
    return [
        f"{bound.quantity} is {value:.4g}, not {bound}"
        for bound, value in values.items()
        if (bound.always or not refused) and not bound.holds(value)
    ]
