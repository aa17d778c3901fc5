"""`sweep` in Python: scenes and steppers as objects, the user's own diagnostics."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from sweeps import assert_same_rows
from test_user_code import HEAD, METHODS

from swe_sphere.analysis.regrid import regrid_file
from swe_sphere.errors import ConfigError
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, diagnostic
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.studies.report.ranking import metrics, read_runs
from swe_sphere.studies.sweep import SweepWatcher, sweep
from swe_sphere.studies.sweep.record import UNITS, WORDS, runs_of
from swe_sphere.studies.sweep.runs import Study
from swe_sphere.studies.sweep.sweep_plan import make_plan
from swe_sphere.testcases import get_scene

TINY = {"ne": 2, "np": 4, "days": 0.25, "repeats": 1, "dt": [3600]}


def test_a_scene_as_an_object_gives_what_its_name_gives():
    named = sweep("williamson2", "rk4", alpha=0.3, **TINY)
    made = sweep(get_scene("williamson2", alpha=0.3), "rk4", **TINY)
    assert_same_rows(made.drop_vars("settings"), named.drop_vars("settings"))


def test_scenes_of_one_name_that_differ_in_their_start_do_not_share_runs(tmp_path):
    """Also where what differs is no parameter of theirs."""
    first = get_scene("williamson2")

    def faster(lon, lat):
        u, v, h = first.initial(lon, lat)
        return 1.01 * u, v, h

    sweep(first, "rk4", out=tmp_path, **TINY)
    before = len(runs_of(tmp_path).records)
    sweep(first, "rk4", out=tmp_path, **TINY)
    assert len(runs_of(tmp_path).records) == before == 3
    sweep(replace(first, initial=faster), "rk4", out=tmp_path, **TINY)
    assert len(runs_of(tmp_path).records) == 6


def test_a_stepper_as_a_class_gives_what_its_name_gives():
    named = sweep("lauter", ["rk4", "kg5"], **TINY)
    assert_same_rows(sweep("lauter", [RK4, STEPPERS["kg5"]], **TINY), named)
    assert_same_rows(sweep("lauter", RK4, **TINY), sweep("lauter", "rk4", **TINY))


def test_a_stepper_of_the_users_own_is_run_and_its_code_is_kept_in_mind(tmp_path):
    class Twin(RK4):
        """As rk4."""

        name = "twin-of-rk4"

    found = sweep("lauter", [RK4, Twin], out=tmp_path, **TINY)
    grid = found.isel(run=found.role.values == "grid")
    assert grid.stepper.values.tolist() == ["rk4", "twin-of-rk4"]
    assert (np.diff(grid.error.sel(kind="total"), axis=0) == 0.0).all()
    assert "the stepper twin-of-rk4" in found.attrs["sources"]
    assert "the stepper rk4" not in found.attrs["sources"]


@pytest.mark.parametrize("wrong", [int, 3, [object()]])
def test_what_is_no_stepper_is_told_in_one_line(wrong):
    with pytest.raises(ConfigError, match="steppers: must be names, files or classes") as error:
        sweep("lauter", wrong, **TINY)
    assert "\n" not in str(error.value)


def test_numbers_of_the_users_own_are_variables_of_the_dataset():
    @diagnostic(units="m s-1")
    def strongest(sim):
        return sim.snapshot.fields["u"].max()

    try:
        found = sweep("williamson2", "rk4", **TINY)
    finally:
        DIAGNOSTICS.pop("strongest", None)
    values = found["strongest"].values
    assert values.shape == (found.sizes["run"],) and np.allclose(values, 38.6, rtol=0.02)
    assert "strongest" not in sweep("williamson2", "rk4", **TINY)


def test_a_target_of_the_slow_flow_is_that_of_potential_vorticity():
    """Its error stands in the place of that of vorticity, whatever field is asked for."""
    options = TINY | {"dt": "auto", "ne": 3}
    scene = replace(get_scene("williamson6"), name="mine")
    found = sweep(scene, "rk4", target_kind="slow", target_error=1e-4, **options)
    tried = found.isel(run=found.role.values == "target")
    slow = tried.error.sel(kind="slow", field="vorticity", norm="l2").isel(report_day=-1).values
    assert slow.min() <= 1e-4


def test_a_search_for_an_error_that_no_run_has_is_refused(tmp_path):
    """A total error without a solution; slow errors are computed where a search asks for them."""
    options = TINY | {"dt": "auto", "target_error": 1e-3}
    with pytest.raises(ConfigError, match=r"^target-kind: gravity-bumps has no solution at day"):
        sweep("gravity-bumps", "rk4", target_kind="total", **options)
    half, file = 0.5 * TINY["days"], tmp_path / "half.nc"
    Simulation("williamson2", ne=2, np=4).run(days=half, out=tmp_path / "run.nc")
    regrid_file(tmp_path / "run.nc", "latlon:9x16", file)
    with pytest.raises(ConfigError, match=r"^target-kind: williamson2 has no solution at day"):
        sweep("williamson2", "rk4", target_kind="total", reference=[file],
              report_days=[half, TINY["days"]], **options)  # fmt: skip
    found = sweep("williamson2", "rk4", target_kind="slow", **options)
    assert np.isfinite(found.error.sel(kind="slow", field="vorticity", norm="l2")).any()


@pytest.mark.parametrize("method", ["amplification", "stable_dt", "spectral_radii"])
def test_a_limit_that_fails_in_a_sweep_names_the_line(method, tmp_path):
    file = tmp_path / "custom.py"
    fault = METHODS[method].format(fault="raise LookupError('lost')")
    file.write_text(HEAD.format(name=f"in-a-sweep-{method}".replace("_", "-")) + fault)
    found = sweep("williamson2", str(file), **TINY | {"dt": "auto"})
    (reason,) = {str(why) for why in found.reason.values} - {""}
    assert "LookupError: lost (custom.py, line" in reason


def test_two_references_of_one_day_are_refused(tmp_path):
    Simulation("williamson5", ne=2, np=4, dt=1800.0).run(days=0.25, out=tmp_path / "run.nc")
    files = [tmp_path / name for name in ("one.nc", "two.nc")]
    for file in files:
        regrid_file(tmp_path / "run.nc", "latlon:9x16", file)
    with pytest.raises(ConfigError, match=r"two.nc and .*one.nc are of one day"):
        sweep("williamson5", "rk4", reference=[*map(str, files)], **TINY)


RALSTON = """
from swe_sphere.steppers.runge_kutta import RungeKutta


