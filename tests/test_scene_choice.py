"""Choosing a scene and its effects: names, parameters, files, settings, and clear errors."""

from __future__ import annotations

import inspect
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swe_sphere.equations.effects import (
    DYNAMICS,
    EFFECTS,
    Hyperviscosity,
    Orography,
    PrescribedWind,
    PressureGradient,
    Relaxation,
    Rotation,
    Viscosity,
    hyperviscosity_default,
)
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases import SCENES, get_scene


@pytest.mark.parametrize("name", SCENES)
def test_scene_is_described(name: str) -> None:
    scene, summary = get_scene(name), (SCENES[name].__doc__ or "").splitlines()[0]
    assert scene.name == name and 20 <= len(summary) <= 80 and summary.endswith(".")
    assert "doi:10." in scene.reference and scene.title
    assert scene.ne >= 4 and 4 <= scene.np <= 16 and scene.days >= 1.0


def fails(message: str) -> pytest.RaisesExc[ConfigError]:
    return pytest.raises(ConfigError, match=re.escape(message))


def test_scene_names_and_parameters_are_checked() -> None:
    with fails("unknown scene 'wiliamson2'; did you mean 'williamson2'? There are: williamson1,"):
        get_scene("wiliamson2")
    with fails("scene williamson2 has no parameter 'beta'; it has alpha"):
        get_scene("williamson2", beta=1.0)
    with fails("scene williamson5 has no parameter 'alpha'; it has speed"):
        get_scene("williamson5", alpha=1.0)
    for bad in (float("nan"), "inf"):
        with fails("williamson2: alpha must be finite"):
            get_scene("williamson2", alpha=bad)
    with fails("williamson2: alpha must be a number, got 'north'"):
        get_scene("williamson2", alpha="north")
    with fails("galewsky: perturbed must be true or false, got 'maybe'"):
        get_scene("galewsky", perturbed="maybe")


def test_scene_parameters_are_read_from_text() -> None:
    scene = get_scene("williamson1", alpha="0.5", gaussian="Yes")
    assert scene.parameters == {"alpha": 0.5, "gaussian": True}
    found = get_scene("galewsky", perturbed="0").parameters
    assert found == {"perturbed": False, "speed": 80.0, "seed": 0, "noise": 0.1}


def test_scene_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from dataclasses import replace\nfrom swe_sphere.testcases import get_scene\n"
        "def scene(alpha: float = 0.0):\n"
        "    return replace(get_scene('williamson2', alpha=alpha), name='mine')\n"
    )
    scene = get_scene(str(file), alpha="0.25")
    assert scene.name == "mine" and scene.parameters["alpha"] == 0.25
    with fails("has no parameter 'depth'; it has alpha"):
        get_scene(str(file), depth=1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "must define scene(**parameters) -> Scene"),
        ("def scene(: pass", "fails: SyntaxError"),
        ("def scene(): return 1", "must return a Scene, got int"),
        ("def scene(): return 1 / 0", "fails: ZeroDivisionError"),
    ],
)
def test_bad_scene_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.py").write_text(text)
    with fails(message):
        get_scene(str(tmp_path / "bad.py"))
    with fails("there is no scene file"):
        get_scene(str(tmp_path / "absent.py"))


