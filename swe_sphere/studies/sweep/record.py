"""What the journal keeps of a run, and of the machine while the runs went on."""

from __future__ import annotations

from typing import Any

from swe_sphere.studies.sweep.case import Case
from swe_sphere.studies.sweep.execute import Outcome
from swe_sphere.studies.sweep.judge import Errors

__all__ = ["Verdict", "calibration_record", "run_record"]

Verdict = dict[str, dict[float, Errors]]
"""Errors by kind and report day."""


def run_record(case: Case, repeat: int, outcome: Outcome, verdict: Verdict) -> dict[str, Any]:
    """A run as a line of the journal."""
    return {
        "record": "run",
        "key": case.key,
        "repeat": repeat,
        "row": _settings(case) | outcome.numbers | _ending(outcome),
        "errors": [
            {"kind": kind, "day": day, **errors}
            for kind, days in verdict.items()
            for day, errors in days.items()
        ],
    }


def calibration_record(case: Case, seconds: float) -> dict[str, Any]:
    """The time of one right-hand side [s] in a moment between two runs."""
    return {"record": "calibration", "bench": _bench(case), "seconds": seconds}


def _settings(case: Case) -> dict[str, Any]:
    config, bench = case.config, case.bench
    return {
        "scene": bench.scene.name,
        "stepper": config.stepper,
        "preconditioner": _preconditioner(case),
        **_bench(case),
        "settings": " ".join(config.settings),
        "dt": case.dt,
        "days_planned": case.schedule.days,
        "role": case.role,
        "gravity_limit": bench.limits.gravity,
        "advective_limit": bench.limits.advective,
    }


def _bench(case: Case) -> dict[str, Any]:
    mesh, config = case.bench.mesh, case.bench.config
    return {
        "ne": mesh.ne,
        "np": mesh.np,
        "stretch": mesh.stretch,
        "precision": config.precision,
        "device": config.device,
    }


def _preconditioner(case: Case) -> str:
    """As asked for, else the default of the stepper; nothing where it has none."""
    if case.refusal is not None:
        return case.config.preconditioner or ""
    return str(case.bench.options(case.config).get("preconditioner", ""))


def _ending(outcome: Outcome) -> dict[str, str]:
    return {"status": outcome.status, "reason": outcome.reason}