class Ralston(RungeKutta):
    \"\"\"Third order, three stages.\"\"\"

    name, order = "ralston-of-test", 3
    a = ((1 / 2,), (0, 3 / 4))
    b = (2 / 9, 1 / 3, 4 / 9)
"""


MISTAKE = """
    def step(self):
        if self.time > 3600.0:
            raise KeyError("no such stage")
        super().step()
"""


def test_a_stepper_with_a_mistake_is_a_row_and_ends_no_sweep(tmp_path):
    (tmp_path / "ralston.py").write_text(RALSTON + MISTAKE)
    found = sweep("lauter", [tmp_path / "ralston.py", "rk4"], **TINY | {"dt": 1800})
    ends = dict(zip(found.stepper.values, found.status.values, strict=True))
    assert ends == {"ralston-of-test": "failed", "rk4": "completed"}
    (failed,) = found.reason.values[found.stepper.values == "ralston-of-test"]
    assert failed == "ralston.py fails: KeyError: 'no such stage' (ralston.py, line 14)"


def test_an_edited_file_of_a_stepper_has_its_own_runs_made_again_and_no_others(tmp_path):
    file, options = tmp_path / "ralston.py", TINY | {"out": tmp_path / "d"}
    file.write_text(RALSTON)
    first = sweep("lauter", ["rk4", file], **options)
    assert "ralston-of-test" in first.stepper.values
    file.write_text(RALSTON + "\n# edited\n")
    second = sweep("lauter", ["rk4", file], **options)
    assert len(runs_of(tmp_path / "d").records) == first.sizes["run"] + 1
    assert_same_rows(second, first)
    file.write_text(RALSTON)  # as it was
    sweep("lauter", ["rk4", str(file)], **options)
    assert len(runs_of(tmp_path / "d").records) == first.sizes["run"] + 1
    sweep("lauter", "rk4", **options)
    assert len(runs_of(tmp_path / "d").records) == first.sizes["run"] + 1


def test_steps_that_come_to_the_same_are_one_run():
    """As they are shortened to meet the end."""
    expected = []
    watcher = SweepWatcher()
    watcher.expect = expected.append
    found = sweep("lauter", "rk4", watcher=watcher, **TINY | {"dt": [3700, 3600, 1800]})
    grid = found.isel(run=found.role.values == "grid")
    assert grid.dt.values.tolist() == [3600.0, 1800.0] and sum(expected) == 2


@pytest.mark.parametrize("names", [("ark2", "ars343"), ("ars343", "ark2")])
def test_stability_limits_do_not_depend_on_the_order_of_steppers(names):
    """Winds faster than a third of the waves shorten the limit of ars343 only."""
    depth = {"scene": "williamson6", "ne": 2, "np": 4, "settings": ["scene.depth=6000"]}
    (space,) = Study(make_plan(depth | {"steppers": names})).spaces()
    for name in names:
        alone = Simulation("williamson6", stepper=name, ne=2, np=4, parameters={"depth": 6000})
        assert space.stable_dt(STEPPERS[name]) == pytest.approx(alone.stable_dt())


def test_another_name_of_a_stepper_is_the_same_stepper():
    found = sweep("williamson2", ["fully-implicit", "tr-bdf2"], **TINY)
    assert set(found.stepper.values) == {"rk4", "tr-bdf2"} and found.sizes["run"] == 3


def test_tracers_take_the_requested_steps_together():
    """Also where the run would have an odd number of steps."""
    options = TINY | {"days": 0.35, "dt": [1800], "tracer_steps": 2}
    found = sweep("deformational", "rk4", **options)
    assert (found.status == "completed").all() and (found.steps % 2 == 0).all()
    assert np.isfinite(found.attrs["converged_check"])


def test_options_without_a_column_are_among_the_settings(tmp_path):
    """Otherwise runs of one folder could not be distinguished."""
    for alpha in (None, 0.7):
        found = sweep("williamson2", "rk4", out=tmp_path, alpha=alpha, **TINY)
    assert {*found.settings.values} == {"", "alpha=0.7"}
    options = {"tracer_steps": 2, "launch": "node"}
    one = sweep("deformational", "rk4", settings=["scene.case=3"], **TINY | options)
    assert {*one.settings.values} == {"scene.case=3 launch=node tracer-steps=2"}


def test_settings_are_texts_or_tables():
    table = make_plan({"scene": "galewsky", "steppers": "rk4", "settings": {"viscosity.nu": 1e5}})
    text = make_plan({"scene": "galewsky", "steppers": "rk4", "settings": ["viscosity.nu=1e5"]})
    configs = (plan.run_config().settings_of("viscosity") for plan in (table, text))
    assert [float(found["nu"]) for found in configs] == [1e5, 1e5]


def test_steps_that_tracers_take_together_do_not_change_the_limit_of_the_flow():
    options = TINY | {"dt": [7200], "find_limit": True}
    found = [sweep("deformational", "rk4", tracer_steps=n, **options) for n in (1, 3)]
    stable = [each.dt.values[(each.role == "stability") & (each.status == "completed")].max()
              for each in found]  # fmt: skip
    trials = found[1].isel(run=found[1].role.values == "stability")
    assert not any("no multiple" in reason for reason in trials.reason.values)
    assert stable[1] <= stable[0]


def test_a_shorter_sweep_in_a_folder_is_answered_for_its_own_days(tmp_path):
    for days in (0.25, 0.125):
        found = sweep("williamson2", "rk4", out=tmp_path, **TINY | {"days": days})
    assert {of.day for of in metrics(read_runs(found))} == {0.125}


def test_a_length_of_many_digits_has_equal_steps():
    """It stands for itself, and not for a nearby part of an hour."""
    found = sweep("williamson2", "rk4", **TINY | {"days": 0.1157408, "dt": [2500]})
    assert (found.dt * found.steps).values == pytest.approx(0.1157408 * 86400.0, rel=1e-6)


def test_arrays_and_ranges_are_lists():
    steps = np.array([3600.0, 1800.0])
    found = sweep("williamson2", "rk4", **TINY | {"dt": steps, "ne": range(2, 4)})
    grid = found.isel(run=found.role.values == "grid")
    assert sorted(grid.dt.values) == [1800.0, 1800.0, 3600.0, 3600.0]
    assert sorted(grid.ne.values) == [2, 2, 3, 3]


def test_a_dataset_of_another_kind_has_no_figure():
    with pytest.raises(ConfigError, match="not one of a sweep"):
        xr.Dataset().sweep.plot_cost()


def test_no_diagnostic_takes_a_name_that_sweeps_have():
    found = sweep("williamson2", ["rk4"], ne=2, np=4, days=0.05, dt=2160.0, repeats=1)
    for name in {*found.variables, *found.dims, *WORDS, *UNITS, "key", "repeat"}:
        with pytest.raises(ConfigError, match="needs another name"):
            diagnostic(name=name)(lambda sim: 0.0)


def test_an_error_that_passes_is_not_stored(tmp_path):
    """Of memory for example: the next sweep into the folder makes the run."""

    class Passing(RK4):
        name, fails = "passing", True

        def __init__(self, model, dt):
            super().__init__(model, dt)
            if self.fails:
                raise MemoryError("3 GB")

    def status():
        found = sweep("williamson2", [Passing], out=tmp_path, **TINY)
        return set(found["status"].values.ravel().tolist())

    with pytest.raises(MemoryError):
        status()
    Passing.fails = False
    assert status() == {"completed"}


def test_a_sweep_contains_the_stability_limit_of_each_stepper():
    found = sweep("williamson2", ["rk4", "ssprk3", "bdf2"], **TINY)
    for stepper in ("rk4", "ssprk3"):
        of = found.stable_dt.values[found.stepper.values == stepper]
        sim = Simulation("williamson2", ne=2, np=4, days=0.25, stepper=stepper)
        assert of == pytest.approx(sim.stable_dt(), rel=1e-12)
    assert np.isnan(found.stable_dt.values[found.stepper.values == "bdf2"]).all()
    numbers = [n for n, values in found.data_vars.items() if values.dtype.kind == "f"]
    empty = [n for n in numbers if not np.isfinite(found[n].values).any()]
    assert empty == ["spread"]  # of repeats
