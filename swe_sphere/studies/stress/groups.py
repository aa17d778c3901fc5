"""All groups of stress trials, from the files in `groups/`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.studies.configuration import read_tables
from swe_sphere.studies.stress.trial import Group, Table

__all__ = ["choose", "groups", "read_group"]

FILES = (
    "rossby-haurwitz", "galewsky", "steady", "mountain", "bottoms", "depth", "noise", "random",
    "precision", "long-steps", "stretched", "planets", "rest", "modons", "guards",
)  # fmt: skip
"""In the order of the page."""


@cache
def groups() -> Mapping[str, Group]:
    """All groups by name."""
    folder = Path(str(resources.files("swe_sphere.studies.stress"))) / "groups"
    return {name: read_group(folder / f"{name}.toml") for name in FILES}


def read_group(path: Path) -> Group:
    """The group in a file; ConfigError for one that is not as its schema says."""
    whole, tables = read_tables(path, "trial", Table)
    trials = tuple(trial for table in tables for trial in table.trials())
    return Group(path.stem, str(whole["title"]), str(whole["text"]), trials)


def choose(
    names: Sequence[str] = (), steppers: Sequence[str] = (), quick: bool = False
) -> list[Group]:
    """The groups of those names (none: all) with the trials of those steppers (none: all).

    quick: only the trials of the quick form, as short as it has them.

    Raises:
        ConfigError: a name that there is not, or nothing that is left.
    """
    from swe_sphere.steppers import get_stepper

    for name in names:
        if name not in groups():
            raise unknown_name("group of trials", name, groups())
    wanted = {get_stepper(name).name for name in steppers}
    chosen = [_limited(groups()[name], wanted, quick) for name in names or groups()]
    chosen = [group for group in chosen if group.trials]
    if not chosen:
        raise ConfigError("no trial is left: ask for other groups or steppers, or not --quick")
    return chosen


def _limited(group: Group, steppers: set[str], quick: bool) -> Group:
    trials = [trial for trial in group.trials if not steppers or trial.stepper in steppers]
    if quick:
        trials = [trial.quickly() for trial in trials if trial.quick is not None]
    return replace(group, trials=tuple(trials))
