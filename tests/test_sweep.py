"""Sweeps as they run: rows, errors, failures, interruption, searches."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from sweeps import assert_same_rows

from swe_sphere.errors import ConfigError
from swe_sphere.mesh import partition
from swe_sphere.simulation.diagnostics import slow_errors
from swe_sphere.studies.sweep import SweepWatcher, engine, runner, sweep
from swe_sphere.studies.sweep.record import runs_of, write_dataset
from swe_sphere.studies.sweep.runs import Study
from swe_sphere.studies.sweep.sweep_plan import make_plan

TINY = {"ne": 2, "np": 4, "days": 0.5, "repeats": 1}


def rows(dataset, **wanted):
    """The rows with these values, as a dataset."""
    mask = np.ones(dataset.sizes["run"], dtype=bool)
    for name, value in wanted.items():
        mask &= dataset[name].values == value
    return dataset.isel(run=mask)


def contents(folder):
    """All files below a folder by name, but the dataset, which tells when it was made."""
    files = (path for path in folder.rglob("*.*") if path.is_file() and path.name != "sweep.nc")
    return {path.relative_to(folder): path.read_bytes() for path in files}


def last(dataset, kind, field="h", norm="l2"):
    """Errors at the end."""
    return dataset["error"].sel(kind=kind, field=field, norm=norm).isel(report_day=-1).values


@pytest.fixture(scope="module")
def lauter(tmp_path_factory):
    """A small grid on the exact unsteady flow, in a folder."""
    folder = tmp_path_factory.mktemp("lauter")
    options = TINY | {"levels": 3, "repeats": 2, "report_days": 0.25}
    return sweep("lauter", ["rk4", "tr-bdf2"], out=folder, **options), folder


# --- rows


def test_every_run_is_a_row_with_its_settings_and_costs(lauter):
    dataset, folder = lauter
    grid = rows(dataset, role="grid")
    assert grid.sizes["run"] == 6
    assert set(grid["stepper"].values) == {"rk4", "tr-bdf2"}
    assert (grid["status"] == "completed").all() and (grid["reason"] == "").all()
    assert (grid["steps"] * grid["dt"] == 0.5 * 86400.0).all()
    assert (
        rows(grid, stepper="rk4")["rhs_evaluations"] == 4 * rows(grid, stepper="rk4")["steps"]
    ).all()
    implicit = rows(grid, stepper="tr-bdf2")
    assert (implicit["preconditioner"] == "helmholtz").all()
    for name in ("newton_iterations", "krylov_iterations", "tangent_evaluations"):
        assert (implicit[name] >= implicit["steps"]).all()
    assert (np.abs(grid["mass_drift"]) < 1e-13).all()
    assert (
        grid.sizes["repeat"] >= 2
        and (grid[["wall", "cpu"]].isel(repeat=[0, 1]) > 0.0).to_array().all()
    )
    assert (grid["total_seconds"] > grid["wall"].isel(repeat=0)).all()
    assert dataset["angular_momentum_drift"].attrs["units"] == "1"
    assert dataset.attrs["scene"] == "lauter"
    assert json.loads(dataset.attrs["plan"])["steppers"] == ["rk4", "tr-bdf2"]
    xr.testing.assert_identical(xr.load_dataset(folder / "sweep.nc"), dataset)


def test_runs_are_interleaved(lauter):
    """All settings once, then all again; and in a round one stepper after the other."""
    runs = runs_of(lauter[1]).records[2:]
    assert [run.repeat for run in runs[:12]] == 6 * [0] + 6 * [1]
    assert [run.config.stepper for run in runs[:12]] == 6 * ["rk4", "tr-bdf2"]
    assert all(run.repeat > 1 for run in runs[12:])


def test_the_time_of_a_run_is_the_shortest_of_its_repeats(lauter):
    grid = rows(lauter[0], role="grid")
    for clock in ("wall", "cpu"):
        assert np.array_equal(grid[f"{clock}_seconds"], grid[clock].min("repeat"))
    first, second = np.sort(grid["cpu"].values, axis=1)[:, :2].T
    assert np.allclose(grid["spread"], second / first - 1.0)


@pytest.mark.parametrize(("agree", "runs"), [(np.inf, 3), (0.03, 4), (0.0, 9)])
def test_runs_are_repeated_until_their_two_shortest_times_agree(monkeypatch, agree, runs):
    """Three times at least, three times as often at most."""
    times = iter([2.0, 1.0, 1.1, 1.02, 1.5, 1.4, 1.3, 1.2, 1.1])

    def timed(spec, *others):
        ended, fields = run_timed(spec, *others)
        ended.numbers.update({"cpu_seconds": next(times)} if spec.dt == 3600.0 else {})
        return ended, fields

    run_timed = runner.run_timed
    monkeypatch.setattr(runner, "run_timed", timed)
    monkeypatch.setattr(engine, "REPEATABLE", agree)
    dataset = sweep("lauter", "rk4", dt=3600, **TINY | {"repeats": 3})
    (grid,) = rows(dataset, role="grid")["cpu"].values
    assert len(grid) == runs


def test_a_repeat_that_was_cut_short_is_not_the_time_of_the_run(tmp_path):
    """Nor does it count as one of the repeats that are wanted."""
    options = TINY | {"dt": 3600, "repeats": 2, "out": tmp_path}
    sweep("lauter", "rk4", **options)
    path = next(p for p in tmp_path.glob("runs/*.json") if json.loads(p.read_text())["repeat"] == 1)
    kept = json.loads(path.read_text())
    kept["numbers"] |= {"cpu_seconds": 1e-9, "wall_seconds": 1e-9}
    path.write_text(json.dumps(kept | {"status": "unstable", "reason": "cut short"}))
    (cut,) = rows(write_dataset(tmp_path), role="grid")["cpu"].values
    assert np.isnan(cut[1]) and np.isfinite(cut[0])
    found = rows(sweep("lauter", "rk4", **options), role="grid")
    assert found["cpu_seconds"].item() > 1e-9 and found["spread"].item() < 1e3
    assert np.isfinite(found["cpu"].values).sum() >= 2


def test_a_repeat_whose_record_is_gone_is_measured_again(tmp_path):
    options = TINY | {"dt": 3600, "out": tmp_path}
    sweep("lauter", "rk4", **options | {"repeats": 3})
    for path in tmp_path.glob("runs/*.json"):
        if json.loads(path.read_text())["repeat"] == 1:
            path.unlink()
    found = rows(sweep("lauter", "rk4", **options | {"repeats": 4}), role="grid")
    assert np.isfinite(found["cpu"].values).sum() >= 4


def test_runs_that_were_not_timed_are_timed_by_a_sweep_that_times(tmp_path):
    """Their errors are kept."""
    options = TINY | {"dt": 3600, "out": tmp_path}
    sweep("lauter", "rk4", **options)
    record = sorted(tmp_path.glob("runs/*.json"))[-1]
    kept = json.loads(record.read_text())
    kept["numbers"] |= dict.fromkeys(runner.TIMES)
    record.write_text(json.dumps(kept | {"jobs": 2}))
    assert np.isnan(rows(write_dataset(tmp_path), role="grid")["cpu_seconds"].item())
    timed = rows(sweep("lauter", "rk4", **options), role="grid")
    assert timed["cpu_seconds"].item() > 0.0 and last(timed, "time").item() > 0.0
    assert len(_finished(tmp_path)) == 4


def test_limits_are_marked(lauter):
    grid = rows(lauter[0], role="grid")
    gravity, advective = grid["gravity_limit"].values, grid["advective_limit"].values
    assert np.ptp(gravity) == 0.0 and (advective > 2.0 * gravity).all()
    rk4 = rows(grid, stepper="rk4")["dt"].values
    assert rk4.max() == pytest.approx(0.85 * 2.83 * gravity[0], rel=0.2)


def test_time_errors_fall_with_the_order_of_the_scheme(lauter):
    grid = rows(lauter[0], role="grid")
    for stepper, order in (("rk4", 4.0), ("tr-bdf2", 2.0)):
        mine = rows(grid, stepper=stepper)
        dt, error = np.log(mine["dt"].values), np.log(last(mine, "time", "v"))
        slope = np.diff(error) / np.diff(dt)
        assert abs(slope[-1] - order) < 0.5, stepper


def test_the_converged_run_tells_its_own_error(lauter):
    """By Richardson's rule: a sixteenth of that of twice the step, and far below all others."""
    dataset = lauter[0]
    twice, fine = (rows(dataset, role="converged").isel(run=i) for i in (0, 1))
    assert twice["dt"].item() == 2.0 * fine["dt"].item()
    ratio = last(twice, "time") / last(fine, "time")
    assert ratio == pytest.approx(16.0)
    again = sweep("lauter", "rk4", **TINY, report_days=0.25, dt=twice["dt"].item())
    apart = last(rows(again, role="grid"), "time")
    assert last(twice, "time") - last(fine, "time") == pytest.approx(apart.item())
    assert dataset.attrs["converged_check"] == last(fine, "time")
    assert dataset.attrs["converged_dt"] == fine["dt"].item()
    assert last(fine, "time") < 0.5 * last(rows(dataset, role="grid"), "time").min()


