"""Verification: the quick cases pass, a bound that is missed is told, the page has all of it."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.verify import CASES, Case, Rung, Setting, choose, page, verify
from swe_sphere.studies.verify.cases.constants import CASES as STARTS
from swe_sphere.studies.verify.scenes import decay, driven, homme_mountain, homme_wave
from swe_sphere.studies.verify.verdict import Check
from swe_sphere.testcases import SCENES

DOCS = Path(__file__).parents[1] / "docs"
QUICK = [case for case in CASES if any(rung.quick for rung in case.rungs)]


@pytest.mark.parametrize("case", QUICK, ids=lambda case: case.name)
def test_quick_verification_passes(case: Case) -> None:
    for row in verify([case], quick=True):
        assert row.checks
        assert [check for check in row.checks if not check.passed] == []


def test_every_scene_and_stepper_is_verified() -> None:
    names = {case.scene for case in CASES}
    assert set(SCENES) <= names
    assert {f"stepper-{name}" for name in STEPPERS} <= {case.name for case in CASES}


def test_every_case_has_a_name_and_every_rung_a_bound() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:
        for rung in case.rungs:
            assert rung.upper() or rung.values or rung.floors, case.name
        if case.setting.days and case.scene != "lake-at-rest" and case.along != "dt":
            assert all(rung.h for rung in case.rungs), case.name


def test_exact_scenes_have_ladders_in_ne_and_np() -> None:
    """Of three meshes at least where the solution is smooth; an order is asked for."""
    for name in ("williamson1", "williamson2", "williamson3", "williamson4", "lauter"):
        for along in ("ne", "np"):
            ladders = [case for case in CASES if case.scene == name and case.along == along]
            assert any("order" in rung.floors for case in ladders for rung in case.rungs), name


def start(name: str) -> dict[str, float]:
    (case,) = (case for case in STARTS if case.name == f"start-{name}")
    return dict(case.rungs[0].values)


def test_constants_are_those_of_closed_formulas() -> None:
    """Means over the sphere by hand, from the constants as published."""
    a, g, omega = 6.37122e6, 9.80616, 7.292e-5
    u0 = 2.0 * math.pi * a / (12.0 * 86400.0)
    steady, mountain, moving = start("williamson2"), start("williamson5"), start("lauter")
    assert steady["mean_depth"] == pytest.approx(
        (2.94e4 - (a * omega * u0 + u0**2 / 2.0) / 3.0) / g, rel=1e-7
    )
    assert steady["rms_coriolis"] == pytest.approx(2.0 * omega / math.sqrt(3.0), rel=1e-7)
    surface = 5960.0 - (a * omega * 20.0 + 200.0) / (3.0 * g)
    assert mountain["mean_depth"] + mountain["mean_bottom"] == pytest.approx(surface, rel=1e-7)
    assert moving["mean_bottom"] == pytest.approx(((omega * a) ** 2 / 6.0 + 10.0) / g, rel=1e-7)
    assert steady["max_wind"] == pytest.approx(u0, rel=1e-7)
    assert start("galewsky")["mean_depth"] == pytest.approx(10000.0 + 1.0 / 3.0, abs=2e-3)


@pytest.mark.parametrize("scene", [decay(nu=2e6), decay(nu4=1e18), driven()], ids=lambda s: s.title)
def test_own_scenes_are_smooth_and_start_exactly(scene) -> None:
    lon, lat = np.array([0.3, 4.0, 1.0]), np.array([0.2, -1.2, 0.5 * math.pi])
    for first, exact in zip(scene.initial(lon, lat), scene.exact(lon, lat, 0.0), strict=True):
        np.testing.assert_array_equal(first, exact)
    later = scene.exact(lon, lat, 86400.0)[2]
    assert np.abs(later / scene.initial(lon, lat)[2] - 1.0).max() > 1e-6


def test_scenes_on_a_larger_planet_are_those_of_the_formulas() -> None:
    """Surface at a pole of williamson5; wind and depth of williamson6 on the equator."""
    a, g, omega, k = 6.376e6, 9.80616, 7.292e-5, 7.848e-6
    mountain, wave = homme_mountain(), homme_wave()
    assert mountain.planet.radius == wave.planet.radius == a
    pole = mountain.initial(np.array([0.0]), np.array([0.5 * np.pi]))[2]
    assert pole == pytest.approx(5960.0 - (a * omega * 20.0 + 200.0) / g, abs=1e-8)
    u, _, h = wave.initial(np.array([0.0, 0.25 * np.pi]), np.zeros(2))
    np.testing.assert_allclose(u, [0.0, 2.0 * a * k], atol=1e-10)
    once, rest = 2.0 * (omega + k) * k / 30.0, 0.5 * k * (2.0 * omega + k) - 0.5 * k**2
    depth = 8000.0 + a**2 / g * (rest + once * np.array([1.0, -1.0]))
    np.testing.assert_allclose(h, depth, rtol=1e-12)


def test_bounds() -> None:
    assert Check("x", 1.0, high=1.0).passed
    assert not Check("x", 1.01, high=1.0).passed
    assert not Check("x", math.nan, high=1.0).passed
    assert Check("x", 0.9, high=1.0).used == pytest.approx(0.9)
    assert Check("x", 2.0, low=1.0).used == pytest.approx(0.5)
    assert Check("x", 1.1, low=0.9, high=1.1).used == pytest.approx(1.0)
    assert Check("x", 1.0, low=0.9, high=1.1).used == pytest.approx(0.0)
    assert Check("x", math.inf, high=1.0).used == math.inf


EASY = Case(
    "easy",
    "a short run",
    Setting("williamson2", days=0.1),
    (Rung(2, (1.0, 1.0, 1.0)), Rung(4, floors={"order": 2.0}), Rung(3, limits={"nothing": 1.0})),
    note="a note",
)


def test_rows_judge_what_was_measured() -> None:
    first, second, third = verify([EASY])
    assert first.passed
    assert second.passed
    assert not third.passed  # what was not measured fails
    expected = math.log2(first.quantities["l2_h"] / second.quantities["l2_h"])
    assert second.quantities["order"] == pytest.approx(expected)
    assert second.setting == replace(EASY.setting, ne=4)
    tight = replace(EASY, rungs=(Rung(2, (1e-12, 1.0, 1.0)),))
    (row,) = verify([tight])
    assert [check.quantity for check in row.checks if not check.passed] == ["l1_h"]
    assert row.used > 1e3
    assert row.as_dict()["passed"] is False


def test_page_has_every_row_and_tells_failures() -> None:
    rows = list(verify(choose(["lake-at-rest", "stepper-rk4"]), quick=True))
    text = page(rows, "swe-sphere verify --test")
    assert "swe-sphere verify --test" in text
    assert "All bounds hold" in text
    assert text.count("✓") == len(rows)
    assert "**lake-at-rest**" in text
    assert "largest wind [m/s]" in text
    failing = replace(rows[-1], case=replace(rows[-1].case, tolerance=1e-9))
    text = page([*rows[:-1], failing], "again")
    assert "1 of" in text
    assert "**fails**" in text


def test_command_writes_page_and_numbers(tmp_path, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["verify", "--quick", "--scenes", "stepper-rk4, start-lauter", "--out", str(tmp_path)])
    assert end.value.code == 0
    assert "all 3 rows passed" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "verification.json").read_text())
    assert [row["case"] for row in numbers["rows"]] == ["start-lauter", *2 * ["stepper-rk4"]]
    assert "**stepper-rk4**" in (tmp_path / "verification.md").read_text()


def test_command_fails_where_a_bound_does(monkeypatch, capsys) -> None:
    make = Setting.make_scene

    def with_other_gravity(setting: Setting):
        scene = make(setting)
        return replace(scene, planet=replace(scene.planet, gravity=9.81))

    monkeypatch.setattr(Setting, "make_scene", with_other_gravity)
    with pytest.raises(SystemExit) as end:
        main(["verify", "--quick", "--json", "--scenes", "start-williamson2"])
    assert end.value.code == 1
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert [c["quantity"] for c in row["checks"] if not c["passed"]] == ["energy"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--scenes", "willamson2"], "did you mean 'williamson2'"),
        (["--quick", "--scenes", "williamson2-np"], "leave out --quick"),
    ],
)
def test_command_says_what_is_wrong(arguments, says, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["verify", *arguments])
    assert end.value.code == 2
    assert says in capsys.readouterr().err


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ConfigError, match="scene or case"):
        choose(["nothing-of-this-kind"])


def test_the_page_in_docs_is_of_these_cases() -> None:
    """Every case stands there, and nothing that has gone."""
    text = (DOCS / "verification.md").read_text(encoding="utf-8")
    told = re.findall(r"^\*\*([\w=.-]+)\*\* \(", text, re.MULTILINE)
    assert told == [case.name for case in CASES]
    assert "All bounds hold" in text
