"""The logger `swe_sphere`: lines about a run, on stderr, in a file and for other handlers."""

import logging
import re
from pathlib import Path

import pytest

from swe_sphere import Simulation
from swe_sphere.simulation.observers import LogLines

SMALL = "run", "williamson6", "--ne", 2, "--np", 4, "--days", 0.25
STAMP = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} "


def lines(path):
    """Return the levels and texts of the lines in a file, which must all have a time."""
    found = []
    for line in path.read_text().splitlines():
        stamp, level, text = re.fullmatch(rf"({STAMP})([A-Z]+) (.*)", line).groups()
        assert stamp
        found.append((level, text))
    return found


def test_a_file_has_all_lines_of_a_run(swe, tmp_path, monkeypatch):
    monkeypatch.setattr(LogLines, "PATIENCE", 0.0)
    status, _, err = swe(
        *SMALL, "--dt", 3600, "--log", "run.log", "--set", "edge-penalty.c=default"
    )
    assert status == 0
    told = lines(tmp_path / "run.log")
    about = "Simulation('williamson6', ne=2, np=4, stepper='rk4': day "
    assert told[0] == ("DEBUG", f"{about}0 of 0.25 days) begins: 6 steps of 3600 s")
    assert told[-1] == ("DEBUG", f"{about}0.25 of 0.25 days) ends: completed")
    progress = [text for level, text in told if level == "INFO"]
    assert progress
    assert all(text.startswith("day 0.") and text.endswith(" s to go") for text in progress)
    assert [f"swe-sphere: {text}" for text in progress] == err.splitlines()


def test_warnings_and_failures_stand_in_the_file_of_a_quiet_run(swe, tmp_path):
    status, out, err = swe(*SMALL, "--dt", 10800, "--every", 3, "--log", "run.log", "--quiet")
    assert (status, out) == (1, "")
    levels = {}
    for level, text in lines(tmp_path / "run.log"):
        levels.setdefault(level, []).append(text)
    assert "times the stability limit of rk4" in levels["WARNING"][0]
    assert [f"swe-sphere: {text}" for text in levels["ERROR"]] == err.splitlines()


def test_lines_of_a_later_run_follow(swe, tmp_path):
    for _ in range(2):
        swe(*SMALL, "--log", "run.log")
    assert [text.rsplit(") ")[-1] for _, text in lines(tmp_path / "run.log")][1::2] == [
        "ends: completed", "ends: completed"
    ]  # fmt: skip


def test_a_refused_run_stands_in_the_file(swe, tmp_path):
    status, _, err = swe(*SMALL, "--set", "viscosity.mu=1", "--log", "run.log")
    assert status == 2
    assert lines(tmp_path / "run.log") == [
        ("DEBUG", f"failed: {err.removeprefix('swe-sphere: ')[:-1]}")
    ]


def test_a_log_that_cannot_be_written_is_one_line(swe):
    status, out, err = swe(*SMALL, "--log", "none/run.log")
    message = "swe-sphere: log: there is no folder none: make it first\n"
    assert (status, out, err) == (2, "", message)


def test_python_finds_the_lines_by_its_logger(caplog):
    sim = Simulation("williamson6", ne=2, np=4, dt=10800, every=3)
    with caplog.at_level(logging.DEBUG, "swe_sphere"), pytest.warns(UserWarning, match="limit"):
        sim.run(days=0.25)
    kinds = [record.levelname for record in caplog.records]
    assert kinds == ["WARNING", "DEBUG", "DEBUG"]
    assert "ends: " in caplog.records[-1].getMessage()


def test_python_prints_no_line_twice(capfd):
    with pytest.warns(UserWarning, match="limit"):
        Simulation("williamson6", ne=2, np=4, dt=10800, every=3).run(days=0.25)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("data.nc", "log: data.nc exists and is not a log: choose another name"),
        ("run.nc", "log: run.nc would be written twice: choose another name"),
        (
            "run.nc.restart",
            "log: run.nc.restart would be written twice: choose another name",
        ),
        ("", "log: . is a folder: give the name of a file in it"),
    ],
)
def test_a_log_is_never_written_into_another_file(swe, tmp_path, file, message):
    (tmp_path / "data.nc").write_bytes(b"CDF\x02 data")
    status, out, err = swe(*SMALL, "--out", "run.nc", "--log", file)
    assert (status, out, err) == (2, "", f"swe-sphere: {message}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["data.nc"]
    assert (tmp_path / "data.nc").read_bytes() == b"CDF\x02 data"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk_loses_lines_and_not_the_run(swe, tmp_path):
    assert swe(*SMALL, "--out", "run.nc", "--log", "/dev/full", "--quiet") == (0, "", "")


def test_the_command_that_resumes_stands_in_the_log_and_keeps_it(swe, tmp_path):
    where = "--out", "run.nc", "--log", "run.log"
    status, _, err = swe(*SMALL, "--dt", 60, "--time-limit", 0.001, *where, "--json")
    assert status == 1 and "resume with" not in err
    level, text = next(line for line in lines(tmp_path / "run.log") if "resume" in line[1])
    assert level == "DEBUG" and text.startswith("resume with: swe-sphere run williamson6 --restart")
    assert "--log run.log" in text