def test_total_errors_are_those_of_a_plain_run(lauter):
    from swe_sphere.simulation.config import make_config
    from swe_sphere.simulation.simulation import run_scene

    row = rows(lauter[0], role="grid", stepper="tr-bdf2").isel(run=1)
    config = {"scene": "lauter", "ne": 2, "np": 4, "days": 0.5, "stepper": "tr-bdf2"}
    plain = run_scene(make_config(config | {"dt": row["dt"].item(), "every": 6}))
    for field in ("h", "v"):
        for norm in ("l1", "l2", "linf"):
            assert last(row, "total", field, norm) == pytest.approx(plain[f"{norm}_{field}"])
    assert row["krylov_iterations"] == plain["krylov_iterations"]
    assert row["energy_drift"] == plain["energy_drift"]


def test_errors_are_taken_at_every_report_time(lauter):
    dataset = lauter[0]
    assert dataset["report_day"].values.tolist() == [0.25, 0.5]
    error = rows(dataset, role="grid")["error"].sel(kind=["time", "total"])
    assert np.isfinite(error).all()
    assert not np.isfinite(dataset["error"].sel(kind="slow")).any()


def test_errors_in_float32_are_against_the_run_in_float64():
    dataset = sweep("williamson6", "rk4", levels=2, precision="float64,float32", **TINY)
    grid = rows(dataset, role="grid")
    slow = last(grid, "slow", "vorticity")
    assert ((slow > 0.0) & (slow < 0.01)).all()
    single, double = (last(rows(grid, precision=p), "time") for p in ("float32", "float64"))
    assert np.allclose(single, double, rtol=0.05) and (single != double).all()


