"""Studies on several processes: what one alone finds, and nothing left over whatever happens."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import jobs
import numpy as np
import pytest
from sweeps import assert_same_rows

from swe_sphere.errors import ConfigError, Interrupted, RunFailed
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, diagnostic
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.studies import cases
from swe_sphere.studies.jobs import in_processes
from swe_sphere.studies.report import write_report
from swe_sphere.studies.sweep import sweep
from swe_sphere.studies.sweep.record import runs_of
from swe_sphere.testcases import get_scene

from .support import thorough

TINY = {"ne": 2, "np": 4, "days": 0.25, "dt": [3600, 1800]}


def squares(count, tasks):
    return [*in_processes(count, partial(jobs.squaring, 2), tasks)]


def test_every_task_is_done_once():
    assert sorted(squares(2, range(5))) == [(n, n * n) for n in range(5)]
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize(
    ("deed", "kind", "said"),
    [
        ("raise", ConfigError, "no number"),
        thorough("break", RunFailed, "unexpected ValueError: what"),
        ("die", RunFailed, "killed by SIGKILL"),
        thorough("die sending", RunFailed, "killed by SIGKILL"),
    ],
)
def test_what_fails_in_one_process_ends_all(deed, kind, said):
    with pytest.raises(kind, match=said):
        squares(2, ["wait", deed])
    assert multiprocessing.active_children() == []


def test_what_is_finished_before_another_process_dies_is_kept():
    found = []
    with pytest.raises(RunFailed, match="killed by SIGKILL"):
        for result in in_processes(1, partial(jobs.squaring, 2), [*range(5), "die sending"]):
            found.append(result)
    assert sorted(found) == [(n, n * n) for n in range(5)]


def test_ctrl_c_ends_all():
    waiting = in_processes(2, partial(jobs.squaring, 2), [1, "wait", "wait"])
    next(waiting)
    os.kill(os.getpid(), signal.SIGINT)
    with pytest.raises(Interrupted):
        next(waiting)
    assert multiprocessing.active_children() == []


def test_a_parent_that_is_killed_leaves_nobody():
    with subprocess.Popen([sys.executable, jobs.__file__], stdout=subprocess.PIPE) as parent:
        pids = [int(parent.stdout.readline()) for _ in range(2)]
        parent.kill()
    for _ in range(3000):
        left = [pid for pid in pids if _lives(pid)]
        if not left:
            break
        time.sleep(0.1)
    assert left == []


@pytest.mark.thorough
def test_a_sweep_leaves_no_semaphores(tmp_path):
    asked = ["lauter", "--steppers=rk4", "--ne=2", "--days=0.1", "--dt=3600,1800", "--jobs=2"]
    program = [sys.executable, "-m", "swe_sphere", "sweep", *asked, "--out=swept"]
    ended = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "semaphore" not in ended.stderr


def _lives(pid):
    try:
        os.kill(pid, 0)
        return " Z " not in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False


@pytest.fixture
def at_once(monkeypatch):
    """Tasks are done by this process, which is quicker."""

    def done(count, begin, tasks):
        work = pickle.loads(pickle.dumps(begin))()
        for task in pickle.loads(pickle.dumps(tasks)):
            yield pickle.loads(pickle.dumps(work(task)))

    for place in ("sweep.engine", "cases.rows"):
        monkeypatch.setattr(f"swe_sphere.studies.{place}.in_processes", done)


def in_order(dataset):
    """Rows come as they are finished."""
    return dataset.isel(run=np.lexsort([dataset[n].values for n in ("dt", "stepper", "role")]))


@pytest.mark.thorough
def test_a_sweep_on_two_processes_finds_what_one_finds(tmp_path):
    """But for costs: none of them is timed."""
    alone = sweep("lauter", ["rk4", "leapfrog"], repeats=1, **TINY)
    beside = sweep("lauter", ["rk4", "leapfrog"], repeats=2, jobs=2, out=tmp_path, **TINY)
    grid = beside.isel(run=beside["role"].values == "grid")
    assert np.isnan(grid["wall"]).all() and np.isnan(grid["cpu"]).all()
    assert (grid["jobs"] == 2).all() and grid.sizes["repeat"] == 1
    page = (write_report(beside, tmp_path)).read_text()
    assert "Errors only on lauter" in page and "have errors only" in page
    once = [name for name in beside.data_vars if "repeat" not in beside[name].dims]
    assert_same_rows(
        in_order(beside[once]).drop_vars("jobs"), in_order(alone[once]).drop_vars("jobs")
    )
    made = runs_of(tmp_path).records
    sweep("lauter", ["rk4", "leapfrog"], repeats=2, jobs=2, out=tmp_path, **TINY)
    assert runs_of(tmp_path).records == made


@pytest.mark.parametrize(
    "asked",
    [
        {"target_error": 1e-3, "dt": "auto"},
        thorough({"find_limit": True, "days": 0.05, "dt": [2160]}),
    ],
)
def test_parts_of_a_sweep_are_all_of_it(asked, at_once, tmp_path):
    """Nothing is left to be made alone but what was run for the others."""
    found = sweep("lauter", ["rk4", "leapfrog"], out=tmp_path, repeats=1, jobs=2, **TINY | asked)
    assert ((found["jobs"] == 1) == (found["role"] == "converged")).all()
    alone = sweep("lauter", ["rk4", "leapfrog"], repeats=1, **TINY | asked)
    assert_same_rows(in_order(found).drop_vars("jobs"), in_order(alone).drop_vars("jobs"))


def test_what_other_processes_do_not_have_is_refused():
    class Twin(RK4):
        """As rk4."""

        name = "rk4-of-this-process"

    for scene, stepper in ((get_scene("lauter"), "rk4"), ("lauter", Twin)):
        with pytest.raises(ConfigError, match="jobs: other processes cannot import"):
            sweep(scene, stepper, jobs=2, **TINY)
    diagnostic(name="of_here")(lambda sim: 1.0)
    try:
        with pytest.raises(ConfigError, match="cannot import of_here"):
            sweep("lauter", "rk4", jobs=2, **TINY)
    finally:
        DIAGNOSTICS.pop("of_here", None)


def test_verification_is_the_same_beside_others(at_once):
    chosen = cases.choose("verification", ["lake-at-rest", "start-lauter"], quick=True)
    known = {found.fingerprint: found for found in cases.measured_beside(2, chosen)}
    assert len(known) > 1
    assert [*cases.measured_beside(2, chosen, known)] == []
    alone, beside = cases.run_cases(chosen), cases.run_cases(chosen, known.values())
    for one, other in zip(alone, beside, strict=True):
        assert one.as_dict()["quantities"] == other.as_dict()["quantities"]
        assert other.measure in known.values()


def test_cases_that_share_a_finer_run_share_a_process():
    """And all cases can be sent to it."""
    tasks = []
    chosen = cases.choose("verification")

    def note(count, begin, asked):
        tasks.extend(pickle.loads(pickle.dumps(asked)))
        return []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("swe_sphere.studies.cases.rows.in_processes", note)
        assert [*cases.measured_beside(2, chosen)] == []
    assert [case for task in tasks for case in task] == chosen
    assert all(len({case.name for case in task}) == 1 for task in tasks)
    assert len({task[0].name for task in tasks}) == len(tasks)


def test_stability_cases_are_the_same_beside_others(at_once):
    chosen = cases.choose("stability", ["rest"], ["rk4"], quick=True)
    by_name = {case.name: case for case in chosen}
    found = [*cases.measured_beside(2, chosen)]
    assert [measure.name for measure in found] == [*by_name]
    rows = [cases.Row(case, by) for case, by in zip(chosen, found, strict=True)]
    assert {row.outcome for row in rows} == {"passed"}
    timed = [case for case in cases.choose("stability") if case.is_timed]
    assert timed and all("step_seconds" in case.bounds for case in timed)
    assert [*cases.measured_beside(2, timed)] == []


@pytest.mark.parametrize("command", [["verify"], ["stress"], ["sweep", "lauter", "--steppers=rk4"]])
@pytest.mark.parametrize("count", ["0", "-1", "2000", "x"])
def test_nonsense_is_told_in_one_line(command, count, tmp_path, capsys):
    from swe_sphere.cli.main import main

    with pytest.raises(SystemExit) as ended:
        main([*command, f"--jobs={count}", f"--out={tmp_path / 'a.md'}"])
    told = capsys.readouterr().err
    assert ended.value.code == 2 and told.count("\n") == 1 and "jobs" in told


def test_other_children_of_the_session_may_die():
    """A process that is not of the pool, and that fails while tasks are done."""
    other = multiprocessing.get_context("spawn").Process(target=os._exit, args=(3,))
    other.start()
    assert sorted(squares(2, range(20))) == [(n, n * n) for n in range(20)]
    other.join()
