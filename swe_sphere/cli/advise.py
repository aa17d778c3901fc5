"""`swe-sphere advise`: a scene and an error to a stepper, a step, a preconditioner, and reasons."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from swe_sphere.cli.options import given, with_flags
from swe_sphere.cli.show import print_table
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, HOUR
from swe_sphere.settings.values import validated
from swe_sphere.studies.advice.advise import Question

if TYPE_CHECKING:
    from swe_sphere.studies.advice import Advice
    from swe_sphere.studies.advice.advise import Candidate

SHOWN = 8
"""Methods in the table."""


@with_flags(Question, argument="scene")
def advise(**values: Any) -> None:
    """Say which stepper, step and preconditioner are cheapest for an error, and why."""
    from rich.console import Console

    from swe_sphere.studies.advice import advise as advice_on

    if values["error"] is None:
        raise ConfigError("error: say how large the slow-flow error may be (--error 1e-3)")
    advice = advice_on(validated(Question, given(values, Question)))
    console = Console(markup=False, highlight=False)
    console.print(_situation(advice), soft_wrap=True)
    least = advice.candidates[0].cost
    lines = [_line(one, least) for one in _shown(advice)]
    print_table(HEADS, lines)
    console.print(_reason(advice), soft_wrap=True)
    typer.echo(f"  {advice.command}")


def _situation(advice: Advice) -> str:
    """The numbers that it follows from."""
    of, space = advice.setting, advice.space
    damping = "no hyperviscosity"
    if of.dissipation:
        damping = f"dissipation {of.dissipation * of.gravity_limit:.2g} per gravity limit"
    return (
        f"{space.scene.name}, {space.label}, {of.seconds / DAY:g} days: U/c = {of.froude:.2g};"
        f" limits of leapfrog: {of.gravity_limit:.4g} s by gravity waves,"
        f" {of.advective_limit:.4g} s by the wind alone; the slow flow changes in"
        f" {_hours(of.change)} h, its tendency in {_hours(of.turning)} h; {damping}"
    )


def _hours(rate: float) -> str:
    return f"{1.0 / rate / HOUR:.2g}" if rate else "∞"


HEADS = ("stepper", "Δt [s]", "bound by", "cost/day", "ratio", "error", "×÷")


def _line(one: Candidate, least: float) -> tuple[str, ...]:
    """Its cells in the table; least: cost of the cheapest."""
    numbers = one.method.stepper, f"{one.dt:.4g}", one.bound, f"{one.cost:.0f}"
    error = f"{one.error:.1e}", f"{one.method.doubt:.1f}"
    return *numbers, f"{one.cost / least:.2f}", *error


def _shown(advice: Advice) -> list[Candidate]:
    """The cheapest, and of each family the best."""
    families: dict[str, Candidate] = {}
    for one in advice.candidates:
        families.setdefault(_family(one), one)
    return [
        one for i, one in enumerate(advice.candidates) if i < SHOWN or one is families[_family(one)]
    ]


def _family(of: Candidate) -> str:
    from swe_sphere.steppers import STEPPERS

    return STEPPERS[of.method.stepper].family


def _reason(advice: Advice) -> str:
    """Why the first is the cheapest, in a sentence or two."""
    best, gravity = advice.candidates[0], advice.setting.gravity_limit
    explicit = _family(best) == "explicit"
    others = [one for one in advice.candidates if (_family(one) == "explicit") != explicit]
    kind = "step beyond the gravity waves" if explicit else "explicit step"
    text = (
        f"Predicted: costs in right-hand sides, errors to a factor ×÷. {best.method.stepper} takes"
        f" {best.dt / gravity:.2g} gravity limits at once"
    )
    if others:
        other = others[0]
        text += (
            f"; the best {kind}, {other.method.stepper} with {other.dt:.4g} s, costs"
            f" {other.cost / best.cost:.2g} times as much"
        )
    chosen = advice.config.preconditioner
    return f"{text}." + (f" Preconditioner {chosen}: its default." if chosen else "")
