"""One run of a case: the settings of `swe-sphere run`, and scenes that only cases need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import unknown_name
from swe_sphere.settings.values import SCENE, by_field
from swe_sphere.simulation.build import Inputs, make_scene
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.studies.cases.scenes import SCENES
from swe_sphere.testcases.user_scenes import made


@dataclass(frozen=True)
class Configuration:
    """A run in the keys of a `--config` file.

    The scene may also be one of `swe_sphere.studies.cases.scenes`, "cases:decay", with `set.scene`
    as its parameters.
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
        prefix, _, name = config.scene.partition(":")
        if prefix != "cases":
            return make_scene(config)
        if name not in SCENES:
            raise unknown_name("scene of cases", name, SCENES)
        scene = made(config.scene, SCENES[name], config.settings_of(SCENE))
        return apply_settings(scene, config.settings)

    def simulation(self) -> Simulation:
        """All set up, at its start.

        Raises:
            ConfigError: it cannot be run.
        """
        return Simulation(Inputs(self.config, self.make_scene()))


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The table with the changes, those of tables in it in depth."""
    deep = {
        key: merged(table[key], value)
        for key, value in changes.items()
        if isinstance(value, Mapping) and isinstance(table.get(key), Mapping)
    }
    return {**table, **changes, **deep}
