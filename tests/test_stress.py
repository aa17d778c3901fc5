"""Stress cases: how they are judged, kept and chosen; the quick form; broken code is noticed."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError, Interrupted
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.planning import RunPlan
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.simulation.summary import Summary
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.cases import (
    Case,
    Measure,
    Row,
    choose,
    groups,
    page,
    run_cases,
)
from swe_sphere.studies.cases import measure as measuring
from swe_sphere.studies.cases.case import DEFAULTS, read_group
from swe_sphere.studies.cases.measure import SYMMETRIES, Series
from swe_sphere.studies.cases.scenes import (
    FASTEST,
    SHALLOWEST,
    make_scene,
    random_setting,
    random_state,
)
from swe_sphere.testcases import get_scene

ROOT = Path(__file__).parents[1]


GROUPS = groups("stability")
CASES = choose("stability")


def find(name: str) -> Case:
    """The case of that name."""
    return next(case for case in CASES if case.name == name)


def try_out(case: Case) -> Row:
    """The row of a case."""
    (row,) = run_cases([case])
    return row


def judge(case: Case, status: str = "completed", reason: str = "", **numbers: float) -> Row:
    """The row of a case that ended like this."""
    found = Measure(
        name=case.name, fingerprint="abc", status=status, reason=reason, numbers=numbers
    )
    return Row(case, found)


# --- judging

CALM = {"bounds": {"max_wind": 10.0}, "always": {"mass_drift": 1e-12}}


def calm(expect: str = "pass") -> Case:
    return Case(name="x", run={"stepper": "rk4"}, expect=expect, **CALM)


@pytest.mark.parametrize(
    ("expect", "status", "wind", "mass", "outcome"),
    [
        ("pass", "completed", 9.0, 0.0, "passed"),
        ("pass", "completed", 11.0, 0.0, "failed"),
        ("pass", "completed", math.nan, 0.0, "failed"),
        ("pass", "completed", 9.0, 1e-9, "failed"),
        ("pass", "unstable", 9.0, 0.0, "failed"),
        ("pass", "refused", 9.0, 0.0, "failed"),
        ("either", "completed", 9.0, 0.0, "passed"),
        ("either", "completed", 11.0, 0.0, "failed"),
        ("either", "unstable", 11.0, 0.0, "stopped"),
        ("either", "solver-failed", 11.0, 0.0, "stopped"),
        ("either", "unstable", 9.0, 1e-9, "failed"),
        ("either", "timed-out", 9.0, 0.0, "failed"),
        ("either", "failed", 9.0, 0.0, "failed"),
        ("refuse", "refused", 9.0, 0.0, "refused"),
        ("refuse", "completed", 9.0, 0.0, "failed"),
        ("break", "completed", 11.0, 0.0, "broke"),
        ("break", "completed", 9.0, 0.0, "passed"),
        ("break", "unstable", 9.0, 0.0, "stopped"),
        ("break", "failed", 9.0, 0.0, "failed"),
    ],
)
def test_what_an_end_is_called(expect, status, wind, mass, outcome):
    reason = "" if status == "completed" else "because"
    result = judge(calm(expect), status, reason, max_wind=wind, mass_drift=mass)
    assert result.outcome == outcome
    assert result.reason or outcome == "passed"


def test_what_was_not_measured_does_not_hold():
    assert judge(calm()).outcome == "failed"


@pytest.mark.parametrize(
    ("power", "growth"), [(0.0, 1.0 / 3.0), (1.0, 1.0), (2.0, 3.0)], ids=["constant", "1", "2"]
)
def test_growth_of_errors(power: float, growth: float) -> None:
    days = iter(np.arange(0.0, 30.1, 0.25))

    def sampled(time):
        error = time**power
        keys = ("mass_drift", "energy_drift", "enstrophy_drift", "total_vorticity", "linf_h")
        return dict.fromkeys(keys, 0.0) | {
            "max_wind": 1.0, "min_depth": 1.0, "max_wave": 1.0, "l2_h": error, "l2_v": error,
        }  # fmt: skip

    series = Series(RunPlan(dt=21600.0, steps=120, frame_steps=120, wanted_dt=21600.0))
    for day in days:
        series.observe(SimpleNamespace(time=day, diagnostics=sampled(day), snapshot=None))
    assert series.numbers()["growth_v"] == pytest.approx(growth, rel=0.01)


def test_undershoots_of_tracers_count_as_overshoots_do() -> None:
    sim = Simulation("deformational", ne=2, np=4)
    (name, *_), before = sim.scene.tracers, sim.initial_fields
    for key, bound, sign in (("min", np.min, -1.0), ("max", np.max, 1.0)):
        beyond = {f"{key}_q_{name}": float(bound(before[f"q_{name}"])) + 0.25 * sign}
        changed = SimpleNamespace(
            mesh=sim.mesh,
            model=sim.model,
            scene=sim.scene,
            initial_fields=before,
            initial_numbers=sim.initial_numbers,
            snapshot=sim.snapshot,
            diagnostics=sim.diagnostics | beyond,
        )
        assert measuring._extremes(changed)["beyond_bounds"] == pytest.approx(0.25)


# --- symmetries


def test_deviations_from_symmetries_are_measured() -> None:
    mesh = Mesh.build(3, 4)
    _, v, h = get_scene("williamson6").initial(mesh.lon, mesh.lat)
    off_wave, off_mirror = SYMMETRIES["off_wave"], SYMMETRIES["off_mirror"]
    one = np.cos(mesh.lat) * np.sin(mesh.lon)
    assert off_wave(mesh, {"v": v}) < 1e-25
    assert off_wave(mesh, {"v": one}) == pytest.approx(1.0)
    assert off_mirror(mesh, {"h": h}) < 1e-13
    assert off_mirror(mesh, {"h": np.sin(mesh.lat)}) == pytest.approx(2)


def test_a_mesh_without_the_symmetry_is_refused() -> None:
    mesh = Mesh.build(2, 4, spin=17.0)
    with pytest.raises(ValueError, match="does not have this symmetry"):
        SYMMETRIES["off_wave"](mesh, {"v": mesh.lat})


# --- random states


@pytest.mark.parametrize("seed", range(0, 200, 13))
def test_random_states_are_admissible(seed: int) -> None:
    scene, (mesh, length) = random_state(seed), random_setting(seed)
    lon, lat = Mesh.build(3, mesh["np"]).lon, Mesh.build(3, mesh["np"]).lat
    u, v, h = scene.initial(lon, lat)
    again = random_state(seed).initial(lon, lat)
    assert np.array_equal((u, v, h), again)
    assert h.min() > SHALLOWEST * np.mean(h)
    # a little more than the flow itself may have, for the noise
    assert np.max(np.hypot(u, v) / np.sqrt(scene.planet.gravity * h)) < FASTEST + 0.05
    assert 0.3 <= length["part"] < 1.0 <= length["courant"] <= 10.0**1.5


def test_all_seeds_are_dealt_out_to_all_steppers() -> None:
    cases = GROUPS["random"].cases
    assert sorted(seed for case in cases for seed in case.seeds) == list(range(200))
    assert {case.stepper for case in cases} == set(STEPPERS)


# --- what breaks is noticed


def small(name: str, **run: object) -> Case:
    """A case of the suite, on a small mesh."""
    case = find(name)
    return case.changed(run={"ne": 4, **run})


def test_a_step_beyond_the_limit_fails() -> None:
    case = small("steady-pi/4-rk4").changed(part=1.5)
    assert try_out(case).outcome == "failed"
    within = try_out(small("steady-pi/4-rk4", days=3.0).changed(part=0.9, bounds={}))
    assert within.outcome == "passed"


def test_a_filter_of_the_wrong_sign_fails() -> None:
    case = small("noisy-williamson2-leapfrog", days=2.0, dt=600.0)
    assert try_out(case).outcome == "passed"
    wrong = case.changed(run={"set": {"stepper": {"strength": -0.1}}})
    assert try_out(wrong).outcome == "failed"


def test_time_that_is_used_up_fails() -> None:
    result = try_out(small("steady-pi/4-rk4").changed(seconds=1e-3))
    assert (result.outcome, result.reason[:9]) == ("failed", "timed-out")


def test_an_error_that_is_none_of_ours_fails(monkeypatch) -> None:
    def fail(_):
        raise ValueError("no such thing")

    monkeypatch.setattr(measuring, "make_scene", fail)
    result = try_out(small("steady-pi/4-rk4").changed(expect="either"))
    assert result.reason == "failed: ValueError: no such thing"
    assert result.outcome == "failed"


def test_a_sampled_nan_is_noticed() -> None:
    case = find("beyond-limit-rk4")
    assert judge(case, "unstable", "it blew up", max_wind=math.nan).outcome == "failed"
    assert judge(case, "unstable", "it blew up", max_wind=200.0).outcome == "stopped"


# --- tables of cases

GROUP = """
title = "Calm"
text = "Nothing moves."
[shared]
steppers = ["imex", "rk4"]
run = {scene = "lake-at-rest", ne = 4, np = 4}
always = {mass_drift = 1e-12}
[[case]]
name = "lake"
run = {days = 2.0}
bounds = {min_depth = {low = 0.0}}
remedy = {viscosity.nu = 1e5}
remedied = ["rk4"]
quick = ["ark2"]
quickly = {run = {days = 1.0}}
[[case]]
name = "random"
steppers = ["rk4", "explicit"]
method = "seeds"
random = 10
"""


def test_a_table_is_a_trial_for_each_stepper(tmp_path) -> None:
    (tmp_path / "calm.toml").write_text(GROUP)
    group = read_group(tmp_path / "calm.toml", DEFAULTS["stability"])
    cases = {case.name: case for case in group.cases}
    imex = [name for name, kind in STEPPERS.items() if kind.family == "imex"]
    explicit = [name for name, kind in STEPPERS.items() if kind.family == "explicit"]
    assert (group.name, group.title) == ("calm", "Calm")
    first = [*(f"lake-{name}" for name in imex), "lake-rk4", "lake-rk4+viscosity"]
    assert list(cases)[: len(first)] == first
    assert cases["lake-rk4"].expect == "break"
    assert cases["lake-ark2"].expect == "either"
    helped = cases["lake-rk4+viscosity"]
    assert helped.expect == "pass"
    assert make_scene(helped.configured()).effect("viscosity").nu == 1e5
    assert [check.limits for check in helped.checks] == [
        "mass_drift ≤ 1e-12",
        "min_depth ≥ 0",
    ]
    quick = cases["lake-ark2"].changed(**cases["lake-ark2"].quickly)
    assert (quick.run["days"], quick.run["ne"], quick.stepper) == (1.0, 4, "ark2")
    assert [name for name, case in cases.items() if case.is_quick] == ["lake-ark2"]
    dealt = [case.seeds for name, case in cases.items() if name.startswith("random")]
    assert list(cases)[len(first)] == "random-rk4"
    assert len(dealt) == len(explicit)
    assert sorted(sum(dealt, ())) == list(range(10))


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("remedied", "remedy_for", "remedy_for: Extra inputs"),
        ('"imex", "rk4"', '"imx"', "unknown stepper 'imx'"),
        ('method = "seeds"', 'method = "seed"', "method: must be"),
        ("min_depth = {low", "min_depth = {lowest", "bounds.min_depth"),
    ],
)
def test_a_file_that_is_not_as_the_schema_says(tmp_path, old, new, complaint) -> None:
    (tmp_path / "calm.toml").write_text(GROUP.replace(old, new))
    with pytest.raises(ConfigError, match=complaint):
        read_group(tmp_path / "calm.toml")


def test_every_case_can_be_run() -> None:
    """Its configuration is known, its scene can be made, and it requires something."""
    for case in CASES:
        assert case.checks or case.expect == "refuse"
        if case.method != "seeds":
            make_scene(case.configured())
        for symmetry in case.symmetries:
            assert symmetry in SYMMETRIES


# --- choosing and keeping


def test_names_are_unique_and_every_stepper_is_tried() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    for group in ("noise", "rest", "random"):
        assert {case.stepper for case in GROUPS[group].cases} == set(STEPPERS)


def test_choosing() -> None:
    chosen = choose("stability", ["noise", "steady"], ["fully-implicit", "rk4"])
    assert [*dict.fromkeys(case.group for case in chosen)] == ["noise", "steady"]
    assert {case.stepper for case in chosen} == {"tr-bdf2", "rk4"}
    with pytest.raises(ConfigError, match="did you mean 'noise'"):
        choose("stability", ["noize"])
    with pytest.raises(ConfigError, match="no case remains"):
        choose("stability", ["steady"], ["gauss-legendre"], quick=True)


@pytest.mark.parametrize("name", ["page.json", "page.md"])
def test_a_file_of_something_else_is_not_overwritten(tmp_path, capsys, name) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(SystemExit) as end:
        main(["stress", "--quick", "--groups", "steady", "--out", str(tmp_path / "page.md")])
    assert end.value.code == 2 and "would be replaced" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "mine"


def test_the_quick_form_does_not_replace_the_full_one(tmp_path, capsys) -> None:
    page, numbers = tmp_path / "page.md", tmp_path / "page.json"
    page.write_text("# Stability\n")
    numbers.write_text('{\n "quick": false,\n "results": []\n}\n')
    with pytest.raises(SystemExit) as end:
        main(["stress", "--quick", "--groups", "steady", "--out", str(page)])
    assert end.value.code == 2 and "is of the full form" in capsys.readouterr().err
    assert page.read_text() == "# Stability\n"


def test_a_page_of_chosen_cases_replaces_only_a_page_of_the_same(tmp_path, capsys) -> None:
    page = tmp_path / "page.md"
    line = ["stress", "--quick", "--groups", "steady", "--steppers", "rk4", "--out", str(page)]
    page.write_text("# Stability\n\nAll cases.\n")
    with pytest.raises(SystemExit) as end:
        main(line)
    assert end.value.code == 2 and "is a page of other cases" in capsys.readouterr().err
    assert page.read_text() == "# Stability\n\nAll cases.\n"
    page.write_bytes(b"# Stability\n\xff\xfe\n")
    with pytest.raises(SystemExit) as end:
        main(line)
    assert end.value.code == 2 and "is a page of other cases" in capsys.readouterr().err
    page.unlink()
    same = [
        "stress",
        "--groups=steady",
        "--json",
        "--jobs=1",
        "--steppers=rk4",
        *line[6:],
        "--quick",
    ]
    for words in (line, line, same):
        with pytest.raises(SystemExit) as end:
            main(words)
        assert end.value.code == 0
    capsys.readouterr()
    before = page.read_bytes()
    with pytest.raises(SystemExit) as end:
        main([*line, "--resume"])
    assert end.value.code == 2 and "is finished: leave resume out" in capsys.readouterr().err
    assert page.read_bytes() == before


def test_results_of_other_code_are_not_those_of_this_one(monkeypatch) -> None:
    case = find("beyond-limit-rk4")
    before = case.fingerprint
    assert case.fingerprint == before
    monkeypatch.setattr("swe_sphere.studies.cases.case.code_fingerprint", lambda *_: "other")
    assert case.fingerprint != before


# --- all of the quick form


@pytest.mark.exhaustive
def test_the_quick_form_passes(tmp_path, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["stress", "--quick", "--json", "--out", str(tmp_path / "page.md")])
    told = json.loads(capsys.readouterr().out)
    bad = [result for result in told["results"] if result["outcome"] in ("failed", "broke")]
    assert (bad, end.value.code) == ([], 0)
    assert told["passed"] >= 12
    assert told["refused"] + told["stopped"] >= 3
    assert json.loads((tmp_path / "page.json").read_text()) == told
    groups = {case.group for case in choose("stability", quick=True)}
    assert {"steady", "noise", "depth", "random", "guards"} <= groups


def test_trials_that_were_interrupted_go_on(monkeypatch, tmp_path, capsys) -> None:
    """After the ones that were finished."""
    line = ["stress", "--quick", "--groups", "steady", "--out", str(tmp_path / "page.md")]
    begun: list[str] = []

    def interrupted(case, _):
        begun.append(case.name)
        if len(begun) == 2:
            raise Interrupted("interrupted by Ctrl-C at day 1")
        return judge(case).measure.model_copy(update={"fingerprint": case.fingerprint})

    monkeypatch.setattr("swe_sphere.studies.cases.rows.measure", interrupted)
    with pytest.raises(SystemExit) as end:
        main(line)
    assert end.value.code == 130
    told = "interrupted by Ctrl-C at day 1; resume with --resume"
    assert told in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*line, "--resume"])
    assert begun == [begun[0], begun[1], begun[1]]


@pytest.mark.parametrize(
    "precision", ["float64", pytest.param("float32", marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize("stepper", ["tr-bdf2", "crank-nicolson", "esdirk4", "gauss-legendre"])
def test_implicit_steps_leave_a_lake_at_rest(stepper: str, precision: str) -> None:
    """Residuals that were let pass came back as slopes of the next step: 1e-9 m/s of wind.

    So did round-off of a new state that was put together from whole states: 0.04 m/s in float32.
    """
    case = small(f"lake-cone-{precision}-{stepper}", days=2.0)
    assert try_out(case).quantities["max_wind"] == 0.0


@pytest.mark.parametrize("seed", [91, 116])
@pytest.mark.thorough
def test_the_limit_of_ars343_holds_over_hills(seed: int) -> None:
    """With the gravity waves of deviating depths left out of it, it was half as long again."""
    scene = {"scene": "cases:random-state", "set": {"scene": {"seed": seed}}}
    run = {"stepper": "ars343", "days": 1.0, **random_setting(seed)[0], **scene}
    case = Case(method="series", name="hills", run=run, part=0.95, steps=40)
    assert try_out(case).outcome == "passed"


@pytest.mark.parametrize("name", ["forward-backward", "fb-rk3"])
@pytest.mark.thorough
def test_a_planet_that_turns_fast_limits_steps_that_extrapolate_the_wind(name: str) -> None:
    """With waves and winds alone in the limit, this one ran dry in eleven steps."""
    scene = {"scene": "cases:random-state", "set": {"scene": {"seed": 192}}}
    run = {"stepper": name, "days": 1.0, **random_setting(192)[0], **scene}
    case = Case(
        method="series", name="turning", run=run, part=0.88, steps=12, bounds={"froude": 0.1}
    )
    assert try_out(case).outcome == "passed"


@pytest.mark.parametrize(
    ("wind", "counts"), [(100.0, "| 0 | 0 | 1 | 0 | 0 |"), (200.0, "| 0 | 0 | 1 | 0 | 1 |")]
)
def test_reruns_with_a_remedy_count_only_if_they_fail(wind: float, counts: str) -> None:
    case, rerun = find("over-peak-rk4"), find("over-peak-rk4+hyperviscosity")
    numbers = {"mass_drift": 0.0, "min_depth": 1.0}
    stopped = judge(case, "unstable", "because", max_wind=200.0, **numbers)
    made = page("stability", [stopped, judge(rerun, max_wind=wind, **numbers)], "swe-sphere stress")
    assert f"15 days {counts}" in made
    assert f"{1 if wind == 100.0 else 0} of these pass with dissipation" in made


def test_the_page_in_docs_is_made_of_the_numbers_beside_it() -> None:
    """Every result is of a case that there is, and the page shows it."""
    with (ROOT / "benchmarks/results/stability.csv").open(encoding="utf-8") as file:
        next(file)  # commit, machine and date
        found = [{k: v for k, v in row.items() if v} for row in csv.DictReader(file)]
    rows = []
    for each in found:
        name, status, message = each.pop("name"), each.pop("status"), each.pop("message", "")
        rows.append(judge(find(name), status, message, **{k: float(v) for k, v in each.items()}))
    made = page("stability", rows, "swe-sphere stress")
    text = (ROOT / "docs/results/stability.md").read_text(encoding="utf-8")
    assert (
        text.partition("\n## How it was measured\n")[0]
        == made.partition("\n## How it was measured\n")[0]
    )
    assert f"in {sum(float(each['seconds']) for each in found):.0f} s on one CPU core" in text
    assert len(text) > 10_000


def test_status_and_reason_of_a_batch_are_those_of_one_seed(monkeypatch):
    ends = iter([Summary("unstable", "blew up", 1), Summary("failed", "a fault", 1), Summary()])
    monkeypatch.setattr(measuring, "attempt", lambda run: next(ends))
    (case, *_) = [case for case in choose("stability") if case.method == "seeds"]
    case = case.model_copy(update={"seeds": case.seeds[:3]})
    found = measuring.METHODS["seeds"](case, case.configured(), None)
    assert (found.status, found.numbers["stopped"]) == ("failed", 2.0)
    assert found.reason == f"seed {case.seeds[1]}: failed: a fault"
