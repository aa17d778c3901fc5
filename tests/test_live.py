"""`run --live`: pictures in the terminal, by simulated time."""

import io
import re

import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.ranks.communicator import Communicator
from swe_sphere.simulation.observers import live_view

CELL = re.compile(r"\x1b\[38;2;(\d+);(\d+);(\d+);48;2;(\d+);(\d+);(\d+)m(▀+)")


class Tty(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    """Makes one of 40 columns and 20 lines the place of errors, when the test has begun."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in {
        "COLUMNS": "40", "LINES": "20", "TERM": "xterm-256color", "COLORTERM": "truecolor"
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)

    def begin():
        found = Tty()
        monkeypatch.setattr("sys.stderr", found)
        return found

    return begin


RUN = ["run", "williamson2", "--ne", "2", "--np", "4", "--dt", "7200", "--days", "1", "--json"]


def test_pictures_of_a_run(terminal, capsys):
    """Eastward wind: white at the poles, the same red at all longitudes of the equator."""
    screen = terminal()
    with pytest.raises(SystemExit, match="0"):
        main([*RUN, "--live", "u"])
    frames = re.split(r"\x1b\[\d+F", screen.getvalue())
    assert len(frames) == 12  # one a step: there are fewer than a hundred
    assert screen.getvalue().count("\x1b[11F") == 11
    lines = [CELL.findall(line) for line in frames[-1].splitlines() if "▀" in line]
    assert len(lines) == 10
    assert {sum(len(cell[-1]) for cell in line) for line in lines} == {39}
    pole = [int(x) for x in lines[0][0][:3]]
    equator = {int(x) - int(z) for cell in lines[5] for x, z in [(cell[0], cell[2])]}
    assert min(pole) > 200 and min(equator) > 30 and max(equator) < min(equator) + 6
    assert "day 1.00 of 1, williamson2: eastward" in frames[-1]


def test_numbers_are_those_of_a_run_without(terminal, capsys):
    terminal()
    told = []
    for live in ([], ["--live", "auto"]):
        with pytest.raises(SystemExit, match="0"):
            main([*RUN, *live])
        numbers = r'"(?:l2_h|l2_v|energy_drift|dt|steps)": [\d.e+-]+'
        told.append(re.findall(numbers, capsys.readouterr().out))
    assert len(told[0]) == 5 and told[0] == told[1]


def test_what_cannot_be_drawn(terminal, monkeypatch):
    terminal()
    with pytest.raises(ConfigError, match="did you mean 'vorticity'"):
        live_view("vortticity", Communicator())
    monkeypatch.setenv("TERM", "dumb")
    with pytest.raises(ConfigError, match="terminal with colours"):
        live_view("h", Communicator())
    monkeypatch.setattr("sys.stderr", io.StringIO())
    with pytest.raises(ConfigError, match="terminal with colours"):
        live_view("h", Communicator())
