"""Ranks that `--ranks` starts in a terminal draw on it what a single process does."""

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from contextlib import suppress

import pytest

from swe_sphere.compiling import COMPILING

RUN = ["run", "williamson2", "--ne", "2", "--dt", "7200", "--days", "0.5"]
COLUMNS, LINES = 103, 24
COLOURS = {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
RANKS = ["--ranks", "2"]
SIZE, UNKNOWN = (LINES, COLUMNS), (0, 0)
U, DYE = ["--live", "u"], ["--live", "q_dye"]
PLAIN, DUMB = {"NO_COLOR": "1"}, {"TERM": "dumb"}
PICTURES = [(U, {}), (U, PLAIN), (U, DUMB), (DYE, {}), (DYE, PLAIN), (DYE, DUMB)]
"""What is drawn, and the environment it is drawn in; there is no such field as the second."""
SINGLE = """
import json, os, sys
from swe_sphere.cli.main import main

for arguments, terminal, environment in json.loads(sys.argv[1]):
    os.environ.clear()
    os.environ.update(environment)
    os.dup2(terminal, 1)
    os.dup2(terminal, 2)
    os.close(terminal)
    try:
        main(arguments)
    except SystemExit as end:
        print(end=f"\\0{end.code}", flush=True)
"""
"""One run after another, each on a terminal of its own; the exit status follows what it shows."""


@pytest.fixture(scope="module", autouse=True)
def mpi():
    """Skips where there is none."""
    pytest.importorskip("mpi4py")


def by_ranks(*arguments, stdout=None, stderr=None, size=SIZE, environment=()):
    """Exit status and text on a terminal that is both stdout and stderr, or what they leave."""
    ours, theirs = terminal(size)
    with subprocess.Popen(
        [sys.executable, "-m", "swe_sphere", *RUN, *RANKS, *arguments], stdin=subprocess.DEVNULL,
        stdout=stdout or theirs, stderr=stderr or theirs, env=environ(dict(environment)),
    ) as job:  # fmt: skip
        os.close(theirs)
        text = read(ours)
    return job.returncode, text


@pytest.fixture(scope="module")
def alone():
    """The same of a single process, by arguments, environment and size; one process shows all."""
    cases = [*((*picture, SIZE) for picture in PICTURES), ([], {}, SIZE), (U, {}, UNKNOWN)]
    terminals = [terminal(size) for *_, size in cases]
    ours, theirs = zip(*terminals, strict=True)
    jobs = [
        ([*RUN, *arguments], to, environ(environment))
        for (arguments, environment, _), to in zip(cases, theirs, strict=True)
    ]
    # begun on a terminal, or Python would not write line by line
    with subprocess.Popen(
        [sys.executable, "-c", SINGLE, json.dumps(jobs)], stdin=subprocess.DEVNULL,
        stdout=theirs[0], stderr=theirs[0], env=jobs[0][2], pass_fds=theirs,
    ):  # fmt: skip
        for each in theirs:
            os.close(each)
        texts = [read(each).split("\0") for each in ours]
    found = {
        key(*case): (int(status), text) for case, (text, status) in zip(cases, texts, strict=True)
    }
    return lambda *case: found[key(*case)]


def key(arguments, environment=(), size=SIZE):
    return json.dumps([arguments, dict(environment), size])


def terminal(size):
    """A new one, from both sides."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
    return ours, theirs


def read(ours):
    """All that is written to a terminal, until nobody has it open."""
    text = b""
    with suppress(OSError):  # which ends what is read of a terminal
        while part := os.read(ours, 65536):
            text += part
    os.close(ours)
    return text.decode().replace("\r\n", "\n")


def environ(more):
    ours = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE")
    return {name: x for name, x in os.environ.items() if name not in ours} | COLOURS | more


def comparable(text):
    """Return what is drawn, without the time that the run took, and the messages below or above.

    Messages of ranks arrive through a pipe, before or after the table that rank 0 draws itself.
    """
    text = re.sub(r"(?m)^. time  .*\n", "", text).replace(f"swe-sphere: {COMPILING}\n", "")
    messages = re.findall(r"(?m)^swe-sphere: .*\n", text)
    return re.sub(r"(?m)^swe-sphere: .*\n", "", text), messages


@pytest.mark.parametrize(("live", "environment"), PICTURES)
@pytest.mark.thorough
def test_pictures_and_tables_are_those_of_one_process(alone, live, environment):
    status, text = by_ranks(*live, environment=environment)
    expected = alone(live, environment)
    assert status == expected[0] and comparable(text) == comparable(expected[1])


@pytest.mark.thorough
def test_a_bar_and_a_table_are_as_wide_as_the_terminal(alone):
    status, text = by_ranks()
    bar, table = text.split("\r")[1], text.split("\r")[-1]
    assert status == 0 and "0/" in bar and bar == alone([])[1].split("\r")[1]
    assert 0 <= COLUMNS - len(bar) < 2  # tqdm leaves the last column empty
    assert "\x1b[3m" in table and "completed" in table


@pytest.mark.thorough
def test_a_terminal_of_unknown_size_shows_the_table(alone):
    _, text = by_ranks(*U, size=UNKNOWN)
    assert "completed" in text and comparable(text) == comparable(alone(U, {}, UNKNOWN)[1])


def test_what_goes_to_a_file_is_plain(tmp_path):
    with (tmp_path / "table").open("w") as file:
        status, text = by_ranks(stdout=file)
    table = (tmp_path / "table").read_text()
    assert status == 0 and "0/" in text and "completed" not in text
    assert "\x1b" not in table and "completed" in table


@pytest.mark.thorough
def test_pictures_need_a_terminal_for_errors(tmp_path):
    with (tmp_path / "told").open("w") as file:
        status, text = by_ranks(*U, stderr=file)
    told = (tmp_path / "told").read_text()
    assert (status, text, told.count("\n")) == (2, "", 1) and "a terminal with colours" in told