def test_references_of_the_package_are_found():
    options = {"ne": 2, "np": 4, "days": 5.0, "repeats": 1, "levels": 1}
    dataset = sweep("williamson5", "rk4", **options)
    assert (rows(dataset, role="converged")["ne"] == 2.0).all()
    error = rows(dataset, role="grid")["error"].sel(kind="total", norm="l2").values.ravel()
    assert 1e-3 < error[0] < 1e-2 and 0.0 < error[1] < 0.3 and 0.0 < error[2] < 1.0
    other = options | {"days": 0.5, "report_days": 0.25, "settings": "viscosity.nu=1e5"}
    none = sweep("williamson5", "rk4", **other)
    assert not np.isfinite(none["error"].sel(kind="total")).any()


def test_slow_errors_do_not_see_the_waves_of_the_start():
    """Depth is off by the waves however short the step; potential vorticity converges."""
    options = {"ne": 6, "np": 4, "days": 2.0, "repeats": 1, "dt": [7200, 3600]}
    grid = rows(sweep("williamson5", "tr-bdf2", **options), role="grid")
    depth, slow = last(grid, "time"), last(grid, "slow", "vorticity")
    assert depth[1] > 0.8 * depth[0] and slow[1] < 0.65 * slow[0]


def test_potential_vorticity_is_that_of_columns_at_the_mean_depth():
    """It does not see columns that are stretched, and is as large as vorticity is."""
    plan = make_plan({"scene": "williamson6", "steppers": "rk4", "ne": 2, "np": 4})
    space = Study(plan).spaces()[0]
    start, coriolis = space.sim.initial_fields, space.sim.initial_fields["f"]
    mean = np.average(start["h"], weights=space.mesh.area)
    level = {"h": np.full_like(start["h"], mean), "vorticity": start["vorticity"]}
    stretched = {
        "h": start["h"],
        "vorticity": (level["vorticity"] + coriolis) * start["h"] / mean - coriolis,
    }
    assert slow_errors(space.sim.model, stretched, level)["vorticity"]["l2"] < 1e-14
    more = level | {"vorticity": 1.1 * level["vorticity"]}
    assert slow_errors(space.sim.model, more, level)["vorticity"]["linf"] == pytest.approx(0.1)


