"""Recipes: plans in TOML files, of the package or of the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.simulation.config import by_field
from swe_sphere.studies.sweep.sweep_plan import SweepPlan, make_plan
from swe_sphere.toml_file import read_toml

__all__ = ["Recipe", "load_recipe", "recipe_names"]

@dataclass(frozen=True)
class Recipe:
    """Sweeps that belong together."""

    title: str
    sweeps: tuple[dict[str, Any], ...]
    """Values of a plan for each, with the names of `SweepPlan`."""
    introduction: str = ""
    """Markdown before the results of all."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Markdown after the results of a scene."""

    def plans(self, flags: Mapping[str, object]) -> list[SweepPlan]:
        """The plans, with the values of flags in the place of the recipe's.

        A scene among them chooses the sweeps of that scene.  Raises ConfigError for a scene that
        the recipe does not have, and as `make_plan`.
        """
        scene = flags.get("scene")
        chosen = [values for values in self.sweeps if scene in (None, values.get("scene"))]
        if not chosen:
            scenes = ", ".join(str(values.get("scene")) for values in self.sweeps)
            raise ConfigError(f"the recipe has no scene {scene!r}; it has {scenes}")
        return [make_plan(values | {**flags}) for values in chosen]


def recipe_names() -> list[str]:
    """Names of the recipes that come with the package."""
    return sorted(path.stem for path in _folder().iterdir() if path.suffix == ".toml")


def load_recipe(name: str) -> Recipe:
    """The recipe of that name, or in the TOML file of that path.

    A file has a `title`, perhaps an `introduction`, keys that all sweeps share, and for each a
    table [[sweep]], perhaps with a `note`; or just the keys of one sweep.  Raises ConfigError if
    there is no such recipe or it cannot be read.
    """
    path = Path(name)
    if path.suffix != ".toml":
        if name not in recipe_names():
            raise unknown_name("recipe", name, recipe_names())
        path = _folder() / f"{name}.toml"
    table = read_toml(path)
    title, introduction = str(table.pop("title", path.stem)), str(table.pop("introduction", ""))
    sweeps = table.pop("sweep", [{}])
    if not isinstance(sweeps, list) or not all(isinstance(each, dict) for each in sweeps):
        raise ConfigError(f"{path}: sweeps are tables [[sweep]]")
    notes = {str(each.get("scene")): str(each.pop("note")) for each in sweeps if "note" in each}
    return Recipe(title, tuple(by_field(table | each) for each in sweeps), introduction, notes)


def _folder() -> Path:
    return Path(str(resources.files("swe_sphere.studies.sweep"))) / "recipes"
