"""Verification: the quick cases pass, a bound that is missed is told, the page has all of it."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError, Interrupted
from swe_sphere.simulation.config import RunConfig
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.cases import (
    Case,
    Measure,
    Row,
    choose,
    page,
    run_cases,
    verify,
)
from swe_sphere.studies.cases import measure as measuring
from swe_sphere.studies.cases.case import DEFAULTS, read_group
from swe_sphere.studies.cases.measure import measure
from swe_sphere.studies.cases.scenes import decay, homme_mountain, homme_wave
from swe_sphere.studies.record_store import Store, locked
from swe_sphere.testcases import SCENES

DOCS = Path(__file__).parents[1] / "docs" / "results"
CASES = choose("verification")
BY_NAME = {name: [*cases] for name, cases in groupby(CASES, lambda case: case.name)}
QUICK = choose("verification", quick=True)


def chosen(*names: str) -> list[Case]:
    """The cases of these names in their quick form."""
    return choose("verification", names, quick=True)


@pytest.fixture(scope="module")
def known() -> dict[str, Measure]:
    """What has been measured, by its fingerprint."""
    return {}


@pytest.fixture
def measured_once(known, monkeypatch) -> None:
    """What several tests make rows of is measured for the first of them."""

    def measured(case, tick):
        key = case.fingerprint
        if key not in known:
            known[key] = measure(case, tick)
        return known[key]

    monkeypatch.setattr("swe_sphere.studies.cases.rows.measure", measured)


@pytest.mark.usefixtures("measured_once")
@pytest.mark.parametrize("case", QUICK, ids=lambda case: case.name)
@pytest.mark.thorough
def test_quick_verification_passes(case: Case) -> None:
    for row in run_cases([case]):
        assert (row.measure.status, row.measure.reason) == ("completed", "")
        assert row.checks
        assert [str(check) for check in row.checks if not check.holds] == []


def test_every_scene_is_verified() -> None:
    assert set(SCENES) <= {case.scene for case in CASES}


def test_every_stepper_is_held_in_a_narrow_band() -> None:
    """Of its errors at two steps at least, which differ as its order says."""
    ours = {n: kind for n, kind in STEPPERS.items() if kind.__module__.startswith("swe_sphere.")}
    for name, kind in ours.items():
        cases = BY_NAME[f"stepper-{name}"]
        assert {case.stepper for case in cases} == {name}
        (long, first), (short, second) = (
            (case.configured().dt, case.values["l2_v"]) for case in cases
        )
        assert np.log(first / second) / np.log(long / short) > kind.order - 0.65, name
        for bound in (check for case in cases for check in case.checks):
            width = bound.high - bound.low
            assert bound.quantity == "mass_drift" or width <= 4.1e-3 * bound.high, name


def test_every_case_has_a_bound() -> None:
    assert sum(map(len, BY_NAME.values())) == len(CASES)
    for case in CASES:
        assert any(check.quantity != "mass_drift" for check in case.checks), case.name
        if case.method != "start" and case.scene != "lake-at-rest" and case.along != "dt":
            assert case.h, case.name


def test_exact_scenes_have_orders_in_ne_and_np() -> None:
    for name in ("williamson1", "williamson2", "williamson3", "williamson4", "lauter"):
        for along in ("ne", "np"):
            cases = [case for case in CASES if case.scene == name and case.along == along]
            assert any(case.order for case in cases), name


def test_errors_fall_with_refinement_wherever_an_order_is_asked_for() -> None:
    for case in CASES:
        for bound in case.checks:
            if bound.quantity.startswith("order"):
                assert bound.low > 0.0, (case.name, bound)


def start(name: str) -> dict[str, float]:
    return dict(BY_NAME[f"start-{name}"][0].values)


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


@pytest.mark.parametrize("scene", [decay(nu=2e6), decay(nu4=1e18)], ids=["nu", "nu4"])
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


CASE = """
title = "Two"
[shared]
run = {scene = "williamson2", days = 0.1}
[[case]]
name = "easy"
title = "a short run"
note = "a note"
levels = [
    {ne = 2, h = [1.0, 1.0, 1.0], v = [2.0, 2.0, 3.0]},
    {ne = 4, order = [2.0, 1.5], bounds = {max_v = 50.0, max_speed = {low = 1.0, high = 90.0}}},
    {ne = 3, values = {nothing = 1.0}, quick = true, published = {X = {l2_h = 0.5}}},
]
[[case]]
name = "none"
run = {stepper = "leapfrog"}
bounds.mass_drift = inf
"""


@pytest.fixture
def easy(tmp_path) -> list[Case]:
    (tmp_path / "cases.toml").write_text(CASE)
    return [*read_group(tmp_path / "cases.toml", DEFAULTS["verification"]).cases[:3]]


def test_cases_in_a_file(easy, tmp_path) -> None:
    family = read_group(tmp_path / "cases.toml", DEFAULTS["verification"])
    (*_, none) = family.cases
    assert (family.title, none.name) == ("Two", "none")
    assert none.bounds == {"mass_drift": math.inf} and none.checks == []
    assert none.configured().stepper == "leapfrog"
    assert none.configured().scene == "williamson2"
    first, second, third = ([check.limits for check in case.checks] for case in easy)
    high = ["l1_h ≤ 1", "l2_h ≤ 1", "linf_h ≤ 1", "l1_v ≤ 2", "l2_v ≤ 2", "linf_v ≤ 3"]
    assert first == [*high, "mass_drift ≤ 1e-13"]
    orders = ["order ≥ 2", "order_v ≥ 1.5"]
    assert second == [*orders, "mass_drift ≤ 1e-13", "max_v ≤ 50", "1 ≤ max_speed ≤ 90"]
    assert third == ["mass_drift ≤ 1e-13", "0.999 ≤ nothing ≤ 1.001"]
    last = easy[2]
    assert (last.is_quick, last.published) == (True, {"X": {"l2_h": 0.5}})
    expected = {"ne": 3, "np": 4, "days": 0.1, "scene": "williamson2"}
    assert last.configured().given() == expected


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("note =", "nota =", "nota: Extra inputs"),
        ("h = [1.0, 1.0, 1.0]", "h = [1.0, 1.0]", "h.2"),
        ("order = [2.0, 1.5]", 'order = "two"', "order."),
        ("[[case]]", "[[cases]]", "must be tables"),
    ],
)
def test_a_file_that_is_not_as_the_schema_says(tmp_path, old, new, complaint) -> None:
    (tmp_path / "cases.toml").write_text(CASE.replace(old, new))
    with pytest.raises(ConfigError, match=re.escape(complaint)):
        read_group(tmp_path / "cases.toml", DEFAULTS["verification"])


def changed(case: Case, **changes: Any) -> Case:
    return Case.model_validate(case.model_dump() | changes)


def test_rows_judge_what_was_measured(easy) -> None:
    first, second, third = run_cases(easy)
    assert first.passed
    assert second.passed
    assert not third.passed  # what was not measured fails
    expected = math.log2(first.quantities["l2_h"] / second.quantities["l2_h"])
    assert second.quantities["order"] == pytest.approx(expected)
    again = [*run_cases([easy[0], easy[0]])][1]  # of one fineness: there is no order to observe
    assert again.passed and "order" not in again.quantities
    tight = changed(easy[0], h=(1e-12, 1.0, 1.0))
    (row,) = run_cases([tight])
    assert [check.quantity for check in row.checks if not check.holds] == ["l1_h"]
    assert row.used > 1e3
    assert row.as_dict()["passed"] is False


@pytest.mark.parametrize(
    ("along", "values"), [("ne", (2, 4)), ("np", (4, 7)), ("dt", (600.0, 300.0))]
)
def test_an_order_is_per_doubling_of_elements_degree_or_steps(along: str, values: tuple) -> None:
    row = None
    for value, error in zip(values, (8e-3, 1e-3), strict=True):
        run = {"scene": "williamson2", "ne": 2, "np": 4} | {along: value}
        numbers = {"l2_h": error, "dt": run.get("dt", 600.0)}
        found = Measure(fingerprint="", reason="", name="a", status="completed", numbers=numbers)
        row = Row(Case(name="a", run=run, along=along), found, row)
    assert row.quantities["order"] == pytest.approx(3.0)
    if along == "ne":  # refined in ne and np, an error has no order
        both = row.case.model_copy(update={"run": row.case.run | {"ne": 8, "np": 6}})
        assert "order" not in Row(both, found, row).quantities


def test_a_run_that_stops_fails_and_says_why(easy) -> None:
    case = changed(easy[0], h=(1.0, 1.0, 1.0))
    (row,) = run_cases([case.changed(run={"dt": 8640.0})])
    assert row.passed
    (row,) = run_cases([case.changed(run={"ne": 4, "days": 60.0, "dt": 43200.0})])
    assert not row.passed
    assert (row.as_dict()["status"], row.as_dict()["quantities"]) == ("unstable", {})
    text = page("verification", [replace(row, case=BY_NAME["start-williamson1"][0])], "again")
    assert "`start-williamson1` failed: the solution is NaN" in text


@pytest.mark.usefixtures("measured_once")
def test_page_has_every_row_and_tells_failures() -> None:
    rows = list(run_cases(chosen("lake-at-rest", "stepper-rk4")))
    text = page("verification", rows, "swe-sphere verify --test")
    assert "swe-sphere verify --test" in text
    assert "All bounds hold" in text
    assert text.count("| passed |\n") == len(rows)
    assert "| lake-at-rest |" in text
    assert "largest wind [m/s]" in text
    failing = replace(rows[-1], case=changed(rows[-1].case, tolerance=1e-9))
    text = page("verification", [*rows[:-1], failing], "again")
    assert "1 of" in text
    assert "| **failed** |" in text


def test_command_writes_page_and_numbers(tmp_path, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["verify", "--quick", "--scenes", "stepper-rk4, start-lauter", "--out", str(tmp_path)])
    assert end.value.code == 0
    assert "3 passed, 0 refused, 0 stopped, 0 broke, 0 failed" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "verification.json").read_text())
    assert [row["case"] for row in numbers["rows"]] == ["start-lauter", *2 * ["stepper-rk4"]]
    assert "| stepper-rk4 |" in (tmp_path / "verification.md").read_text()


@pytest.mark.usefixtures("measured_once")
def test_kernels_of_gpus_are_held_to_the_same_bounds(tmp_path) -> None:
    asked = ["--quick", "--scenes", "stepper-rk4", "--launch", "node"]
    with pytest.raises(SystemExit) as end:
        main(["verify", *asked, "--out", str(tmp_path)])
    assert end.value.code == 0
    text = (tmp_path / "verification.md").read_text()
    assert f"swe-sphere verify {' '.join(asked)} --out" in text
    (row, *_) = verify("stepper-rk4", quick=True, launch="node")
    assert row.passed and row.config.launch == "node"


def test_an_interrupted_command_goes_on_after_the_last_run(tmp_path, capsys, monkeypatch) -> None:
    line = ["verify", "--quick", "--scenes", "stepper-rk4,start-lauter", "--out", str(tmp_path)]
    begun: list[float | str] = []

    def interrupted(case, tick):
        begun.append(case.configured().dt)
        if len(begun) == 3:
            raise Interrupted("interrupted by Ctrl-C at day 0")
        return measure(case, tick)

    monkeypatch.setattr("swe_sphere.studies.cases.rows.measure", interrupted)
    with pytest.raises(SystemExit) as end:
        main(line)
    assert end.value.code == 130
    assert "interrupted by Ctrl-C at day 0; resume with --resume" in capsys.readouterr().err
    with pytest.raises(SystemExit) as end:
        main([*line, "--resume"])
    assert end.value.code == 0
    assert "3 passed, 0 refused, 0 stopped, 0 broke, 0 failed" in capsys.readouterr().out
    assert begun == [*begun[:3], begun[2]]
    there = sorted(path.name for path in tmp_path.iterdir())
    assert there == ["verification.json", "verification.md"]
    with locked(tmp_path / "verification.runs"), pytest.raises(SystemExit) as end:
        main([*line, "--resume"])
    assert end.value.code == 2
    assert "another process" in capsys.readouterr().err


def test_what_other_code_has_measured_does_not_count(easy, tmp_path, monkeypatch) -> None:
    runs = Store(tmp_path, Measure)
    (first, *_) = run_cases(easy[:1], store=runs)
    keys = [case.fingerprint for case in easy]
    assert len({*keys}) == len(keys) and first.measure.fingerprint == keys[0]
    again = changed(easy[0], tolerance=1e-9)
    assert (
        [row.measure for row in run_cases([again], runs.records)] == [first.measure] == runs.records
    )
    monkeypatch.setattr("swe_sphere.studies.cases.case.code_fingerprint", lambda *_: "other")
    assert easy[0].fingerprint != keys[0]


def test_command_fails_where_a_bound_does(monkeypatch, capsys) -> None:
    make = measuring.make_scene

    def with_other_gravity(config: RunConfig):
        scene = make(config)
        return replace(scene, planet=replace(scene.planet, gravity=9.81))

    monkeypatch.setattr(measuring, "make_scene", with_other_gravity)
    with pytest.raises(SystemExit) as end:
        main(["verify", "--quick", "--json", "--scenes", "start-williamson2"])
    assert end.value.code == 1
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert [c["quantity"] for c in row["checks"] if not c["passed"]] == ["energy"]
    monkeypatch.setenv("COLUMNS", "30")
    with pytest.raises(SystemExit):
        main(["verify", "--quick", "--scenes", "start-williamson2"])
    obtained = next(c["obtained"] for c in row["checks"] if c["quantity"] == "energy")
    assert f"FAILED: energy is {obtained:.6g}, not 3.02608e+07 ≤ energy" in capsys.readouterr().out


@pytest.mark.usefixtures("measured_once")
@pytest.mark.parametrize("columns", [20, 60, 80, 200])
def test_no_number_is_cropped(monkeypatch, capsys, columns: int) -> None:
    """Neither on a narrow terminal nor in a pipe, which counts as one of 80 columns."""
    monkeypatch.setenv("COLUMNS", str(columns))
    rows = list(run_cases(chosen("stepper-rk4")))
    with pytest.raises(SystemExit):
        main(["verify", "--quick", "--scenes", "stepper-rk4"])
    lines = capsys.readouterr().out.splitlines()
    for row in rows:
        numbers = [f"{row.quantities[name]:.2e}" for name in ("l2_h", "l2_v")]
        (line,) = (line for line in lines if numbers[0] in line)
        for text in ("stepper-rk4", *numbers, f"{row.dt:.4g}", f"{row.used:.2f}"):
            assert text in line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--scenes", "willamson2"], "did you mean 'williamson2'"),
        (["--quick", "--scenes", "williamson2-np"], "leave out --quick"),
        (["--launch", "nodes"], "launch: must be 'element' or 'node', got 'nodes'"),
    ],
)
def test_command_says_what_is_wrong(arguments, says, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["verify", *arguments])
    assert end.value.code == 2
    assert says in capsys.readouterr().err


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ConfigError, match="scene or case"):
        choose("verification", ["nothing-of-this-kind"])


def test_the_page_in_docs_is_of_these_cases() -> None:
    """Every case stands there, and nothing that has gone."""
    text = (DOCS / "verification.md").read_text(encoding="utf-8")
    rows = text.partition("\n## All rows\n")[2].partition("\n## ")[0]
    told = re.findall(r"^\| ([\w=.-]+) \| \d", rows, re.MULTILINE)
    assert told == [case.name for case in CASES]
    assert "All bounds hold" in text