# --- failures


@pytest.mark.thorough
def test_failures_are_rows_that_say_why(monkeypatch):
    """Unstable, timed out, a Newton solve that fails, and what cannot be run at all."""
    monkeypatch.setattr("swe_sphere.steppers.implicit.NEWTON_ITERATIONS", 1)
    dataset = sweep(
        "williamson6", ["rk4", "tr-bdf2"], ne=2, np=4, days=10, dt=[21600, 5, 2e6], repeats=2,
        time_limit=1.5, tolerance=1e-9,
    )  # fmt: skip
    found = {
        (row["stepper"].item(), row["dt"].item()): (row["status"].item(), row["reason"].item())
        for row in (dataset.isel(run=i) for i in range(dataset.sizes["run"]))
    }
    status, reason = found["rk4", 21600.0]
    assert status == "unstable" and "at day" in reason and "dt = 21600 s" in reason
    status, reason = found["rk4", 5.0]
    assert status == "timed-out" and reason.startswith("the time limit of 1.5 s was reached at day")
    status, reason = found["tr-bdf2", 21600.0]
    assert status == "solver-failed" and "cannot be solved even in" in reason
    status, reason = found["tr-bdf2", 2e6]
    assert status == "refused" and "longer than the whole run" in reason
    failed = dataset.isel(run=dataset["status"].values != "completed")
    assert not np.isfinite(failed["error"]).any()
    assert failed.sizes["repeat"] == 1  # what failed once is not timed again


def test_a_stepper_that_does_not_suit_the_scene_is_refused_in_words():
    dataset = sweep("williamson1", ["semi-implicit", "rk4"], levels=1, **TINY)
    refused = rows(dataset, stepper="semi-implicit")
    assert refused["status"].values.tolist() == ["refused"]
    assert "no gravity waves" in refused["reason"].item()
    assert rows(dataset, stepper="rk4", role="grid")["status"].item() == "completed"


def test_a_run_that_ran_out_of_time_is_tried_again_with_more(tmp_path):
    options = TINY | {"dt": 10, "out": tmp_path}
    first = sweep("williamson2", "rk4", time_limit=0.02, **options)
    assert rows(first, role="grid")["status"].item() == "timed-out"
    before = contents(tmp_path / "runs")
    sweep("williamson2", "rk4", time_limit=0.01, **options)
    assert contents(tmp_path / "runs") == before
    more = sweep("williamson2", "rk4", time_limit=100, **options)
    assert rows(more, role="grid")["status"].item() == "completed"


# --- going on


class Stop(SweepWatcher):
    """Presses Ctrl-C in the middle of the n-th run that is begun."""

    def __init__(self, runs):
        super().__init__()
        self.left = runs

    def begin(self, case):
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)


GRID = {"ne": 2, "np": 4, "days": 0.25, "levels": 3, "repeats": 2}