def test_settings_switch_dissipation_on_change_it_and_off() -> None:
    scene = get_scene("williamson5")
    thick = apply_settings(scene, ["viscosity.nu=1e5", "hyperviscosity.nu=default"])
    assert thick.effects == (*scene.effects, Viscosity(1e5), Hyperviscosity(None))
    assert apply_settings(thick, ["hyperviscosity.nu=3e14"]).effect("hyperviscosity").nu == 3e14
    assert apply_settings(thick, ["viscosity.nu=2", "hyperviscosity.nu=0"]).effects == (
        *scene.effects,
        Viscosity(2.0),
    )
    assert apply_settings(scene, ["viscosity.nu=0.0"]) == scene


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("orography.height=1", "williamson2 has no effect 'orography'; it has momentum-advection,"),
        ("viscosty.nu=1", "unknown effect 'viscosty'; did you mean 'viscosity'? There are: mom"),
        ("viscosity.mu=1", "effect 'viscosity' has no parameter 'mu'; it has nu"),
        ("rotation.f=1", "effect 'rotation' has no parameter 'f'; it has no parameters"),
        ("viscosity.nu=-1", "viscosity.nu must be finite and not negative, got -1.0"),
        ("viscosity.nu=nan", "viscosity.nu must be finite and not negative, got nan"),
        ("hyperviscosity.nu=inf", "hyperviscosity.nu must be finite and not negative, got inf"),
        ("viscosity.nu=default", "viscosity.nu must be a number, got 'default'"),
        ("hyperviscosity.nu=much", "must be a number or 'default', got 'much'"),
        ("drag.linear=-1", "drag.linear must be finite and not negative, got -1.0"),
        ("drag.quadratic=nan", "drag.quadratic must be finite and not negative, got nan"),
        ("drag.cubic=1", "effect 'drag' has no parameter 'cubic'; it has linear, quadratic"),
        ("relaxation.time=0", "relaxation.time must be positive, got 0.0"),
        ("relaxation.time=nan", "relaxation.time must be positive, got nan"),
        ("forcing.rate=1", "williamson2 has no effect 'forcing'; it has momentum-advection,"),
        ("viscosity.nu", "a setting must read effect.parameter=value, got 'viscosity.nu'"),
        ("viscosity=1", "a setting must read effect.parameter=value, got 'viscosity=1'"),
    ],
)
def test_bad_settings(setting: str, message: str) -> None:
    with fails(message):
        apply_settings(get_scene("williamson2"), [setting])


def test_hyperviscosity_default_scaling() -> None:
    assert 30.0 * hyperviscosity_default(30, 4) == pytest.approx(1e15)
    assert 30.0 * hyperviscosity_default(15, 4) == pytest.approx(1e16)
    assert 30.0 * hyperviscosity_default(60, 4) == pytest.approx(1e14)
    assert 30.0 * hyperviscosity_default(15, 7) == pytest.approx(1e15)
    assert 30.0 * hyperviscosity_default(30, 4, EARTH.radius / 10.0) == pytest.approx(1e12)
    mesh = Mesh.build(15, 4)
    assert Hyperviscosity().coefficients(mesh)["nu4"] == hyperviscosity_default(15, 4)
    assert Hyperviscosity(2.0).coefficients(mesh)["nu4"] == 2.0
    assert not Hyperviscosity(2.0, factor=0.0).absent  # `factor` is of the default alone
    assert Hyperviscosity(factor=0.0).absent and Hyperviscosity(0.0).absent


@pytest.mark.parametrize(
    ("effect", "parameters", "message"),
    [
        (Relaxation, {"time": "10"}, "relaxation.time must be positive, got 10"),
        (Relaxation, {"time": None}, "relaxation.time must be positive, got None"),
        (Hyperviscosity, {"factor": None}, "hyperviscosity.factor must be finite"),
    ],
)
def test_parameters_of_another_type_are_refused(effect, parameters, message) -> None:
    with fails(message):
        effect(**parameters)
    assert Relaxation(np.float32(10.0)).time == 10.0 and Relaxation(np.int64(10)).time == 10


def test_numbers_that_overflow_a_scene_are_named() -> None:
    with fails("scene williamson5 fails: OverflowError"):
        get_scene("williamson5", speed=1e300)


def test_hyperviscosity_default_follows_the_finest_part_of_a_stretched_mesh() -> None:
    """Refined four times it is that of a mesh of about four times as many elements."""
    plain, fine = Mesh.build(8, 4), Mesh.build(8, 4, stretch=4.0)
    times_finer = plain.spacing()[0] / fine.spacing()[0]
    assert 3.0 < times_finer <= 4.0
    expected = hyperviscosity_default(8, 4) / times_finer ** (1.0 / math.log10(2.0))
    assert Hyperviscosity().coefficients(fine)["nu4"] == pytest.approx(expected, rel=1e-12)
    assert Hyperviscosity(2.0).coefficients(fine)["nu4"] == 2.0


