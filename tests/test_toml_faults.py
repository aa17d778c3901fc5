"""TOML files of runs, scenes and sweeps with values that are none: each is told in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from swe_sphere.errors import ConfigError
from swe_sphere.settings.values import by_field, read_toml
from swe_sphere.simulation.config import make_config
from swe_sphere.studies.sweep.sweep_plan import load_recipe
from swe_sphere.testcases import get_scene

LONG = "1" + 400 * "0"
"""A whole number that no float can hold."""
ENDLESS = "0x" + 9000 * "f"
"""One that Python does not even write out."""

NO_NUMBERS = {
    "a switch": "true", "a word": '"x"', "NaN": "nan", "infinite": "inf",
    "long": LONG, "minus long": f"-{LONG}", "endless": ENDLESS, "a list": "[[1]]",
    "a table": "{a = 1}", "a day": "2001-01-01",
}  # fmt: skip

BROKEN = {
    "endless": "ne = 1" + 5000 * "0",
    "deep": "ne = " + 100_000 * "[",
    "no character": "\0",
    "twice": "ne = 1\nne = 2\n",
    "cut short": 'ne = "',
}
"""Files that are no TOML, or none that can be read."""

RUN = (
    "dt", "days", "every", "alpha", "stretch", "centre-lon", "centre-lat", "spin", "tolerance",
    "adaptive", "time-limit", "ne", "np",
)  # fmt: skip
SWEEP = (
    "dt", "days", "ne", "np", "levels", "tolerance", "report-days", "repeats", "time-limit",
    "target-error", "alpha", "stretch",
)  # fmt: skip
SCENE = ("dt", "days", "ne", "np")


def read_run(path: Path) -> None:
    make_config(by_field(read_toml(path)))


def read_scene(path: Path) -> None:
    get_scene(str(path))


def read_sweep(path: Path) -> None:
    load_recipe(str(path)).plans({})


HEADS = {
    read_run: 'scene = "williamson2"\n',
    read_scene: 'base = "williamson2"\n',
    read_sweep: 'scene = "williamson2"\nsteppers = ["rk4"]\n',
}
READERS = pytest.mark.parametrize("reader", HEADS)


def complaint(tmp_path: Path, reader, text: str) -> str:
    """The one line about the file."""
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        reader(path)
    line = str(caught.value)
    assert "\n" not in line and len(line) < 400
    return line


@pytest.mark.parametrize("value", NO_NUMBERS)
@pytest.mark.parametrize(
    ("reader", "name"),
    [
        *((read_run, name) for name in RUN),
        *((read_scene, name) for name in SCENE),
        *((read_sweep, name) for name in SWEEP),
    ],
)
def test_what_is_no_number_is_not_taken_for_one(tmp_path, reader, name, value) -> None:
    assert name in complaint(tmp_path, reader, f"{HEADS[reader]}{name} = {NO_NUMBERS[value]}\n")


@READERS
@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_file_is_one_line(tmp_path, reader, fault) -> None:
    assert "mine.toml" in complaint(tmp_path, reader, BROKEN[fault])


@pytest.mark.parametrize("value", ["a switch", "a word", "NaN", "infinite", "long", "endless"])
def test_scene_parameters_in_a_file_are_numbers(tmp_path, value) -> None:
    text = f"{HEADS[read_scene]}[parameters]\nalpha = {NO_NUMBERS[value]}\n"
    assert "alpha" in complaint(tmp_path, read_scene, text)


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_coefficients_in_a_file_are_numbers(tmp_path, value) -> None:
    for reader, table in ((read_scene, "effects"), (read_sweep, "set")):
        text = f"{HEADS[reader]}[{table}.viscosity]\nnu = {NO_NUMBERS[value]}\n"
        complaint(tmp_path, reader, text)


@READERS
def test_times_that_no_run_can_have(tmp_path, reader) -> None:
    assert "1000000000" in complaint(tmp_path, reader, f"{HEADS[reader]}days = 1e300\n").replace(
        "1e+09", "1000000000"
    )


@pytest.mark.parametrize("name", ["out", "plot", "restart", "reference"])
@pytest.mark.parametrize("file", ['"\\u0000"', f'"{5000 * "x"}"'])
def test_names_that_no_file_can_have(tmp_path, name, file) -> None:
    text = f"{HEADS[read_run]}{name} = {file}\n"
    assert f"{name}: must be the name of a file" in complaint(tmp_path, read_run, text)


@READERS
def test_a_file_may_begin_with_a_mark_of_utf_8(tmp_path, reader) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(HEADS[reader], encoding="utf-8-sig")
    reader(path)


@READERS
@pytest.mark.parametrize("code", ["utf-16", "utf-16-le", "utf-32"])
def test_another_code_is_named(tmp_path, reader, code) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(HEADS[reader], encoding=code)
    with pytest.raises(ConfigError, match=r"mine.toml is not in UTF-8 but in UTF-16"):
        reader(path)


@pytest.mark.parametrize(
    "name", ["../evil", "/tmp/evil", "..", "a\\u0000b", 300 * "x", "README.md"]
)
def test_the_sweeps_of_a_recipe_stay_in_its_folder(tmp_path, name) -> None:
    assert "name: must be the name of a folder" in complaint(
        tmp_path, read_sweep, f'{HEADS[read_sweep]}name = "{name}"\n'
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time-limit = 5\ntime_limit = 100\n", "time_limit is given twice"),
        ('set = ["viscosity.nu=1e5"]\n[settings.viscosity]\nnu = 1e4\n', "is given twice"),
        ("[set.viscosty]\n", r"set\.viscosty is empty"),
    ],
)
def test_nothing_in_a_file_is_lost(tmp_path, text, said):
    file = tmp_path / "run.toml"
    file.write_text('scene = "williamson2"\n' + text)
    with pytest.raises(ConfigError, match=said):
        read_run(file)
