"""What a sweep keeps: nothing stale, one writer at a time, whole after any kill or full disk."""

import errno
import json
import os
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path

import pytest
import xarray as xr
from sweeps import assert_same_rows

from swe_sphere.cli.main import main
from swe_sphere.files.fingerprints import processor
from swe_sphere.studies.pages import MARK
from swe_sphere.studies.record_store import locked
from swe_sphere.studies.sweep import SweepWatcher, sweep
from swe_sphere.studies.sweep.record import runs_of, write_dataset
from swe_sphere.testcases import get_scene

TINY = {"ne": 2, "np": 4, "days": 0.25, "repeats": 1, "dt": [3600]}
FLAGS = ("--steppers", "rk4", "--dt", "3600", "--ne", "2", "--np", "4", "--days", "0.25",
         "--repeats", "1", "--out", "d")  # fmt: skip


class Notes(SweepWatcher):
    def __init__(self):
        super().__init__()
        self.told = []

    def note(self, text):
        self.told.append(text)


def finished(folder):
    """Key and repeat of the runs in a folder, in order."""
    return [(run.key, run.repeat) for run in runs_of(folder).records]


@pytest.fixture
def swe(capfd, tmp_path, monkeypatch):
    """Runs the program in this process, in a folder of its own: status and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["sweep", *arguments])
        return end.value.code, capfd.readouterr().err

    return call


# --- nothing stale


@pytest.fixture
def hills(tmp_path, monkeypatch):
    """A scene in TOML that builds on another file."""
    monkeypatch.chdir(tmp_path)
    Path("hills.toml").write_text('base = "base.toml"\n')
    Path("base.toml").write_text('base = "williamson2"\n[parameters]\nalpha = 0.1\n')
    return tmp_path / "d"


def test_runs_of_a_scene_whose_base_has_changed_are_made_again(hills):
    options = TINY | {"out": hills}
    sweep("hills.toml", "rk4", **options)
    old = finished(hills)
    Path("base.toml").write_text('base = "williamson2"\n[parameters]\nalpha = 0.7\n')
    notes = Notes()
    now = sweep("hills.toml", "rk4", watcher=notes, **options)
    assert notes.told == [
        f"{hills}: 3 of 3 runs there are ignored, and repeated if needed: base.toml changed since"
    ]
    assert len(finished(hills)) == 6 and set(old).isdisjoint(finished(hills)[3:])
    assert_same_rows(now, sweep("hills.toml", "rk4", watcher=notes, **options))
    assert len(notes.told) == 1 and len(finished(hills)) == 6
    assert_same_rows(now, sweep("hills.toml", "rk4", **TINY))
    assert_same_rows(write_dataset(hills), now)


def test_rows_of_other_code_are_made_again_and_never_mixed(tmp_path, monkeypatch):
    options = TINY | {"out": tmp_path}
    first = sweep("lauter", "rk4", **options)
    fields = {*(tmp_path / "converged").iterdir()}
    with monkeypatch.context() as other:
        other.setattr(
            "swe_sphere.studies.sweep.runs.fingerprints.code_fingerprint", lambda: "other"
        )
        notes = Notes()
        second = sweep("lauter", ["rk4", "kg5"], watcher=notes, **options)
        assert "3 of 3 runs there are ignored" in notes.told[0]
        assert "the code of swe_sphere changed since" in notes.told[0]
        assert second.sizes["run"] == 4 and len(finished(tmp_path)) == 7
        assert fields.isdisjoint({*(tmp_path / "converged").iterdir()} - fields)
        sources = json.loads(second.attrs["sources"])
        assert sources.pop("the processor") == processor()
        assert sources == {"the code of swe_sphere": "other", "the scene": "the package"}
    third = sweep("lauter", "rk4", **options)  # the code is again what it was first
    assert len(finished(tmp_path)) == 7
    assert_same_rows(third, first)


def test_times_of_two_machines_are_never_mixed(tmp_path, monkeypatch):
    options = TINY | {"out": tmp_path, "levels": 1}
    here = sweep("lauter", "rk4", **options)
    with monkeypatch.context() as other:
        other.setattr("swe_sphere.studies.sweep.runs.fingerprints.processor", lambda _: "an abacus")
        notes = Notes()
        there = sweep("lauter", "rk4", watcher=notes, **options)
    assert "3 of 3 runs there are ignored" in notes.told[0]
    assert "the processor changed since" in notes.told[0]
    assert there.sizes["run"] == here.sizes["run"] and len(finished(tmp_path)) == 6
    assert_same_rows(sweep("lauter", "rk4", **options), here)
    assert len(finished(tmp_path)) == 6


def test_two_scenes_of_one_name_are_never_mixed(tmp_path):
    """One of the package, one in a file, one given as an object."""
    file = tmp_path / "own.py"
    file.write_text(
        "from dataclasses import replace\n"
        "from swe_sphere.testcases import get_scene\n"
        "def scene():\n"
        "    return replace(get_scene('williamson2'), name='lauter')\n"
    )
    for scene in ("lauter", file, replace(get_scene("williamson6"), name="lauter")):
        notes = Notes()
        found = sweep(scene, "rk4", watcher=notes, out=tmp_path / "d", **TINY)
        assert [*found["role"].values] == ["converged", "converged", "grid"]
        assert len(notes.told) == (scene != "lauter")
        assert all("the scene changed since" in note for note in notes.told)


def test_another_reference_does_not_share_a_dataset_with_the_first(tmp_path):
    from importlib import resources

    data = Path(str(resources.files("swe_sphere"))) / "data"
    options = TINY | {"days": 4.0, "out": tmp_path / "d"}
    for day in (4, 6):  # that they are of another scene does not matter here
        file = tmp_path / f"{day}.nc"
        file.write_bytes((data / "galewsky_day4.nc").read_bytes() + bytes(day))
        found = sweep("lauter", "rk4", reference=file, **options)
        assert (found["role"].values == "grid").sum() == 1
    assert len(finished(tmp_path / "d")) == 6


# --- one at a time


def test_a_second_sweep_in_a_folder_is_refused(swe, tmp_path):
    with locked(tmp_path / "d"):
        status, err = swe("lauter", *FLAGS, "--quiet")
    assert status == 2 and err.count("\n") == 1 and "another process is using d" in err
    assert [*(tmp_path / "d").iterdir()] == []


def test_a_report_can_be_made_while_the_sweep_goes_on(tmp_path):
    class Reports(SweepWatcher):
        rows = ()

        def done(self):
            self.rows = (*self.rows, write_dataset(tmp_path).sizes["run"])

    watcher = Reports()
    sweep("lauter", "rk4", out=tmp_path, watcher=watcher, **TINY)
    assert watcher.rows == (3,)


def test_a_dataset_that_no_sweep_has_made_is_not_replaced(swe, tmp_path):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "sweep.nc").write_text("mine")
    status, err = swe("lauter", *FLAGS, "--quiet")
    assert status == 2 and err.count("\n") == 1 and "d/sweep.nc is not of a sweep" in err
    assert (tmp_path / "d" / "sweep.nc").read_text() == "mine"


@pytest.mark.parametrize("name", ["sweep.json", "runs/000001.json"])
def test_a_pipe_in_the_place_of_a_record_is_one_line(swe, tmp_path, name):
    (tmp_path / "d" / "runs").mkdir(parents=True)
    os.mkfifo(tmp_path / "d" / name)
    status, err = swe("lauter", *FLAGS, "--quiet")
    said = f"swe-sphere: cannot read d/{name}: it is not a file\n"
    assert (status, err) == (2, said)


# --- kills and full disks


class Disk:
    """Sees every write in two halves; tells what lies in a folder after each, or fills up."""

    def __init__(self, folder, monkeypatch):
        self._folder, self.states, self.calls, self.full_at = folder, [], 0, None
        self._write, self._replace = Path.write_bytes, os.replace
        monkeypatch.setattr(Path, "write_bytes", lambda *given: self.write(*given))
        monkeypatch.setattr(os, "replace", self.replace)

    def write(self, path, data):
        for end in (len(data) // 2, len(data)):
            self._count()
            self._write(path, data[:end])
            self._look()

    def replace(self, source, target):
        self._count()
        self._replace(source, target)
        self._look()

    def _count(self):
        self.calls += 1
        if self.calls == self.full_at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _look(self):
        files = (path for path in self._folder.rglob("*") if path.is_file())
        self.states.append({path.relative_to(self._folder): path.read_bytes() for path in files})


@pytest.mark.exhaustive
def test_a_kill_at_any_write_leaves_what_the_sweep_goes_on_from(tmp_path, monkeypatch):
    """All that lay in the folder at any moment, half-written pieces included."""
    with monkeypatch.context() as patched:
        disk = Disk(tmp_path / "d", patched)
        whole = sweep("lauter", "rk4", out=tmp_path / "d", **TINY)
    assert len(disk.states) >= 3 * 6  # of whole files: three runs, what was asked for, fields, rows
    for number, state in enumerate(disk.states):
        folder = tmp_path / str(number)
        for path, contents in state.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(contents)
        before = finished(folder)
        if (folder / "sweep.nc").exists():
            assert_same_rows(xr.load_dataset(folder / "sweep.nc"), whole)
        assert_same_rows(sweep("lauter", "rk4", out=folder, **TINY), whole)
        after = finished(folder)
        assert after[: len(before)] == before and len(set(after)) == len(after) == 3


def _write_no_report(*_, **__):
    return Path("index.html")


def assert_refused(status, err):
    assert status == 1 and err.count("\n") == 1
    assert "No space left on device" in err and "finished work is kept" in err


def test_a_full_disk_ends_a_sweep_with_one_line_and_it_goes_on_later(swe, tmp_path, monkeypatch):
    """Full a write later each time, until the disk has room for all."""
    monkeypatch.setattr(
        "swe_sphere.studies.report.write_report", lambda *_, **__: Path("index.html")
    )
    ends = []
    while not ends or ends[-1] != (0, ""):
        with monkeypatch.context() as patched:
            Disk(tmp_path / "d", patched).full_at = len(ends) + 1
            ends.append(swe("lauter", *FLAGS, "--quiet"))
        assert len(finished(tmp_path / "d")) == len(set(finished(tmp_path / "d")))
    assert 5 < len(ends) < 30
    for end in ends[:-1]:
        assert_refused(*end)
    assert_same_rows(xr.load_dataset(tmp_path / "d" / "sweep.nc"), sweep("lauter", "rk4", **TINY))


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("file", ["sweep.nc", "index.html"])
def test_a_full_disk_ends_a_report_with_one_line_and_leaves_the_old_one(
    swe, tmp_path, monkeypatch, file
):
    sweep("lauter", "rk4", out=tmp_path / "d", **TINY)
    path = tmp_path / "d" / file
    old = f"the old one {MARK}".encode()
    path.write_bytes(old)
    replace = os.replace

    def full(source, target):
        if Path(target).name == file:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    assert_refused(*swe("--report-only", "--out", "d", "--quiet"))
    assert path.read_bytes() == old
    assert not [*path.parent.rglob("*.part*")]


# --- records that are not as they should be


def test_a_report_needs_to_know_what_was_asked_for(swe, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "swe_sphere.studies.report.write_report", lambda *_, **__: Path("index.html")
    )
    sweep("lauter", "rk4", out=tmp_path / "d", **TINY)
    (tmp_path / "d" / "sweep.json").unlink()
    status, err = swe("--report-only", "--out", "d")
    assert status == 2 and err.count("\n") == 1
    assert "d: there is no sweep.json that states the request: give the command" in err
    assert swe("lauter", *FLAGS, "--quiet") == (0, "")  # the runs are known by what they are of
    assert len(finished(tmp_path / "d")) == 3


def test_a_sweep_that_has_just_begun_has_no_runs(swe, tmp_path):
    sweep("lauter", "rk4", out=tmp_path / "d", **TINY)
    for record in (tmp_path / "d" / "runs").iterdir():
        record.unlink()
    status, err = swe("--report-only", "--out", "d")
    assert (status, err) == (2, "swe-sphere: d: there are no runs in this sweep yet\n")


MISSING = object()
WRONG = [
    ("sweep", "plan", 3), ("sweep", "sources", None), ("sweep", "versions", ["1"]),
    ("sweep", "created", MISSING), ("run", "key", 5), ("run", "config", []),
    ("run", "repeat", "0"), ("run", "errors", MISSING), ("run", "config.dt", "long"),
    ("run", "numbers.wall_seconds", [1]), ("run", "status", MISSING), ("run", "status", "ended"),
    ("run", "errors.0.day", None), ("run", "errors.0.kind", "all"), ("run", "errors.0.field", None),
    ("run", "errors.0.l2", "small"), ("run", "sources", MISSING),
]  # fmt: skip


def test_records_of_the_wrong_form_are_one_line_each(swe, tmp_path):
    sweep("lauter", "rk4", out=tmp_path / "d", **TINY)
    files = {"sweep": "d/sweep.json", "run": "d/runs/000002.json"}
    for kind, path, value in WRONG:
        file = tmp_path / files[kind]
        whole = file.read_text()
        file.write_text(json.dumps(with_value(json.loads(whole), path, value)))
        for command in (("--report-only", "--out", "d"), ("lauter", *FLAGS)):
            status, err = swe(*command)
            assert status == 2 and err.count("\n") == 1, path
            assert f"{files[kind]} is not a record" in err and path in err
        file.write_text(whole)


def with_value(record, path, value):
    """The record with a value at a path put in or taken out."""
    *steps, name = (int(step) if step.isdigit() else step for step in path.split("."))
    item = reduce(getitem, steps, record)
    if value is MISSING:
        del item[name]
    else:
        item[name] = value
    return record
