"""Stress trials: how they are judged, kept and chosen; the quick form; broken code is noticed."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.interrupt import Interrupted
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.configuration import Configuration
from swe_sphere.studies.ended import Ended
from swe_sphere.studies.record_store import read_record
from swe_sphere.studies.stress import (
    Result,
    Store,
    Trial,
    choose,
    groups,
    judge,
    page,
    try_out,
)
from swe_sphere.studies.stress.random_state import FASTEST, SHALLOWEST, random_scene, random_setting
from swe_sphere.studies.stress.series import SYMMETRIES, Series
from swe_sphere.studies.stress.trial import read_group
from swe_sphere.studies.stress.trial_page import Results
from swe_sphere.testcases import get_scene

DOCS = Path(__file__).parents[1] / "docs"


def find(name: str) -> Trial:
    """The trial of that name."""
    return next(t for group in groups().values() for t in group.trials if t.name == name)


# --- judging

CALM = {"bounds": {"max_wind": 10.0}, "always": {"mass_drift": 1e-12}}


def calm(expect: str = "pass") -> Trial:
    return Trial(name="x", run={"stepper": "rk4"}, expect=expect, **CALM)


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
        ("either", "unstable", 11.0, 0.0, "refused"),
        ("either", "solver-failed", 11.0, 0.0, "refused"),
        ("either", "unstable", 9.0, 1e-9, "failed"),
        ("either", "timed-out", 9.0, 0.0, "failed"),
        ("either", "failed", 9.0, 0.0, "failed"),
        ("refuse", "refused", 9.0, 0.0, "refused"),
        ("refuse", "completed", 9.0, 0.0, "failed"),
        ("break", "completed", 11.0, 0.0, "broke"),
        ("break", "completed", 9.0, 0.0, "passed"),
        ("break", "unstable", 9.0, 0.0, "refused"),
        ("break", "failed", 9.0, 0.0, "failed"),
    ],
)
def test_what_an_end_is_called(expect, status, wind, mass, outcome):
    trial = calm(expect)
    ended = Ended(status, "because", {"max_wind": wind, "mass_drift": mass})
    result = judge(trial, ended)
    assert result.outcome == outcome
    assert result.reason or outcome == "passed"


def test_what_was_not_measured_does_not_hold():
    assert judge(calm(), Ended()).outcome == "failed"


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

    series = Series(SimpleNamespace(steps=120), [])
    for day in days:
        series.observe(SimpleNamespace(time=day, diagnostics=sampled(day), snapshot=None))
    assert series.numbers()["growth_v"] == pytest.approx(growth, rel=0.01)


# --- symmetries


def test_fourfold_sees_what_is_off_the_wave() -> None:
    mesh = Mesh.build(3, 4)
    _, v, h = get_scene("williamson6").initial(mesh.lon, mesh.lat)
    symmetry = SYMMETRIES["fourfold"](mesh)
    one = np.cos(mesh.lat) * np.sin(mesh.lon)
    assert symmetry(SimpleNamespace(fields={"v": v}))["off_wave"] < 1e-25
    assert symmetry(SimpleNamespace(fields={"v": one}))["off_wave"] == pytest.approx(1.0)
    mirror = SYMMETRIES["mirror"](mesh)
    assert mirror(SimpleNamespace(fields={"h": h}))["off_mirror"] < 1e-13
    assert mirror(SimpleNamespace(fields={"h": np.sin(mesh.lat)}))["off_mirror"] == pytest.approx(2)


def test_a_mesh_without_the_symmetry_is_refused() -> None:
    with pytest.raises(ValueError, match="does not have this symmetry"):
        SYMMETRIES["fourfold"](Mesh.build(2, 4, spin=17.0))


# --- random states


@pytest.mark.parametrize("seed", range(0, 200, 13))
def test_random_states_are_admissible(seed: int) -> None:
    scene, (mesh, length) = random_scene(seed), random_setting(seed)
    lon, lat = Mesh.build(3, mesh["np"]).lon, Mesh.build(3, mesh["np"]).lat
    u, v, h = scene.initial(lon, lat)
    again = random_scene(seed).initial(lon, lat)
    assert np.array_equal((u, v, h), again)
    assert h.min() > SHALLOWEST * np.mean(h)
    # a little more than the flow itself may have, for the noise
    assert np.max(np.hypot(u, v) / np.sqrt(scene.planet.gravity * h)) < FASTEST + 0.05
    assert 0.3 <= length.part < 1.0 <= length.courant <= 10.0**1.5


def test_all_seeds_are_dealt_out_to_all_steppers() -> None:
    trials = groups()["random"].trials
    assert sorted(seed for trial in trials for seed in trial.seeds) == list(range(200))
    assert {trial.stepper for trial in trials} == set(STEPPERS)


# --- what breaks is noticed


def small(name: str, **run: object) -> Trial:
    """A trial of the suite, on a small mesh."""
    trial = find(name)
    return trial.changed(run={"ne": 4, **run})


def test_a_step_beyond_the_limit_fails() -> None:
    trial = small("steady-pi/4-rk4").changed(part=1.5)
    assert try_out(trial).outcome == "failed"
    within = try_out(small("steady-pi/4-rk4", days=3.0).changed(part=0.9, bounds={}))
    assert within.outcome == "passed"


def test_a_filter_of_the_wrong_sign_fails() -> None:
    trial = small("noisy-williamson2-leapfrog", days=2.0, dt=600.0)
    assert try_out(trial).outcome == "passed"
    wrong = trial.changed(run={"set": {"stepper": {"strength": -0.1}}})
    assert try_out(wrong).outcome == "failed"


def test_time_that_is_used_up_fails() -> None:
    result = try_out(small("steady-pi/4-rk4").changed(seconds=1e-3))
    assert (result.outcome, result.reason[:9]) == ("failed", "timed-out")


def test_an_error_that_is_none_of_ours_fails(monkeypatch) -> None:
    def make_scene(_):
        raise ValueError("no such thing")

    monkeypatch.setattr(Configuration, "make_scene", make_scene)
    result = try_out(small("steady-pi/4-rk4").changed(expect="either"))
    assert result.reason == "failed: ValueError: no such thing"
    assert result.outcome == "failed"


def test_a_file_with_nan_is_noticed() -> None:
    trial = find("beyond-limit-rk4")
    ended = Ended("unstable", "it blew up", {"not_finite": 3.0})
    assert judge(trial, ended).outcome == "failed"


# --- tables of trials

GROUP = """
title = "Calm"
text = "Nothing moves."
[shared]
steppers = ["imex", "rk4"]
run = {scene = "lake-at-rest", ne = 4, np = 4}
always = {mass_drift = 1e-12}
[[trial]]
name = "lake"
run = {days = 2.0}
bounds = {min_depth = {low = 0.0}}
remedy = {viscosity.nu = 1e5}
remedied = ["rk4"]
quick = ["ark2"]
quickly = {run = {days = 1.0}}
[[trial]]
name = "random"
steppers = ["rk4", "explicit"]
method = "seeds"
seeds = 10
"""


def test_a_table_is_a_trial_for_each_stepper(tmp_path) -> None:
    (tmp_path / "calm.toml").write_text(GROUP)
    group = read_group(tmp_path / "calm.toml")
    trials = {trial.name: trial for trial in group.trials}
    imex = [name for name, kind in STEPPERS.items() if kind.family == "imex"]
    explicit = [name for name, kind in STEPPERS.items() if kind.family == "explicit"]
    assert (group.name, group.title) == ("calm", "Calm")
    first = [*(f"lake-{name}" for name in imex), "lake-rk4", "lake-rk4+viscosity"]
    assert list(trials)[: len(first)] == first
    assert trials["lake-rk4"].expect == "break"
    assert trials["lake-ark2"].expect == "either"
    helped = trials["lake-rk4+viscosity"]
    assert helped.expect == "pass"
    assert helped.configuration.make_scene().effect("viscosity").nu == 1e5
    assert [str(bound) for bound in helped.all_bounds] == ["mass_drift ≤ 1e-12", "min_depth ≥ 0"]
    quick = trials["lake-ark2"].quickly()
    assert (quick.run["days"], quick.run["ne"], quick.stepper) == (1.0, 4, "ark2")
    assert helped.quick is None
    dealt = [trial.seeds for name, trial in trials.items() if name.startswith("random")]
    assert list(trials)[len(first)] == "random-rk4"
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


def test_every_trial_can_be_run() -> None:
    """Its configuration is known, its scene can be made, and it asks for something."""
    for trial in (t for group in groups().values() for t in group.trials):
        assert trial.all_bounds or trial.expect == "refuse"
        if trial.method != "seeds":
            trial.configuration.make_scene()
        for symmetry in trial.symmetries:
            assert symmetry in SYMMETRIES


# --- choosing and keeping


def test_names_are_unique_and_every_stepper_is_tried() -> None:
    trials = [trial for group in choose() for trial in group.trials]
    assert len({trial.name for trial in trials}) == len(trials)
    for group in ("noise", "rest", "random"):
        assert {trial.stepper for trial in groups()[group].trials} == set(STEPPERS)


def test_choosing() -> None:
    chosen = choose(["noise", "steady"], ["fully-implicit", "rk4"])
    assert [group.name for group in chosen] == ["noise", "steady"]
    assert {trial.stepper for group in chosen for trial in group.trials} == {"tr-bdf2", "rk4"}
    with pytest.raises(ConfigError, match="did you mean 'noise'"):
        choose(["nois"])
    with pytest.raises(ConfigError, match="no trial is left"):
        choose(["steady"], ["gauss-legendre"], quick=True)


def result(name: str, outcome: str, reason: str, code: str, **numbers: float) -> Result:
    return Result(
        name=name, stepper="rk4", outcome=outcome, reason=reason, numbers=numbers, fingerprint=code
    )


def test_results_stay_until_they_are_replaced(tmp_path) -> None:
    path, name = tmp_path / "page.md", "steady-pi/4-rk4"
    store = Store(path, quick=False)
    store.add(result(name, "failed", "why", "abc", l2_v=math.nan))
    store.add(result("island-rk4", "refused", "no water", "def"))
    again = Store(path, quick=False)
    assert again.known(name, "abc") is not None
    assert again.known(name, "xyz") is None
    with again.unfinished():
        again.add(result(name, "passed", "", "abc", l2_v=0.002))
        with pytest.raises(ConfigError, match="another process"), store.unfinished():
            pass
    text, numbers = path.read_text(), json.loads((tmp_path / "page.json").read_text())
    assert "no water" in text
    assert "| passed | l2_v 0.002 |" in text
    assert numbers["results"][name]["outcome"] == "passed"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["page.json", "page.md"]
    assert Store(path, quick=False).known("island-rk4", "def")
    with pytest.raises(ConfigError, match="full form"):
        Store(path, quick=True)


@pytest.mark.parametrize(("name", "word"), [("page.txt", "must end in"), ("no/page.md", "folder")])
def test_places_that_do_not_do(tmp_path, name: str, word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        Store(tmp_path / name, quick=False)


@pytest.mark.parametrize(
    "text",
    ['{"rows": []}', "[]", '{"quick": false, "results": []}', '{"quick": false',
     '{"quick": false, "results": {"a": 1}}', '{"quick": false, "results": {"a": {"reason": ""}}}'],
)  # fmt: skip
def test_a_file_of_something_else_is_not_overwritten(tmp_path, text) -> None:
    (tmp_path / "page.json").write_text(text)
    with pytest.raises(ConfigError, match="is no record of this version"):
        Store(tmp_path / "page.md", quick=False)
    assert (tmp_path / "page.json").read_text() == text


def test_a_disk_that_is_full_leaves_the_results_before(tmp_path, monkeypatch) -> None:
    store = Store(tmp_path / "page.md", quick=False)
    store.add(result("island-rk4", "refused", "no water", "def"))

    def refuse(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr("os.write", refuse)
        with pytest.raises(RunFailed, match=r"cannot write .*000002\.json: No space left on"):
            store.add(result("steady-pi/4-rk4", "passed", "", "abc"))
    again = Store(tmp_path / "page.md", quick=False)
    assert again.known("island-rk4", "def") and not again.known("steady-pi/4-rk4", "abc")


def test_results_of_other_code_are_not_those_of_this_one(monkeypatch) -> None:
    trial = find("beyond-limit-rk4")
    before = trial.fingerprint
    assert trial.fingerprint == before
    monkeypatch.setattr("swe_sphere.studies.stress.trial.code_fingerprint", lambda *_: "other")
    assert trial.fingerprint != before


# --- all of the quick form


@pytest.mark.thorough
def test_the_quick_form_passes_and_is_not_run_twice(tmp_path, capsys) -> None:
    line = ["stress", "--quick", "--json", "--resume", "--out", str(tmp_path / "page.md")]
    with pytest.raises(SystemExit) as end:
        main(line)
    told = json.loads(capsys.readouterr().out)
    bad = [result for result in told["results"] if result["outcome"] in ("failed", "broke")]
    assert (bad, end.value.code) == ([], 0)
    assert told["passed"] >= 12
    assert told["refused"] >= 3
    groups = {group.name for group in choose(quick=True)}
    assert {"steady", "noise", "depth", "random", "guards"} <= groups
    with pytest.raises(SystemExit):
        main(line)
    assert json.loads(capsys.readouterr().out)["results"] == []


def test_trials_that_were_interrupted_go_on(monkeypatch, tmp_path, capsys) -> None:
    """After the ones that were finished."""
    line = ["stress", "--quick", "--groups", "steady", "--out", str(tmp_path / "page.md")]
    begun: list[str] = []

    def interrupted(trial, _):
        begun.append(trial.name)
        if len(begun) == 2:
            raise Interrupted("interrupted by Ctrl-C at day 1")
        return judge(trial, Ended())

    monkeypatch.setattr("swe_sphere.studies.stress.try_out", interrupted)
    with pytest.raises(SystemExit) as end:
        main(line)
    assert end.value.code == 130
    told = "interrupted by Ctrl-C at day 1; --resume goes on after the last trial"
    assert told in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*line, "--resume"])
    assert begun == [begun[0], begun[1], begun[1]]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("stepper", ["tr-bdf2", "crank-nicolson", "esdirk4", "gauss-legendre"])
def test_implicit_steps_leave_a_lake_at_rest(stepper: str, precision: str) -> None:
    """Residuals that were let pass came back as slopes of the next step: 1e-9 m/s of wind.

    So did round-off of a new state that was put together from whole states: 0.04 m/s in float32.
    """
    trial = small(f"lake-cone-{precision}-{stepper}", days=2.0)
    assert try_out(trial).numbers["max_wind"] == 0.0


@pytest.mark.parametrize("seed", [91, 116])
def test_the_limit_of_ars343_holds_over_hills(seed: int) -> None:
    """With the gravity waves of deviating depths left out of it, it was half as long again."""
    scene = {"scene": "stress:random-state", "set": {"scene": {"seed": seed}}}
    run = {"stepper": "ars343", "days": 1.0, **random_setting(seed)[0], **scene}
    trial = Trial(name="hills", run=run, part=0.95, steps=40)
    assert try_out(trial).outcome == "passed"


@pytest.mark.parametrize("name", ["forward-backward", "fb-rk3"])
def test_a_planet_that_turns_fast_limits_steps_that_extrapolate_the_wind(name: str) -> None:
    """With waves and winds alone in the limit, this one ran dry in eleven steps."""
    scene = {"scene": "stress:random-state", "set": {"scene": {"seed": 192}}}
    run = {"stepper": name, "days": 1.0, **random_setting(192)[0], **scene}
    trial = Trial(name="turning", run=run, part=0.88, steps=12, bounds={"froude": 0.1})
    assert try_out(trial).outcome == "passed"


def test_the_page_in_docs_is_made_of_the_numbers_beside_it() -> None:
    """Every result is of a trial that there is, and the page shows it."""
    made = page(read_record(DOCS / "stability.json", Results).results, quick=False)
    text = (DOCS / "stability.md").read_text(encoding="utf-8")
    assert text.partition("\n| group |")[2] == made.partition("\n| group |")[2]
    assert len(text) > 10_000