def test_effects_are_a_closed_set_of_names() -> None:
    assert all(cls.name == name for name, cls in EFFECTS.items())
    assert {e.name for e in DYNAMICS} == {"momentum-advection", "pressure-gradient"}
    assert {n for n, cls in EFFECTS.items() if cls.dissipation} == {
        "viscosity",
        "hyperviscosity",
        "edge-penalty",
        "drag",
        "relaxation",
    }


def test_functions_and_effects_of_a_scene_go_together() -> None:
    start = get_scene("williamson2").initial
    given = dict(name="mine", title="", reference="", initial=start, ne=4, np=4, days=1.0)
    with fails("mine: effect 'orography' needs the function 'bottom'"):
        Scene(**given, effects=(*DYNAMICS, Orography()))
    with fails("mine: 'coriolis' is given without effect 'rotation'"):
        Scene(**given, effects=DYNAMICS, coriolis=lambda lon, lat: lon)
    with fails("mine: 'bottom' is given without effect 'orography'"):
        Scene(**given, effects=DYNAMICS, bottom=lambda lon, lat: lon)
    wind = dict(wind=lambda lon, lat, t: (np.cos(lat), 0.0 * lon))
    with fails("mine: a prescribed wind is not accelerated; leave out pressure-gradient"):
        Scene(**given, **wind, effects=(PrescribedWind(), PressureGradient()))
    with fails("mine: an effect is listed twice"):
        Scene(**given, effects=(*DYNAMICS, Orography(), Orography()), bottom=lambda lon, lat: lon)
    with fails("mine: days must be finite and positive"):
        Scene(**(given | {"days": 0.0}), effects=DYNAMICS)


def test_a_scene_needs_a_name_effects_and_an_initial_state() -> None:
    start = get_scene("williamson2").initial
    scene = Scene("mine", (*DYNAMICS, Rotation()), start)
    assert (scene.title, scene.exact) == ("mine", None)
    lon, lat = np.array([0.3, 2.0]), np.array([-1.2, 0.4])
    for planet in (EARTH, Planet(rotation=1e-4)):
        turned = replace(scene, planet=planet)
        f = 2.0 * planet.rotation * np.sin(lat)
        np.testing.assert_array_equal(turned.coriolis(lon, lat), f)
        np.testing.assert_array_equal(turned.without_effect("rotation").coriolis or 0.0, 0.0)
    own = replace(scene, coriolis=lambda lon, lat: 1e-5)
    assert replace(own, planet=Planet(rotation=1e-4)).coriolis(lon, lat)[0] == 1e-5


def test_every_scene_and_parameter_is_on_the_page_of_scenes() -> None:
    lines = (Path(__file__).parents[1] / "docs/reference/scenes.md").read_text().splitlines()
    rows = {line.split("`")[1]: line for line in lines if line.startswith("| `")}
    assert list(rows) == list(SCENES)
    for name, row in rows.items():
        for parameter in inspect.signature(SCENES[name]).parameters:
            assert f"`{parameter}`" in row, f"{name}: {parameter}"


def test_recommended_setting_on_the_page_of_scenes_is_that_of_the_scene() -> None:
    lines = (Path(__file__).parents[1] / "docs/reference/scenes.md").read_text().splitlines()
    for line in lines:
        if line.startswith("| `"):
            scene, told = get_scene(line.split("`")[1]), line.split("|")[3]
            assert f"ne{scene.ne} np{scene.np}," in told
            assert "period" in told or f" {scene.days:g} day" in told


@pytest.mark.parametrize("wrong", [Viscosity, "drag", None])
def test_what_is_no_effect_is_refused_where_it_is_added(wrong) -> None:
    """A class without brackets used to vanish without a word."""
    with fails("among its effects is"):
        get_scene("williamson5").with_effect(wrong)