@pytest.mark.parametrize("runs", [1, 2, 5, 12])
@pytest.mark.thorough
def test_a_sweep_that_was_stopped_ends_like_one_that_was_not(tmp_path, runs, lauter_whole):
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        sweep("lauter", ["rk4", "bdf2"], out=tmp_path, watcher=Stop(runs), **GRID)
    assert signal.getsignal(signal.SIGINT) is handler
    before = _finished(tmp_path)
    assert len(before) == max(0, runs - 1 if runs > 2 else 0)
    assert (tmp_path / "sweep.nc").exists() == bool(before)
    again = sweep("lauter", ["rk4", "bdf2"], out=tmp_path, **GRID)
    after = _finished(tmp_path)
    assert after[: len(before)] == before and len(set(after)) == len(after)
    assert_same_rows(again, lauter_whole)


@pytest.fixture(scope="module")
def lauter_whole():
    return sweep("lauter", ["rk4", "bdf2"], **GRID)


def _finished(folder):
    """Key and repeat of the runs in a folder, in order."""
    return [(run.key, run.repeat) for run in runs_of(folder).records]


DRIVER = """
import sys
from swe_sphere.studies.sweep import sweep
sweep("lauter", ["rk4", "bdf2"], out=sys.argv[1], ne=2, np=4, days=0.25, levels=3, repeats=2)
"""


@pytest.mark.exhaustive
def test_nothing_is_lost_by_kills_at_random_moments(tmp_path, lauter_whole):
    """SIGKILL at any point, while a file is written too; finished runs stay as they are."""
    seed = random.randrange(10**6)
    moments = random.Random(seed)
    known = []
    for _ in range(4):
        _kill_at(tmp_path, len(known) + moments.randint(0, 4), moments.random() * 0.1)
        finished = _finished(tmp_path)
        assert finished[: len(known)] == known, seed
        known = finished
    again = sweep("lauter", ["rk4", "bdf2"], out=tmp_path, **GRID)
    finished = _finished(tmp_path)
    assert finished[: len(known)] == known and len(set(finished)) == len(finished), seed
    assert_same_rows(again, lauter_whole)


def _kill_at(folder, runs, delay):
    """Start the sweep and kill it some time after it has got so far."""
    process = subprocess.Popen([sys.executable, "-c", DRIVER, folder], cwd=folder)
    end = time.monotonic() + 300.0
    while process.poll() is None and time.monotonic() < end:
        if len([*folder.glob("runs/*.json")]) >= runs:
            break
        time.sleep(0.005)
    time.sleep(delay)
    process.kill()
    process.wait()


def test_what_is_there_is_not_made_again_and_more_is_added(tmp_path):
    sweep("lauter", "rk4", out=tmp_path, levels=2, **TINY)
    before = contents(tmp_path)
    sweep("lauter", "rk4", out=tmp_path, levels=2, **TINY)
    assert contents(tmp_path) == before
    more = sweep("lauter", ["rk4", "kg5"], out=tmp_path, levels=2, **TINY)
    runs = {path: whole for path, whole in before.items() if path.parent.name == "runs"}
    assert runs and contents(tmp_path).items() > runs.items()
    assert rows(more, role="grid").sizes["run"] == 4
    assert rows(more, role="converged").sizes["run"] == 2
    sweep("lauter", "bdf2", out=tmp_path, **TINY | {"dt": 7200})
    for name, value in (("tolerance", 1e-5), ("days", 0.25), ("alpha", 0.1)):
        count = len(_finished(tmp_path))
        sweep("lauter", "bdf2", out=tmp_path, **TINY | {"dt": 7200, name: value})
        assert len(_finished(tmp_path)) > count, name


def test_a_folder_of_another_scene_is_refused(tmp_path):
    sweep("lauter", "rk4", out=tmp_path, levels=1, **TINY)
    with pytest.raises(ConfigError, match="holds a sweep of lauter, not of williamson2"):
        sweep("williamson2", "rk4", out=tmp_path, levels=1, **TINY)


def test_fields_of_the_converged_run_that_are_gone_are_made_again(tmp_path):
    first = sweep("lauter", "rk4", out=tmp_path, levels=1, **TINY)
    for file in (tmp_path / "converged").iterdir():
        file.write_bytes(b"damaged")
    more = sweep("lauter", "rk4", out=tmp_path, levels=2, **TINY)
    assert_same_rows(more.isel(run=slice(0, 3)), first)
    assert np.isfinite(last(more, "time")).all()


