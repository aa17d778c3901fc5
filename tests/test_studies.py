"""What studies share: bounds and configurations; for results on disk see test_study_store."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from swe_sphere.errors import ConfigError
from swe_sphere.studies.cases.case import (
    Case,
    Check,
    merged,
    read_group,
    read_limits,
)
from swe_sphere.studies.cases.scenes import make_scene

HIGH, LOW, BAND = Check("x", 1.0), Check("x", low=1.0), Check("x", 1.1, 0.9)


@pytest.mark.parametrize(
    ("bound", "value", "holds", "used"),
    [
        (HIGH, 0.9, True, 0.9),
        (HIGH, 1.01, False, 1.01),
        (HIGH, math.nan, False, math.inf),
        (HIGH, math.inf, False, math.inf),
        (LOW, 2.0, True, 0.5),
        (LOW, 0.5, False, 2.0),
        (LOW, -1.0, False, math.inf),
        (LOW, 0.0, False, math.inf),
        (Check("x", low=0.0), 3.0, True, 0.0),
        (Check("x", low=0.0), -1.0, False, math.inf),
        (Check("x", low=-2.0), -1.0, True, 0.5),
        (Check("x", low=-2.0), -4.0, False, 2.0),
        (Check("x", low=-2.0), 1.0, True, 0.0),
        (Check("x", -2.0), -4.0, True, 0.5),
        (Check("x", -2.0), 1.0, False, math.inf),
        (BAND, 1.1, True, 1.0),
        (BAND, 1.0, True, 0.0),
        (BAND, 1.2, False, 2.0),
        (Check("x", 0.0), 0.0, True, 0.0),
        (Check("x", 0.0), 1.0, False, math.inf),
        (Check("x", 1.0, 1.0), 1.0, True, 0.0),
    ],
)
def test_how_much_of_a_bound_is_used(bound, value, holds, used) -> None:
    check = replace(bound, obtained=value)
    assert check.holds is holds
    assert check.used == pytest.approx(used, abs=1e-12)


def test_bounds_in_words_and_from_tables() -> None:
    high, low, band = read_limits({"a": 2.0, "b": {"low": 0.5}, "c": {"low": 1.0, "high": 3.0}})
    assert [check.limits for check in (high, low, band)] == ["a ≤ 2", "b ≥ 0.5", "1 ≤ c ≤ 3"]
    assert str(replace(band, obtained=4.0)) == "c is 4, not 1 ≤ c ≤ 3"
    assert [*read_limits({"a": math.inf})] == []
    (always,) = read_limits({"a": 2.0}, always=True)
    assert always == Check("a", 2.0, always=True)


# --- configurations


def test_changes_go_into_tables() -> None:
    table = {"ne": 4, "set": {"scene": {"alpha": 0.1}, "viscosity": {"nu": 1.0}}}
    changes = {"np": 6, "set": {"scene": {"alpha": 0.2}}}
    expected = {"ne": 4, "np": 6, "set": {"scene": {"alpha": 0.2}, "viscosity": {"nu": 1.0}}}
    assert merged(table, changes) == expected
    assert table["set"]["scene"] == {"alpha": 0.1}


def test_a_configuration_is_that_of_a_run() -> None:
    run = {"scene": "williamson1", "set": {"scene": {"gaussian": True}}, "np": 6}
    case = Case(name="a", run=run)
    assert (case.configured().np, case.configured().settings) == (6, (("scene", "gaussian", True),))
    assert make_scene(case.configured()).parameters["gaussian"] is True
    damped = make_scene(case.configured({"set": {"hyperviscosity": {"nu": "default"}}}))
    assert damped.effect("hyperviscosity") is not None
    with pytest.raises(ConfigError, match="unknown option 'nodes'"):
        case.configured({"nodes": 3})


def test_scenes_of_a_study() -> None:
    case = Case(name="a", run={"scene": "cases:decay", "set": {"scene": {"nu": 2e6}}})
    assert make_scene(case.configured()).parameters["nu"] == 2e6
    with pytest.raises(ConfigError, match="did you mean 'decay'"):
        make_scene(case.configured({"scene": "cases:decya"}))
    with pytest.raises(ConfigError, match="no parameter 'mu'"):
        make_scene(case.configured({"set": {"scene": {"mu": 1.0}}}))


def test_tables_share_what_stands_before_them(tmp_path) -> None:
    file = tmp_path / "cases.toml"
    tables = '[[case]]\nname = "a"\nrun = {np = 6}\n[[case]]\nname = "b"\n'
    file.write_text(f'title = "T"\nshared.run = {{ne = 4}}\n{tables}')
    family = read_group(file, {"run": {"ne": 8, "days": 2.0}})
    assert (family.name, family.title) == ("cases", "T")
    assert [dict(case.run) for case in family.cases] == [
        {"ne": 4, "np": 6, "days": 2.0},
        {"ne": 4, "days": 2.0},
    ]
    file.write_text('title = "T"\n[[trial]]\n')
    with pytest.raises(ConfigError, match=r"must be tables \[\[case\]\]"):
        read_group(file)
    file.write_text('[[case]]\nname = "a"\nrun = "four"\n')
    with pytest.raises(ConfigError, match=r"cases\.toml: run: .* dict"):
        read_group(file)


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ("random = 3", "a: random needs steppers"),
        ('quick = ["rk4"]', "a: quick needs steppers"),
        ('remedied = ["rk4"]', "a: remedied needs steppers"),
        ("remedy.viscosity.nu = 1.0", "a: remedy needs steppers"),
        ('steppers = ["rk4"]\nlevels = [{ne = 2}]', "a: levels cannot be given beside steppers"),
        ('method = "series"', "a: give steppers, or run.stepper"),
    ],
)
def test_keys_of_a_case_that_would_be_ignored_are_refused(keys, complaint, tmp_path) -> None:
    file = tmp_path / "cases.toml"
    file.write_text(f'[[case]]\nname = "a"\nrun.scene = "lauter"\n{keys}\n')
    with pytest.raises(ConfigError, match=rf"cases\.toml: .*{complaint}"):
        read_group(file)
