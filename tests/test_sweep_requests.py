"""Several requests in the folder of one sweep: what is run again, compared and reported."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from swe_sphere import Simulation
from swe_sphere.equations.effects import DYNAMICS, MASSES, Forcing, PointwiseEffect, Rotation
from swe_sphere.errors import ConfigError
from swe_sphere.simulation.diagnostics import diagnostic
from swe_sphere.studies.report import sweep_rankings
from swe_sphere.studies.report.ranking import candidates, read_runs
from swe_sphere.studies.sweep import runner, sweep
from swe_sphere.studies.sweep.record import runs_of
from swe_sphere.studies.sweep.runs import Study
from swe_sphere.studies.sweep.sweep_plan import Recipe, load_recipe, make_plan
from swe_sphere.testcases import get_scene

TINY = {"ne": 2, "np": 4, "days": 0.25, "repeats": 1, "dt": [3600]}
SEARCH = {"ne": 2, "np": 4, "days": 0.25, "repeats": 1, "target_error": 1e-2}


def count(folder):
    return len(runs_of(folder).records)


def test_options_of_the_stepper_are_not_those_of_the_reference_run(tmp_path):
    given = {"ne": 2, "np": 4, "days": 0.25, "repeats": 1, "dt": [600.0, 300.0]}
    data = sweep("lauter", "leapfrog", settings=["stepper.strength=0"], out=tmp_path, **given)
    assert (data["status"] == "completed").all()
    assert set(data["stepper"].values.tolist()) == {"leapfrog", "rk4"}


def test_a_search_ranks_the_runs_of_a_grid_that_it_finds(tmp_path):
    """Its first trial is the first step of an automatic grid."""
    sweep("lauter", "rk4,leapfrog", out=tmp_path, **SEARCH | {"target_error": (), "levels": 1})
    (found,) = sweep_rankings(sweep("lauter", "rk4,leapfrog", out=tmp_path, **SEARCH))
    assert {*found.table.index} == {"rk4", "leapfrog"}
    assert not found.winners(0).empty


def test_default_and_changed_settings_are_two_curves(tmp_path):
    sweep("williamson6", "rk4", out=tmp_path, **TINY)
    both = sweep("williamson6", "rk4", out=tmp_path, settings=["viscosity.nu=1e5"], **TINY)
    runs = read_runs(both)
    assert {*runs[runs["role"] == "grid"]["curve"]} == {"rk4, default", "rk4, viscosity.nu=1e5"}


def test_a_ranking_resolves_the_error_of_its_own_reference():
    found = sweep("galewsky", "rk4", target_kind="slow", **SEARCH)
    (ranking,) = sweep_rankings(found)
    reference = found.isel(run=found.role.values == "converged").error
    slow = reference.sel(kind="slow", field="vorticity", norm="l2").values
    assert ranking.metric.kind == "slow" and ranking.floor == np.nanmin(slow) > 0.0


def forced(rate):
    def forcing(lon, lat, t):
        return 0.0 * lon, 0.0 * lon, rate * np.sin(lat) ** 2

    dynamics = (*DYNAMICS, Rotation(), Forcing())
    scene = get_scene("williamson2")
    return replace(scene, name="forced", effects=dynamics, forcing=forcing, exact=None)


def displaced(rate):
    scene = get_scene("williamson2")

    def exact(lon, lat, t):
        u, v, h = scene.exact(lon, lat, t)
        return u, v, h * (1.0 + rate * t)

    return replace(scene, name="displaced", exact=exact)


@pytest.mark.parametrize("scene", [forced, displaced])
def test_a_changed_function_of_a_scene_makes_other_runs(tmp_path, scene):
    for rate in (0.0, 1e-6):
        found = sweep(scene(rate), "rk4", out=tmp_path, **TINY)
        fresh = sweep(scene(rate), "rk4", **TINY)
        grid, alone = (of.isel(run=of.role.values == "grid").isel(run=-1) for of in (found, fresh))
        assert found.run.size == fresh.run.size  # no row of the other function
        assert grid.mass_drift == alone.mass_drift
        np.testing.assert_array_equal(grid.error, alone.error)
    before = count(tmp_path)
    sweep(scene(1e-6), "rk4", out=tmp_path, **TINY)
    assert count(tmp_path) == before


def test_a_forcing_that_acts_between_samples_makes_other_runs(tmp_path):
    def pulse(rate):
        def forcing(lon, lat, t):
            s = rate * np.exp(-(((t - 13000.0) / 500.0) ** 2))
            return s * np.cos(lat), 0.0 * lon, 0.0 * lon

        plain = get_scene("williamson2")
        return replace(plain, exact=None, forcing=forcing, effects=(*plain.effects, Forcing()))

    given = {"ne": 2, "np": 4, "days": 0.25, "dt": 1080.0, "repeats": 1, "out": tmp_path}
    drifts = [sweep(pulse(rate), "rk4", **given).energy_drift.values for rate in (1e-3, 1e-2)]
    assert np.abs(drifts[1]).max() > 2.0 * np.abs(drifts[0]).max()


def test_a_constant_of_an_effect_that_changes_makes_other_runs(tmp_path):
    @dataclass(frozen=True)
    class Push(PointwiseEffect):
        name = "push"
        conserves = MASSES
        scale: ClassVar[float] = 1e-6

        def coefficients(self, mesh):
            return {"rate": self.scale}

        @staticmethod
        def wind_tendency(c, i, u, v, h):
            return c.rate * u, c.rate * v

        @staticmethod
        def wind_derivative(c, i, u, v, h, du, dv, dh):
            return c.rate * du, c.rate * dv

    scene, counts = get_scene("williamson2").with_effect(Push()), []
    for scale in (1e-6, 1e-6, 1e-5):
        Push.scale = scale
        sweep(scene, "rk4", out=tmp_path, **TINY)
        counts.append(count(tmp_path))
    assert counts[0] == counts[1] < counts[2]


def test_runs_are_made_again_for_a_new_or_changed_diagnostic(tmp_path):
    sweep("williamson2", "rk4", out=tmp_path, **TINY)
    for value in (1.0, 2.0):
        diagnostic(eval(f"lambda sim: {value}"), name="answer")
        found = sweep("williamson2", "rk4", out=tmp_path, **TINY)
        assert (found["answer"].values == value).all()
    before = count(tmp_path)
    sweep("williamson2", "rk4", out=tmp_path, **TINY)
    assert count(tmp_path) == before


def test_runs_of_another_length_are_not_compared(tmp_path):
    sweep("lauter", "rk4", out=tmp_path, report_days=[0.25], **TINY | {"days": 0.5})
    long = sweep("lauter", "rk4", **TINY | {"days": 0.5}).attrs["converged_check"]
    found = sweep("lauter", "rk4", out=tmp_path, **TINY)
    runs = read_runs(found)
    (ranking,) = sweep_rankings(found)
    assert candidates(runs, ranking.metric)["days_planned"].tolist() == [0.25]
    alone = sweep("lauter", "rk4", **TINY)
    assert found.attrs["converged_check"] == alone.attrs["converged_check"] != long


@pytest.mark.parametrize("day", [0.3333, 0.333333])
def test_rounded_report_days_do_not_shorten_the_steps(day):
    options = TINY | {"days": 1.0, "dt": [3600], "report_days": [day]}
    if day == 0.3333:  # not near enough to a third
        with pytest.raises(ConfigError, match=r"report-days: steps of 8.64 s would be needed"):
            sweep("lauter", "rk4", **options)
        return
    found = sweep("lauter", "rk4", **options)
    assert found.isel(run=found.role.values == "grid").dt.values.tolist() == [3600.0]
    assert found.report_day.values.tolist() == [1.0 / 3.0, 1.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target_error": 1e-2, "dt": 600}, "dt: only a grid uses it"),
        ({"target_error": 1e-2, "levels": 3}, "levels: only a grid uses it"),
        ({"target_norm": "linf"}, "target-norm: only a search uses it"),
        ({"budget": 3}, "budget: only a search uses it"),
        ({"target_error": 1e-2, "target_kind": "slow", "target_field": "h"}, "is of vorticity"),
    ],
)
def test_options_without_effect_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        make_plan({"scene": "lauter", "steppers": "rk4"} | options)


def test_a_search_that_ends_early_gives_the_reason_of_its_last_run():
    notes = []

    class Notes(runner.SweepWatcher):
        def note(self, text):
            notes.append(text)

    search = SEARCH | {"target_error": 1e-12}
    sweep("lauter", "rk4", watcher=Notes(), time_limit=0.004, **search | {"ne": 4, "days": 4.0})
    assert len(notes) == 1 and "dt = " in notes[0] and "the time limit of" in notes[0]
    assert "inf" not in notes[0]


def test_a_run_without_memory_is_tried_again(tmp_path, monkeypatch):
    def full(*arguments):
        raise MemoryError("no memory")

    with monkeypatch.context() as change:
        change.setattr("swe_sphere.simulation.simulation.Simulation.run_plan", full)
        sweep("lauter", "rk4", out=tmp_path, **TINY)
    found = sweep("lauter", "rk4", out=tmp_path, **TINY)
    assert (found.status.values == "completed").all()
    assert math.isfinite(found.attrs["converged_check"])


def test_combinations_of_a_recipe_keep_its_name_and_note(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        'scene = "williamson2"\nsteppers = "rk4"\n[[sweep]]\nname = "mine"\nnote = "A note."\n'
        "[sweep.each]\n'scene.alpha' = [0.1, 0.2]\n"
    )
    found = load_recipe(str(file))
    assert found.notes == {"mine-alpha0.1": "A note.", "mine-alpha0.2": "A note."}
    assert [plan.name for plan in found.plans({})] == ["mine-alpha0.1", "mine-alpha0.2"]


def test_sweeps_of_one_folder_have_one_length_and_target():
    values = {"scene": "williamson2", "steppers": "rk4"}
    two = Recipe("two", (values | {"days": 0.5}, values | {"days": 0.25}))
    with pytest.raises(ConfigError, match="williamson2 differ in days or target: give each a name"):
        two.plans({})
    assert len(two.plans({"days": 1.0})) == 2


def steps_of(dataset, role):
    return dataset.isel(run=dataset.role.values == role).dt.values.tolist()


def test_a_search_refines_its_reference_in_a_new_folder_only(tmp_path):
    """Otherwise errors of one folder would be relative to different runs."""
    search = SEARCH | {"target_error": 1e-7}
    fresh = sweep("williamson6", "rk4", out=tmp_path / "fresh", **search)
    assert len(steps_of(fresh, "converged")) > 2
    again = sweep("williamson6", "rk4", out=tmp_path / "fresh", **TINY | {"dt": [1080]})
    assert steps_of(again, "converged") == steps_of(fresh, "converged")
    first = sweep("williamson6", "rk4", out=tmp_path / "grid", **TINY | {"dt": [1080]})
    grid = again.isel(run=again.role.values == "grid")
    error = grid.error.sel(kind="time", field="h", norm="l2").isel(report_day=-1)
    assert error.max() > 1e-6  # the run is not its own reference
    later = sweep("williamson6", "rk4", out=tmp_path / "grid", **search)
    assert steps_of(later, "converged") == steps_of(first, "converged")


def test_a_run_of_minutes_is_no_fault_of_report_days():
    found = sweep("williamson2", "rk4", **TINY | {"days": 0.003, "dt": [60]})
    assert (found.status.values == "completed").all()
    late = TINY | {"report_days": [0.25, 0.2500000001]}
    assert sweep("williamson2", "rk4", **late).report_day.values.tolist() == [0.25]


def test_a_second_search_over_a_shorter_time_has_its_own_answer(tmp_path):
    sweep("williamson2", "rk4", out=tmp_path, **SEARCH | {"days": 0.25})
    found = sweep("williamson2", "rk4", out=tmp_path, **SEARCH | {"days": 0.125})
    (ranked,) = sweep_rankings(found)
    assert [*ranked.table.index] == ["rk4"] and not ranked.winners(0).empty


def test_steps_are_run_from_the_longest_to_the_shortest_in_any_order_of_the_request():
    plan = {"scene": "williamson2", "steppers": "rk4", "ne": 2, "np": 4, "days": 0.5}
    study = Study(make_plan(plan | {"dt": [600.0, 1800.0, 1200.0]}))
    assert [run.dt for run in study.setups()[0].grid()] == [1800.0, 1200.0, 600.0]


@pytest.mark.parametrize("stepper", ["semi-implicit", "forward-backward", "rk4"])
def test_the_longest_step_of_a_sweep_is_that_of_a_run(stepper):
    """It is a smaller part of the stability limit in runs of more than 20 days."""
    for days in (20, 40):
        plan = {"scene": "williamson5", "steppers": stepper, "ne": 2, "np": 4, "days": days}
        (setup,) = Study(make_plan(plan)).setups()
        run = Simulation("williamson5", stepper=stepper, ne=2, np=4, days=days)
        run.begin()
        assert setup.grid()[0].plan.wanted_dt == pytest.approx(run.plan.wanted_dt, rel=1e-6)


def test_a_reference_run_of_two_pairs_is_made_once(tmp_path, monkeypatch):
    made, make = [], runner.Runner.make

    def noting(self, spec, *more):
        made.append((spec.role, spec.dt))
        return make(self, spec, *more)

    monkeypatch.setattr(runner.Runner, "make", noting)
    monkeypatch.setattr(runner, "RESOLVED", 0.0)  # all halvings of the reference's step
    sweep("williamson6", "rk4", out=tmp_path, **SEARCH)
    steps = [dt for role, dt in made if role == "converged"]
    assert len(steps) == len({*steps}) == runner.HALVINGS + 2
