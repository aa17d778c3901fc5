"""What a resumed run inherits from the earlier one: every field that is not of one run alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from swe_sphere.errors import ConfigError
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.restart import INHERITED, Restart

VALUES = {
    "adaptive": 1e-4, "alpha": 0.5, "centre_lat": 30.0, "centre_lon": 270.0, "days": 3.0,
    "device": "cuda:0", "dt": 300.0, "energy_growth": 4.0, "every": 7.0, "fields": ("h", "u"),
    "initial": "first.nc", "initial_time": 0.5, "launch": "node", "ne": 7, "np": 5,
    "outputs": [{"path": "wind.nc", "every": 6.0, "grid": "gaussian:8"}],
    "precision": "float32", "preconditioner": "jacobi", "settings": ["viscosity.nu=1e5"],
    "spin": 12.0, "stepper": "bdf2", "stretch": 2.0, "tolerance": 1e-7, "tracer_steps": 4,
}  # fmt: skip
"""A value of each inherited field that is not its default."""


def resumed(earlier: RunConfig, steps: int = 5, **values: object) -> RunConfig:
    """The configuration of a run that resumes from one of this configuration."""
    restart = Restart.__new__(Restart)
    restart.path, restart.steps = Path("run.nc"), steps
    restart.attributes = {
        "configuration": json.dumps(earlier.model_dump(mode="json")),
        "identity": json.dumps({"sources": {}}),
    }
    return restart.adopt(make_config({"scene": "williamson6", **values}))


def test_each_field_is_known_to_be_inherited_or_not() -> None:
    assert {*VALUES, "diagnostics"} == INHERITED  # files, whose tests are in test_going_on.py


@pytest.mark.parametrize("name", VALUES)
def test_a_field_is_inherited_unless_it_is_given(name: str) -> None:
    earlier = make_config({"scene": "williamson6", name: VALUES[name]})
    default = getattr(make_config({"scene": "williamson6"}), name)
    assert getattr(earlier, name) != default
    assert getattr(resumed(earlier), name) == getattr(earlier, name)
    assert name in resumed(earlier).model_fields_set
    if default is not None and name != "settings":  # settings are merged one by one
        assert getattr(resumed(earlier, **{name: default}), name) == default


@pytest.mark.parametrize(
    ("name", "value"),
    [("out", "a.nc"), ("overwrite", True), ("plot", "a.png"), ("live", "h"), ("as_json", True),
     ("quiet", True), ("log", "run.log"), ("reference", "b.nc"), ("time_limit", 5.0)],
)  # fmt: skip
def test_what_belongs_to_one_run_is_not_inherited(name: str, value: object) -> None:
    earlier, plain = (make_config({"scene": "williamson6", **v}) for v in ({name: value}, {}))
    assert getattr(resumed(earlier), name) == getattr(plain, name)


def test_a_file_without_a_configuration_is_refused() -> None:
    restart = Restart.__new__(Restart)
    restart.path, restart.steps, restart.attributes = Path("run.nc"), 1, {}
    with pytest.raises(ConfigError, match="does not state its configuration"):
        restart.adopt(make_config({"scene": "williamson6"}))
