"""Scenes in files of the user, and the types that scene parameters may have."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from swe_sphere.equations.effects import Viscosity
from swe_sphere.errors import ConfigError
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.user_scenes import checked


def fails(message: str) -> pytest.RaisesExc[ConfigError]:
    return pytest.raises(ConfigError, match=re.escape(message))


def factory(
    case: int = 1,
    wave: Literal["east", "west"] = "east",
    file: Path | None = None,
    word: str = "",
    speed: float | None = None,
    on: bool = False,
) -> None:
    """Only its annotations are used."""


def unions(
    half: Literal["North", "South"] = "North",
    alpha: None | float = None,  # noqa: RUF036
    count: int | float | None = None,
) -> None:
    """Only its annotations are used."""


def test_annotations_may_be_unions_and_words_in_capitals() -> None:
    read = checked("it", unions, {"half": "south", "alpha": "0.3", "count": "0.5"})
    assert read == {"half": "South", "alpha": 0.3, "count": 0.5}
    assert checked("it", unions, {"count": "default"}) == {"count": None}
    with fails("must be one of North, South, got 'East'"):
        checked("it", unions, {"half": "East"})


def test_parameters_take_the_types_of_their_annotations() -> None:
    texts = {"case": "3", "wave": " West", "file": " a/b.nc", "word": "x ", "speed": "2", "on": "1"}
    expected = {
        "case": 3, "wave": "west", "file": Path("a/b.nc"), "word": "x", "speed": 2.0, "on": True,
    }  # fmt: skip
    read = checked("it", factory, texts)
    assert read == expected and [type(v) for v in read.values()] == [
        type(v) for v in expected.values()
    ]
    assert checked("it", factory, read) == expected
    assert checked("it", factory, {"case": 4.0}) == {"case": 4}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("case", "1.5", "it: case must be a whole number, got '1.5'"),
        ("case", "two", "it: case must be a whole number, got 'two'"),
        ("case", float("nan"), "it: case must be a whole number, got nan"),
        ("case", "inf", "it: case must be a whole number, got 'inf'"),
        ("wave", "north", "it: wave must be one of east, west, got 'north'"),
        ("speed", "nan", "it: speed must be finite or 'default', got 'nan'"),
        ("speed", "fast", "it: speed must be a number or 'default', got 'fast'"),
        ("colour", "red", "scene it has no parameter 'colour'; it has case, wave, file,"),
    ],
)
def test_bad_parameter(key: str, value: str | float, message: str) -> None:
    with fails(message):
        checked("it", factory, {key: value})


def written(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def test_toml_scene_changes_another(tmp_path: Path) -> None:
    text = (
        'base = "williamson2"\ntitle = "tilted"\nne = 5\nnp = 6\ndays = 2.5\n'
        "[parameters]\nalpha = 0.5\n[effects]\nviscosity = { nu = 1e5 }\n"
    )
    scene, base = get_scene(written(tmp_path / "tilted.toml", text)), get_scene("williamson2")
    assert (scene.name, scene.title) == ("tilted", "tilted")
    assert (scene.ne, scene.np, scene.days) == (5, 6, 2.5)
    assert scene.parameters == {"alpha": 0.5} and scene.exact is not None
    assert scene.effects == (*base.effects, Viscosity(1e5))
    again = get_scene(tmp_path / "tilted.toml", alpha="0.25")
    assert again.parameters == {"alpha": 0.25} and again.ne == 5


def test_toml_scene_switches_effects_off(tmp_path: Path) -> None:
    text = 'base = "lake-at-rest"\nname = "still"\n[effects]\nrotation = false\n'
    scene = get_scene(written(tmp_path / "a.toml", text))
    assert scene.name == "still" and scene.coriolis is None and scene.effect("rotation") is None
    assert scene.exact is None and scene.bottom is not None


def test_toml_scene_builds_on_other_files(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    written(
        tmp_path / "deep" / "own.py",
        "from swe_sphere.testcases import get_scene\n"
        "def scene(tilt: float = 0.0):\n    return get_scene('williamson2', alpha=tilt)\n",
    )
    written(tmp_path / "deep" / "b.toml", 'base = "own.py"\nne = 7\n[parameters]\ntilt = 0.1\n')
    scene = get_scene(written(tmp_path / "a.toml", 'base = "deep/b.toml"\nnp = 9\n'), tilt=0.3)
    assert (scene.name, scene.ne, scene.np) == ("a", 7, 9)
    assert scene.parameters == {"alpha": 0.3, "tilt": 0.3}


def test_a_scene_in_a_file_knows_its_parameters(tmp_path: Path) -> None:
    """Also those left at their defaults, so that a restart with others is refused."""
    text = (
        "from dataclasses import replace\n"
        "from swe_sphere.testcases import get_scene\n"
        "def scene(speed: float = 20.0, file=None):\n"
        "    return replace(get_scene('williamson5'), name='mine')\n"
    )
    path = written(tmp_path / "mine.py", text)
    assert get_scene(path).parameters == {"speed": 20.0}
    assert get_scene(path, speed="30").parameters == {"speed": 30.0}
    small = {"scene": path, "ne": 2, "np": 4}
    run_scene(make_config(small | {"days": 0.1, "out": tmp_path / "a.nc"}))
    again = {"restart": tmp_path / "a.nc", "days": 0.2, "settings": ["scene.speed=30"]}
    with fails("scene_parameters is {'speed': 20.0} there and {'speed': 30.0} here"):
        run_scene(make_config(small | again))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ne = 4\n", 'bad.toml: name the scene that it changes: base = "williamson5"'),
        ("base = 3\n", "bad.toml: base: must be a valid string, got 3"),
        ('base = "williamson2"\nnee = 4\n', "there is no 'nee' in a scene; there are base, name,"),
        ('base = "williamson2"\nne = 2.5\n', "bad.toml: ne: must be a valid integer, got 2.5"),
        ('base = "williamson2"\ndays = -1\n', "bad.toml: days: must be greater than 0, got -1"),
        ('base = "williamson2"\ndays = nan\n', "bad.toml: days: must be a finite number, got nan"),
        ('base = "wiliamson2"\n', "bad.toml: unknown scene 'wiliamson2'; did you mean"),
        ('base = "williamson2"\n[parameters]\nb = 1\n', "williamson2 has no parameter 'b'; it has"),
        ('base = "williamson2"\n[effects]\ndrag2 = false\n', "williamson2 has no effect 'drag2'"),
        ('base = "williamson2"\n[effects]\nviscosity = true\n', "effects.viscosity must be false"),
        ('base = "williamson2"\n[effects.viscosity]\nnu = -1\n', "viscosity.nu must be finite and"),
        ('base = "bad.toml"\n', "bad.toml: its bases form a circle"),
        ('base = "absent.py"\n', "there is no scene file"),
        ("base = \n", "bad.toml is not valid TOML"),
    ],
)
def test_bad_toml_scene(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path / "bad.toml", text)
    with fails(message) as caught:
        get_scene(path)
    assert "\n" not in str(caught.value)
    with fails("there is no scene file"):
        get_scene(str(tmp_path / "absent.toml"))


def test_scene_without_an_effect() -> None:
    scene = get_scene("lauter").with_effect(Viscosity(1e5))
    flat = scene.without_effect("orography")
    assert flat.bottom is None and flat.exact is None and flat.coriolis is not None
    thin = scene.without_effect("viscosity")
    assert thin.effects == get_scene("lauter").effects and thin.exact is not None
    np.testing.assert_array_equal(
        flat.initial(*np.ones((2, 3)))[0], thin.initial(*np.ones((2, 3)))[0]
    )
    with fails("lauter has no effect 'drag'; it has momentum-advection, pressure-gradient,"):
        scene.without_effect("drag")


def test_scene_without_tracers_has_no_exact_ones() -> None:
    scene = get_scene("deformational").without_effect("tracers")
    assert scene.tracers is None and scene.exact_tracers is None and scene.exact is not None
