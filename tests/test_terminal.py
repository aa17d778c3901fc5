"""Ranks that `--ranks` starts in a terminal draw on it what a single process does."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from contextlib import suppress

import pytest

RUN = ["run", "williamson2", "--ne", "2", "--dt", "7200", "--days", "0.5"]
COLUMNS, LINES = 103, 24
COLOURS = {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
ALONE, RANKS = [], ["--ranks", "2"]


@pytest.fixture(autouse=True)
def mpi():
    """Skips where there is none."""
    pytest.importorskip("mpi4py")


def shown(*arguments, stdout=None, stderr=None, size=(LINES, COLUMNS), **environment):
    """Exit status and text on a terminal that is both stdout and stderr, or what they leave."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
    with subprocess.Popen(
        [sys.executable, "-m", "swe_sphere", *RUN, *arguments], stdin=subprocess.DEVNULL,
        stdout=stdout or theirs, stderr=stderr or theirs, env=environ(environment),
    ) as job:  # fmt: skip
        os.close(theirs)
        text = b""
        with suppress(OSError):  # which ends what is read of a terminal
            while part := os.read(ours, 65536):
                text += part
    os.close(ours)
    return job.returncode, text.decode().replace("\r\n", "\n")


def environ(more):
    ours = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE")
    return {name: x for name, x in os.environ.items() if name not in ours} | COLOURS | more


def without_times(text):
    """How long a run took is not the same twice."""
    return re.sub(r"(?m)^. time  .*\n", "", text)


@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1"}, {"TERM": "dumb"}])
@pytest.mark.parametrize("live", [["--live", "u"], ["--live", "q_dye"]])
def test_pictures_and_tables_are_those_of_one_process(live, environment):
    (status, alone), ranks = (shown(*live, *each, **environment) for each in (ALONE, RANKS))
    assert ranks[0] == status and without_times(ranks[1]) == without_times(alone)


def test_a_bar_and_a_table_are_as_wide_as_the_terminal():
    (_, alone), (status, text) = shown(), shown(*RANKS)
    bar, table = text.split("\r")[1], text.split("\r")[-1]
    assert status == 0 and "0/" in bar and bar == alone.split("\r")[1]
    assert 0 <= COLUMNS - len(bar) < 2  # tqdm leaves the last column empty
    assert "\x1b[3m" in table and "completed" in table


def test_a_terminal_of_unknown_size_shows_the_table():
    (_, alone), (_, ranks) = (shown("--live", "u", *each, size=(0, 0)) for each in (ALONE, RANKS))
    assert "completed" in ranks and without_times(ranks) == without_times(alone)


def test_what_goes_to_a_file_is_plain(tmp_path):
    with (tmp_path / "table").open("w") as file:
        status, text = shown(*RANKS, stdout=file)
    table = (tmp_path / "table").read_text()
    assert status == 0 and "0/" in text and "completed" not in text
    assert "\x1b" not in table and "completed" in table


def test_pictures_need_a_terminal_for_errors(tmp_path):
    with (tmp_path / "told").open("w") as file:
        status, text = shown(*RANKS, "--live", "u", stderr=file)
    told = (tmp_path / "told").read_text()
    assert (status, text, told.count("\n")) == (2, "", 1) and "a terminal with colours" in told
