"""Parts of a sweep that run nothing: plan, steps, searches, schedule, recipes."""

import errno
import math
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.files.durable import write_whole
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.planning import free_steps
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.sweep.engine import NoStepError, longest_accurate, longest_working
from swe_sphere.studies.sweep.record import Errors, _converged
from swe_sphere.studies.sweep.runs import Study, dt_sequence
from swe_sphere.studies.sweep.sweep_plan import RECIPES, folder_of, load_recipe, make_plan

ROOT = Path(__file__).parents[1]


# --- plan


def test_lists_may_be_written_in_any_way():
    plan = make_plan(
        {
            "scene": "williamson2",
            "steppers": "rk4, tr-bdf2",
            "ne": "4,8",
            "np": 4,
            "dt": [600, 1200],
        }
    )
    assert plan.steppers == ("rk4", "tr-bdf2")
    assert (plan.ne, plan.np, plan.dt) == ((4, 8), (4,), (600.0, 1200.0))
    assert make_plan({"scene": "williamson2", "steppers": "rk4"}).dt == "auto"


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"scene": "wiliamson2"}, "unknown scene 'wiliamson2'; did you mean 'williamson2'"),
        ({"steppers": "rk5"}, "unknown stepper 'rk5'; did you mean 'rk4'"),
        ({"steppers": ""}, "steppers: must not be empty"),
        ({"precision": ""}, "precision: must not be empty"),
        ({"preconditioner": "helmhotz"}, "unknown preconditioner 'helmhotz'"),
        ({"dt": "600,soon"}, "dt: must be positive numbers of seconds or 'auto', got '600,soon'"),
        ({"dt": -1}, "dt: must be positive numbers"),
        ({"ne": 0}, "ne=0"),
        ({"np": "4,2"}, "np=2"),
        ({"precision": "float16"}, "precision: must be 'float64' or 'float32'"),
        ({"days": 2, "report_days": "1,3"}, "report-days: day 3 is after the end, day 2"),
        ({"repeats": 0}, "repeats: must be greater than or equal to 1"),
        ({"target_error": 0}, "target-error: must be greater than 0"),
        ({"target_error": ""}, "target-error: must not be empty"),
        ({"preconditioner": ","}, "preconditioner: must not be empty"),
        ({"budget": 10}, "budget: only a search uses it: give target-error"),
        (
            {"budget": 10, "target_error": 1e-3, "jobs": 2},
            "jobs: processes cannot share a budget: leave jobs or budget out",
        ),
        ({"target_norm": "l3"}, "target-norm: must be 'l1', 'l2' or 'linf'"),
        ({"time_limit": -1}, "time-limit: must be greater than 0"),
        ({"reference": "none.nc"}, "reference: there is no file none.nc"),
        ({"steper": "rk4"}, "unknown option 'steper'; did you mean 'steppers'"),
        ({"settings": "viscosity.mu=1"}, "has no parameter 'mu'"),
    ],
)
def test_a_mistake_in_a_plan_is_one_line(values, line):
    with pytest.raises(ConfigError) as error:
        make_plan({"scene": "williamson2", "steppers": "rk4", **values})
    assert line in str(error.value) and "\n" not in str(error.value)


def test_a_plan_without_a_scene_says_so():
    with pytest.raises(ConfigError, match="scene: name one"):
        make_plan({"steppers": "rk4"})


# --- sequences of steps


def test_an_explicit_sequence_goes_down_from_the_limit():
    steps = dt_sequence(800.0, True, 300.0, 86400.0, 5)
    assert steps[0] == 800.0 and len(steps) == 5
    assert np.allclose(np.divide(steps[:-1], steps[1:]), math.sqrt(2.0))


def test_a_semi_implicit_sequence_goes_from_the_gravity_limit_to_that_of_the_wind():
    steps = dt_sequence(2400.0, False, 300.0, 86400.0, 4)
    assert np.allclose(steps, [2400.0, 1200.0, 600.0, 300.0])


def test_an_implicit_sequence_goes_up_from_the_gravity_limit():
    steps = dt_sequence(math.inf, False, 300.0, 86400.0, 6)
    assert steps[0] == 64.0 * 300.0 and steps[-1] == pytest.approx(2.0 * 300.0)
    assert np.allclose(np.divide(steps[:-1], steps[1:]), 2.0)


def test_no_step_of_a_sequence_exceeds_the_wind_limit_or_the_time_between_reports():
    assert dt_sequence(2000.0, False, 300.0, 86400.0, 4)[0] == 2000.0
    assert dt_sequence(math.inf, False, 300.0, 7200.0, 4)[0] == 7200.0
    assert dt_sequence(math.inf, False, math.inf, 7200.0, 4) == [7200.0]


# --- searches


@pytest.mark.parametrize("guess", [1.0, 90.0, 130.0, 1e4])
def test_the_longest_working_step_is_found_to_two_percent(guess):
    tried = []

    def works(dt):
        tried.append(dt)
        return dt <= 123.4

    found = longest_working(works, guess, shortest=1.0, longest=1e4, growth=1.25)
    assert 123.4 / 1.02 <= found <= 123.4
    assert len(tried) < 40


def test_a_limit_beyond_the_longest_or_below_the_shortest_step():
    assert longest_working(lambda dt: True, 10.0, 1.0, 500.0, 1.25) == 500.0
    assert longest_working(lambda dt: False, 10.0, 1.0, 500.0, 1.25) is None


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_longest_accurate_step_is_found(order):
    tried = []

    def error(dt):
        tried.append(dt)
        return 2e-4 * (dt / 1000.0) ** order

    found = longest_accurate(error, 1e-6, longest=20000.0, shortest=0.01)
    exact = 1000.0 * (1e-6 / 2e-4) ** (1.0 / order)
    assert exact / 1.05 <= found <= exact
    assert len(tried) < 25


