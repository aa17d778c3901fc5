"""Whatever is wrong with a scene is told in one line, before anything is computed or written."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from faulty_scenes import FIELDS, UNSTEADY, faulty_scenes, kind_of, later, returning, scene_file
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import swe_sphere.cli.main as program
from swe_sphere.errors import ConfigError
from swe_sphere.io.runfile import RunFile
from swe_sphere.pictures import plot
from swe_sphere.testcases import get_scene

FAULTS = faulty_scenes()


@pytest.fixture(scope="module")
def commands():
    """The command line, built once and not for each of hundreds of calls."""
    return typer.main.get_command(program.program())


@pytest.fixture
def run_scene(commands, tmp_path, monkeypatch, capfd):
    """Runs the text of a scene file with a file of frames: status, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(program, "program", lambda _: commands)

    def call(text, *flags):
        (tmp_path / "mine.py").write_text(text, encoding="utf-8")
        with pytest.raises(SystemExit) as end:
            program.main(["run", "mine.py", "--out", "a.nc", "--overwrite", *flags])
        out, err = capfd.readouterr()
        return SimpleNamespace(status=end.value.code, out=out, err=err)

    return call


def is_one_clear_line(text: str) -> bool:
    return (
        text.startswith("swe-sphere: ")
        and text.count("\n") == 1
        and "Traceback" not in text
        and "SWE_SPHERE_DEBUG" not in text  # the hint that comes with what nobody thought of
    )


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.thorough
def test_a_faulty_scene_ends_in_one_line(run_scene, tmp_path, fault) -> None:
    (tmp_path / "a.nc").write_text("precious")
    result = run_scene(FAULTS[fault], "--quiet")
    assert is_one_clear_line(result.err), result.err
    assert (result.status, result.out) == (2, "")
    assert (tmp_path / "a.nc").read_text() == "precious"


@pytest.mark.parametrize("name", UNSTEADY)
def test_a_function_that_fails_later_ends_the_run_in_good_order(run_scene, tmp_path, name) -> None:
    result = run_scene(scene_file(kind_of(name), later(name)), "--json", "--dt", "300")
    numbers = json.loads(result.out)
    assert is_one_clear_line(result.err), result.err
    assert (result.status, numbers["completed"]) == (2, False)
    assert f"mine: {name} fails: ZeroDivisionError: division by zero (mine.py" in numbers["reason"]
    assert list(RunFile(tmp_path / "a.nc").times) == [0.0]


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", FIELDS)
def test_a_number_stands_for_an_array_of_it(run_scene, name) -> None:
    """Whole numbers and lists of one, too: bit for bit the same."""
    numbers = {"equilibrium": "1000", "bottom": "20", "tracer": "1", "exact_tracers": "1"}
    if len(FIELDS[name]) == 3 and name != "forcing":
        numbers[name] = "1000"
    number, kind = numbers.get(name, "0"), kind_of(name)
    fields = FIELDS[name][:-1]
    array = run_scene(
        scene_file(kind, returning(name, (*fields, f"np.full(lat.shape, {number}.0)"))), "--json"
    )
    assert array.status == 0, array.err
    for form in (number, f"[np.float32({number})]"):
        found = run_scene(scene_file(kind, returning(name, (*fields, form))), "--json")
        assert _without_seconds(found.out) == _without_seconds(array.out)


def _without_seconds(line: str) -> dict[str, object]:
    return {name: v for name, v in json.loads(line).items() if not name.endswith("seconds")}


@pytest.mark.parametrize("title", ["costs 3 $", "$\\\\frac{1$ and {"])
def test_a_title_is_drawn_as_it_is_written(run_scene, tmp_path, monkeypatch, title) -> None:
    monkeypatch.setattr(plot, "ROWS", 19)
    monkeypatch.setattr(plot, "DOTS_PER_INCH", 30)
    result = run_scene(scene_file(changes=f"title='{title}'"), "--plot", "a.png", "--quiet")
    assert (result.status, result.out, result.err) == (0, "", "")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_a_complaint_names_scene_field_and_line(run_scene) -> None:
    text = scene_file(override="def coriolis(lon, lat):\n    x = lat\n    return x[:, 7]\n\n")
    line = text[: text.index("x[:, 7]")].count("\n") + 1
    told = run_scene(text).err
    assert "mine: coriolis fails: IndexError: too many indices" in told
    assert f"(mine.py, line {line})" in told
    short = run_scene(scene_file(override=returning("coriolis", ("lat[:-1]",)))).err
    assert "mine: coriolis has the shape (55,); it must be an array of shape (56,)" in short


@pytest.mark.exhaustive
@settings(max_examples=100, deadline=None)
@given(
    shape=hnp.array_shapes(min_dims=1, max_dims=2, max_side=4),
    returned=hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int32, np.bool_, np.complex128, np.object_]),
        hnp.array_shapes(min_dims=0, max_dims=3, max_side=4),
    ),
)
def test_a_field_fits_or_is_refused(shape, returned) -> None:
    """Of any shape and type: float64 of the shape of the places, or ConfigError."""
    scene = replace(get_scene("williamson2"), coriolis=lambda lon, lat: returned)
    try:
        expected = np.broadcast_to(returned, shape)
        fits = expected.dtype.kind in "fiub" and bool((np.abs(expected) < 1e30).all())
    except ValueError:
        fits = False
    if fits:
        field = scene.coriolis(np.zeros(shape), np.zeros(shape))
        assert field.dtype == np.float64 and field.shape == shape
        np.testing.assert_array_equal(field, expected)
    else:
        with pytest.raises(ConfigError, match=r"^williamson2: coriolis "):
            scene.coriolis(np.zeros(shape), np.zeros(shape))
