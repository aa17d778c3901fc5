"""One run of a study: what `swe-sphere run` can be told, and scenes that only studies want."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError, unknown_name
from swe_sphere.settings.values import SCENE, by_field, by_owner, place_and_complaint, read_toml
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.setup import make_scene
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.supplied import Supplied
from swe_sphere.testcases.user_scenes import made

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True)
class Configuration:
    """A run as the keys of a `--config` file tell it.

    The scene may also be that of a study, "verify:decay": the function `decay` in
    `swe_sphere.studies.verify.scenes`, with `set.scene` as its parameters.
    """

    table: Mapping[str, Any] = field(default_factory=dict)

    def changed(self, changes: Mapping[str, Any]) -> Configuration:
        """The configuration with other values, tables in it merged."""
        return replace(self, table=merged(self.table, changes))

    @property
    def config(self) -> RunConfig:
        """All of it, checked; ConfigError for an unknown key or an unfit value."""
        return make_config(by_field(self.table))

    def make_scene(self) -> Scene:
        """The scene with its parameters, and with its effects as the settings have them."""
        config = self.config
        study, colon, name = config.scene.partition(":")
        if not colon:
            return make_scene(config)
        own = import_module(f"swe_sphere.studies.{study}.scenes").SCENES
        if name not in own:
            raise unknown_name(f"scene of {study}", name, own)
        scene = made(config.scene, own[name], by_owner(config.settings).get(SCENE, {}))
        return apply_settings(scene, config.settings)

    def simulation(self) -> Simulation:
        """All set up, at its start.

        Raises:
            ConfigError: it cannot be run.
        """
        return Simulation.from_config(self.config, Supplied(scene=self.make_scene()))


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The table with the changes, those of tables in it in depth."""
    deep = {
        key: merged(table[key], value)
        for key, value in changes.items()
        if isinstance(value, Mapping) and isinstance(table.get(key), Mapping)
    }
    return {**table, **changes, **deep}


def study_files(study: str, folder: str, names: Iterable[str]) -> Iterator[Path]:
    """The files NAME.toml in a folder of a study."""
    for name in names:
        yield Path(str(files(f"swe_sphere.studies.{study}"))) / folder / f"{name}.toml"


def read_tables(path: Path, name: str, form: type[M]) -> tuple[dict[str, Any], tuple[M, ...]]:
    """A file of a study: the keys of the whole file, and its tables [[name]] as models.

    A table [shared] has what all of these tables share.

    Raises:
        ConfigError: the file cannot be read, or has no such tables, or they are not of that form.
    """
    whole = read_toml(path)
    shared, tables = whole.pop("shared", {}), whole.pop(name, None)
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{path}: there must be tables [[{name}]]")
    try:
        return whole, tuple(form.model_validate(merged(shared, table)) for table in tables)
    except ValidationError as error:
        raise ConfigError(f"{path}: {place_and_complaint(error)}") from None
