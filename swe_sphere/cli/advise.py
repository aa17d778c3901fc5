"""`swe-sphere advise`: a scene and an error to a stepper and a step, by a short search."""

from __future__ import annotations

from typing import Any

import typer

from swe_sphere.cli.options import given, with_flags
from swe_sphere.cli.show_sweep import show_rankings, watched
from swe_sphere.errors import ConfigError
from swe_sphere.settings.values import validated
from swe_sphere.studies.advise import Question
from swe_sphere.studies.advise import advise as advice_on


@with_flags(Question, argument="scene")
def advise(**values: Any) -> None:
    """Measure which stepper and step are cheapest for an error, and print the command."""
    if values["error"] is None:
        raise ConfigError("error: say how large the error may be at the end (--error 1e-3)")
    question = validated(Question, given(values, Question))
    with watched(question.scene, False, "interrupted by Ctrl-C") as terminal:
        advice = advice_on(question, terminal)
    target = advice.ranking.targets[0]
    shorter = (
        f"of {advice.of_days:g} days, with {target:.2g} in the place of {question.error:g}: errors"
        " are taken to grow in proportion to the days."
    )
    rest = "days." if advice.days == advice.of_days else shorter
    typer.echo(f"Measured over {advice.days:g} {rest}")
    show_rankings([advice.ranking])
    typer.echo(f"  {advice.command}")
