"""From how a trial ended to its outcome: passed, refused, broke or failed."""

from __future__ import annotations

import math

from swe_sphere.studies import store
from swe_sphere.studies.bounds import Check
from swe_sphere.studies.ended import STOPPED, Ended
from swe_sphere.studies.stress.methods import Tick, measure
from swe_sphere.studies.stress.trial import Trial

__all__ = ["OUTCOMES", "Result", "judge", "try_out"]

OUTCOMES = ("passed", "refused", "broke", "failed")


class Result(store.Result):
    """What came of a trial; `reason` says why it did not pass."""

    name: str
    stepper: str
    outcome: str
    """One of `OUTCOMES`."""
    bounds: tuple[str, ...] = ()


def try_out(trial: Trial, tick: Tick | None = None) -> Result:
    """Run the trial and judge it."""
    return judge(trial, measure(trial, tick))


def judge(trial: Trial, ended: Ended) -> Result:
    """Compare how it ended with what was decided beforehand."""
    outcome, reasons = _verdict(trial, ended)
    return Result(
        name=trial.name,
        stepper=trial.stepper,
        outcome=outcome,
        reason="; ".join(filter(None, reasons)),
        numbers=ended.numbers,
        bounds=tuple(str(bound) for bound in trial.all_bounds),
        fingerprint=trial.fingerprint,
    )


def _verdict(trial: Trial, ended: Ended) -> tuple[str, list[str]]:
    """The outcome, and why it is not another one."""
    stopped = ended.status in STOPPED
    if not (stopped or ended.completed):
        return "failed", [f"{ended.status}: {ended.reason}"]
    if not stopped and trial.expect == "refuse":
        return "failed", ["it was to be refused, but ran to its end"]
    reasons = [*_broken(trial, ended, stopped), ended.reason]
    if len(reasons) > 1 or (stopped and trial.expect == "pass"):
        return ("broke" if trial.expect == "break" else "failed"), reasons
    return ("refused" if stopped else "passed"), reasons


def _broken(trial: Trial, ended: Ended, stopped: bool) -> list[str]:
    """The bounds that do not hold, in words."""
    checks = [
        Check(bound, ended.numbers.get(bound.quantity, math.nan))
        for bound in trial.all_bounds
        if bound.always or not stopped
    ]
    return [str(check) for check in checks if not check.holds]