def test_a_search_knows_when_the_step_does_not_matter():
    with pytest.raises(NoStepError, match=r"stays at 0\.001"):
        longest_accurate(lambda dt: 1e-3 + 1e-9 * dt, 1e-4, 10000.0, 1.0)


def test_failed_runs_are_steps_too_long():
    found = longest_accurate(lambda dt: math.inf if dt > 900.0 else 1e-7 * dt, 1e-4, 10000.0, 1.0)
    assert 900.0 / 1.05 <= found <= 900.0
    with pytest.raises(NoStepError, match="even at dt = 10 s"):
        longest_accurate(lambda dt: math.inf, 1e-4, 100.0, 10.0)


def test_a_step_that_is_good_at_once_is_taken():
    assert longest_accurate(lambda dt: 0.0, 1e-4, 100.0, 10.0) == 100.0


# --- schedule


def test_steps_meet_all_report_times():
    plan = {"scene": "williamson2", "steppers": "rk4", "ne": 2, "np": 4, "days": 5}
    study = Study(make_plan(plan | {"report_days": "1,2.5"}))
    assert study.report_days == (1.0, 2.5, 5.0)
    assert study.interval == 0.5 * DAY
    steps = study.plan_steps(1000.0)
    assert 0.5 * DAY / steps.dt == pytest.approx(round(0.5 * DAY / steps.dt))
    run = study.setups()[0].spec(1000.0)
    counts = np.array(run.report_days) * DAY / run.dt
    assert run.report_days == (1.0, 2.5, 5.0) and np.allclose(counts, np.round(counts))
    assert round(counts[-1]) == steps.steps
    with pytest.raises(ConfigError, match="no step near"):
        study.plan_steps(2.0 * DAY)


def test_the_stated_error_of_converged_runs_is_the_largest_of_all_meshes():
    """On each mesh the run with the shortest step counts."""

    def converged(ne: int, dt: float, l2: float) -> SimpleNamespace:
        config = make_config({"scene": "lauter", "ne": ne, "np": 4, "dt": dt, "days": 1.0})
        error = Errors(kind="time", field="h", day=1.0, l1=0.5 * l2, l2=l2, linf=2.0 * l2)
        return SimpleNamespace(role="converged", config=config, errors=[error])

    runs = [converged(2, 120.0, 1.6e-5), converged(2, 60.0, 1e-6), converged(4, 30.0, 3e-6)]
    assert _converged(runs) == _converged(runs[::-1]) == (30.0, 3e-6)


def test_trials_keep_their_step():
    steps = free_steps(1.0, 1000.0)
    assert (steps.dt, steps.steps) == (1000.0, 87)


# --- whole files


def refuse(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_whole(path, "old")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    for owner, name in ((Path, "write_bytes"), (os, "fsync"), (os, "replace")):
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, refuse)
            with pytest.raises(RunFailed, match=r"cannot write .*a\.txt: No space left"):
                write_whole(path, "newer")
        assert path.read_bytes() == b"new"
    assert [*tmp_path.iterdir()] == [path]


# --- recipes


def test_the_recipes_of_the_package_are_plans():
    names = {path.stem for path in RECIPES.glob("*.toml")}
    assert names == {"evans2010", "quick"}
    evans = load_recipe("evans2010").plans({})
    scenes = "williamson2", "williamson5", "williamson6", "galewsky", "lauter"
    assert tuple(dict.fromkeys(plan.scene for plan in evans)) == scenes
    for scene in scenes:
        tried = {name for plan in evans if plan.scene == scene for name in plan.steppers}
        assert {"leapfrog", "rk4", "semi-implicit", "tr-bdf2", "bdf2"} <= tried
    assert set(load_recipe("evans2010").notes) == {*scenes}
    assert len(load_recipe("quick").plans({})) == 1
    plans = load_recipe(str(ROOT / "benchmarks" / "resolution.toml")).plans({})
    assert len({folder_of(dict(plan)) for plan in plans}) == len(plans) > 5


def test_a_family_stands_for_all_of_its_steppers():
    plan = make_plan({"scene": "williamson2", "steppers": "imex, rk4"})
    families = [STEPPERS[name].family for name in plan.steppers]
    assert families == ["imex"] * (len(families) - 1) + ["explicit"] and len(families) > 3
    again = make_plan({"scene": "williamson2", "steppers": [plan.steppers[1], "imex", "rk4,rk4"]})
    assert set(again.steppers) == set(plan.steppers) and len(again.steppers) == len(families)


def test_flags_go_before_the_recipe():
    recipe = load_recipe("evans2010")
    assert all(plan.ne == (2,) for plan in recipe.plans({"ne": "2"}))
    assert [plan.scene for plan in recipe.plans({"scene": "lauter"})] == ["lauter"]
    with pytest.raises(ConfigError, match="the recipe has no scene 'lake-at-rest'; it has"):
        recipe.plans({"scene": "lake-at-rest"})


def test_a_recipe_of_the_user(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('scene = "lauter"\nsteppers = ["rk4"]\nreport-days = [1]\nset = ["a.b=1"]\n')
    (values,) = load_recipe(str(path)).sweeps
    assert values["report_days"] == [1] and values["settings"] == [("a", "b", "1")]
    path.write_text('scene = "lauter"\nset = "a.b=1"\n')
    (values,) = load_recipe(str(path)).sweeps
    assert values["settings"] == [("a", "b", "1")]
    with pytest.raises(ConfigError, match="unknown recipe 'quik'; did you mean 'quick'"):
        load_recipe("quik")
    path.write_text("scene = ")
    with pytest.raises(ConfigError, match=r"mine\.toml is not valid TOML"):
        load_recipe(str(path))
