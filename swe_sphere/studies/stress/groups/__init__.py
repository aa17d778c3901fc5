"""All groups of stress trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.studies.stress.groups.bottoms import BOTTOMS, DEPTH, MOUNTAIN
from swe_sphere.studies.stress.groups.hard_states import (
    GUARDS,
    LONG_STEPS,
    NOISE,
    PRECISION,
    RANDOM,
    STRETCHED,
)
from swe_sphere.studies.stress.groups.long_runs import GALEWSKY, MODONS, ROSSBY_HAURWITZ
from swe_sphere.studies.stress.groups.steady import PLANET_GROUP, REST, STEADY
from swe_sphere.studies.stress.trial import Group

__all__ = ["GROUPS", "choose"]

GROUPS = {
    group.name: group
    for group in (
        ROSSBY_HAURWITZ, GALEWSKY, STEADY, MOUNTAIN, BOTTOMS, DEPTH, NOISE, RANDOM, PRECISION,
        LONG_STEPS, STRETCHED, PLANET_GROUP, REST, MODONS, GUARDS,
    )
}  # fmt: skip
"""By name, in the order of the page."""


def choose(
    groups: Sequence[str] = (), steppers: Sequence[str] = (), quick: bool = False
) -> list[Group]:
    """The groups of those names (none: all) with the trials of those steppers (none: all).

    quick: only the trials of the quick form, as short as it has them.

    Raises:
        ConfigError: a name that there is not, or nothing that is left.
    """
    for name in groups:
        if name not in GROUPS:
            raise unknown_name("group of trials", name, GROUPS)
    wanted = {_scheme(name) for name in steppers}
    chosen = [_limited(GROUPS[name], wanted, quick) for name in groups or GROUPS]
    chosen = [group for group in chosen if group.trials]
    if not chosen:
        raise ConfigError("no trial is left: ask for other groups or steppers, or not --quick")
    return chosen


def _scheme(name: str) -> str:
    from swe_sphere.steppers import get_stepper

    return get_stepper(name).name


def _limited(group: Group, steppers: set[str], quick: bool) -> Group:
    trials = [trial for trial in group.trials if not steppers or trial.stepper in steppers]
    if quick:
        trials = [trial.quickly() for trial in trials if trial.quick is not None]
    return replace(group, trials=tuple(trials))