def test_the_dataset_can_be_made_again_from_the_records(lauter):
    dataset, folder = lauter
    (folder / "sweep.nc").unlink()
    xr.testing.assert_identical(write_dataset(folder), dataset)
    with pytest.raises(ConfigError, match="there are no runs"):
        write_dataset(Path(folder / "converged"))


# --- searches


@pytest.mark.thorough
def test_the_longest_stable_step_is_that_of_theory():
    explicit, implicit = (
        rows(
            sweep("williamson2", name, find_limit=True, levels=1, **TINY | {"days": days}),
            role="stability",
        )
        for name, days in (("rk4", 0.5), ("bdf2", 1.0))
    )
    done = explicit["status"].values == "completed"
    best, worst = explicit["dt"].values[done].max(), explicit["dt"].values[~done].min()
    assert best < worst <= 1.02 * best
    assert best / explicit["gravity_limit"].values[0] == pytest.approx(2.83, rel=0.03)
    assert explicit["steps"].values[done].min() >= 100
    assert implicit.sizes["run"] > 1 and (implicit["status"] == "completed").all()


def with_noise(share, **mesh):
    """How a run ends that is repeated with noise, with a part of the stable step."""
    study = Study(make_plan({"scene": "williamson2", "steppers": "rk4", "ne": 2, "np": 4} | mesh))
    (setup,) = study.setups()
    spec = setup.spec(share * setup.stable_dt, "stability")
    spec = replace(spec, plan=replace(spec.plan, steps=32))
    sim = setup.space.simulation(spec.config)
    sim.begin(spec.plan)
    assert sim.run_plan().completed
    return runner.perturbed(spec, sim, None, None)


def test_a_step_with_which_noise_grows_is_unstable():
    """Also where the run itself gets to its end; noise of a stable one does not grow."""
    assert with_noise(0.9).status == "completed"
    ended = with_noise(1.04)
    assert ended.status == "unstable" and "noise has grown" in ended.reason


def test_the_growth_of_noise_is_the_same_in_any_order_of_the_nodes(monkeypatch):
    found = set()
    for least in (0, 10**9):
        monkeypatch.setattr(partition, "RINGED", least)
        found.add(with_noise(1.04, ne=3).reason)
    assert len(found) == 1 and "noise has grown" in found.pop()


@pytest.mark.thorough
def test_a_search_finds_the_longest_step_that_is_good_enough():
    target = 1e-4
    dataset = sweep("lauter", ["rk4", "esdirk4"], target_error=target, target_kind="time",
                    ne=2, np=4, days=0.5, repeats=2)  # fmt: skip
    tried = rows(dataset, role="target")
    for name in ("rk4", "esdirk4"):
        mine = rows(tried, stepper=name)
        good = last(mine, "time") <= target
        longest, shortest = mine["dt"].values[good].max(), mine["dt"].values[~good].min(initial=1e9)
        # steps meet the end, which leaves gaps between the longest of them
        assert longest < shortest and (good.all() or shortest <= 1.25 * longest)
        timed = np.isfinite(mine["wall"].isel(repeat=1).values)
        assert timed[good].any() and not timed[~good].any()


def test_a_search_says_when_there_is_no_such_step():
    notes = []
    watcher = SweepWatcher()
    watcher.note = notes.append
    dataset = sweep("lauter", "rk4", target_error=1e-9, watcher=watcher, **TINY)
    assert "the error stays at" in notes[0]
    errors = last(rows(dataset, role="target"), "total")
    assert np.isfinite(errors).all() and (errors > 1e-9).all()


def test_a_search_is_for_the_total_error_where_it_is_known():
    """Steps with a small enough error in time alone do not count."""
    notes = []
    watcher = SweepWatcher()
    watcher.note = notes.append
    dataset = sweep("lauter", "rk4", target_error=1e-5, watcher=watcher, **TINY)
    tried = rows(dataset, role="target")
    assert (last(tried, "time") <= 1e-5).any() and (last(tried, "total") > 1e-5).all()
    assert "the error stays at" in notes[0]
