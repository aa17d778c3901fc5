"""User-defined scenes, steppers and preconditioners, first those of docs/howto/extending.md."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
import xarray as xr
from support import random_state, relative, tangent, tendency

from swe_sphere.analysis.accessor import open_run
from swe_sphere.cli.main import main
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError
from swe_sphere.io.checkpoint import read_checkpoint
from swe_sphere.mesh import Mesh
from swe_sphere.planet import HOUR
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import Simulation, run_scene
from swe_sphere.solvers.preconditioners import PRECONDITIONERS, make_preconditioner
from swe_sphere.steppers import STEPPERS, get_stepper
from swe_sphere.steppers.runge_kutta import RK4, RungeKutta
from swe_sphere.studies.sweep import sweep
from swe_sphere.testcases import get_scene

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "howto" / "extending.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
EXAMPLES = dict(re.findall(r"```python\n# (\w+\.py)\n(.*?)```", PAGE, re.DOTALL))
SMALL = {"scene": "williamson5", "ne": 2, "np": 4, "days": 0.25, "dt": 1800.0}
BASE = "from swe_sphere.steppers import Stepper\nclass A(Stepper):\n    name, order = 'a', 1\n"
RK = "from swe_sphere.steppers.runge_kutta import RungeKutta\n"
EULER = "class {0}(RungeKutta):\n    name, order, a, b = '{1}', 1, (), (1.0,)\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the files of the page, to work in."""
    monkeypatch.chdir(tmp_path)
    for name, text in EXAMPLES.items():
        Path(name).write_text(text)
    return tmp_path


def test_the_scene_of_the_page_keeps_its_balance(here) -> None:
    """Without a mountain, on any planet; with one the dust is carried and kept."""
    small = {"scene": "my_flow.py", "ne": 4, "days": 0.5}
    for settings in ((), ("scene.day=12", "scene.speed=30")):
        summary = run_scene(make_config(small | {"settings": settings}))
        assert summary.completed and summary["l2_h"] < 1e-3 and summary["l2_v"] < 1e-2
    summary = run_scene(make_config(small | {"settings": ("scene.height=1500",)}))
    assert summary["l2_h"] is None and abs(summary["mass_drift_q_dust"]) < 1e-13
    assert summary["title"] == "a zonal wind in balance, over a mountain"
    with pytest.raises(ConfigError, match="my-flow: height must be less than"):
        run_scene(make_config(small | {"settings": ("scene.height=3000",)}))


def advanced(kind, dt: float, **options):
    """The state of lauter after 3 hours."""
    model = Model(Mesh.build(3, 4), get_scene("lauter"))
    stepper = kind(model, dt, **options)
    stepper.start(model.initial_state())
    for _ in range(round(3.0 * HOUR / dt)):
        stepper.step()
    return stepper


@pytest.mark.parametrize(
    ("file", "options"), [("ralston", {}), ("low_storage", {}), ("sdirk2", {"tolerance": 1e-10})]
)
def test_steppers_of_the_page_have_their_order(here, file: str, options) -> None:
    kind = get_stepper(f"{file}.py")
    exact = advanced(RK4, 75.0).state.numpy()
    coarse, fine = (
        np.abs(advanced(kind, dt, **options).state.numpy() - exact).max() for dt in (900.0, 450.0)
    )
    assert np.log2(coarse / fine) == pytest.approx(kind.order, abs=0.3)


@pytest.mark.parametrize("file", ["ralston", "low_storage", "sdirk2"])
def test_runs_with_the_steppers_of_the_page(here, file: str) -> None:
    values = {k: v for k, v in SMALL.items() if k != "dt" or file == "sdirk2"}
    summary = run_scene(make_config(values | {"stepper": f"{file}.py"}))
    assert summary["completed"] and summary["scheme"] == get_stepper(f"{file}.py").name


@pytest.mark.parametrize(("file", "part"), [("rotation", 1.5), ("smoothing", 0.8)])
def test_preconditioners_of_the_page_precondition(here, file: str, part: float) -> None:
    """With this part of the iterations that it takes without."""
    bare, helped = (
        run_scene(make_config(SMALL | {"stepper": "tr-bdf2", "preconditioner": name}))
        for name in ("none", f"{file}.py")
    )
    assert helped["completed"]
    assert helped["preconditioner_applications"] == helped["krylov_iterations"]
    assert 0 < helped["krylov_iterations"] < part * bare["krylov_iterations"]


def test_the_low_storage_limit_is_that_of_all_methods_of_order_and_stages_three(here) -> None:
    limit = STEPPERS["ssprk3"].stable_dt(SpectralRadii(1e-3))
    for file in ("ralston.py", "low_storage.py"):
        assert get_stepper(file).stable_dt(SpectralRadii(1e-3)) == pytest.approx(limit, rel=1e-3)


def test_a_stepper_without_amplification_is_one_line(here) -> None:
    text = EXAMPLES["low_storage.py"].split("    @classmethod")[0]
    Path("low_storage.py").write_text(text)
    with pytest.raises(ConfigError, match=r"stepper low-storage defines no `amplification\("):
        run_scene(
            make_config(
                {k: v for k, v in SMALL.items() if k != "dt"} | {"stepper": "low_storage.py"}
            )
        )


@pytest.mark.parametrize("names", [("state", "previos"), "state", ("dt",)])
@pytest.mark.parametrize("what", ["memory", "levels"])
def test_names_of_no_arrays_are_one_line(what: str, names: object, monkeypatch) -> None:
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    monkeypatch.setattr(RK4, what, names)
    with pytest.raises(ConfigError, match="stepper rk4: `memory` and `levels` must be tuples"):
        RK4(model, 60.0).start(model.initial_state())


def test_a_class_is_as_good_as_its_name() -> None:
    assert get_stepper(RK4) is RK4 is get_stepper("rk4")


def test_the_class_in_a_file_is_as_good_as_the_file(here) -> None:
    found = get_stepper("low_storage.py")
    sim = Simulation("lauter", ne=2, np=4, dt=600.0, stepper=found)
    assert sim.run(days=0.05, out=here / "run.nc").completed
    resumed = Simulation.from_checkpoint(here / "run.nc", trust=["low_storage.py"])
    assert resumed.stepper_class is found
    plan = {"ne": 2, "np": 4, "days": 0.05, "dt": 2160.0, "repeats": 1}
    runs = [sweep("lauter", [which], **plan) for which in (found, "low_storage.py")]
    assert runs[0].error.equals(runs[1].error)


def test_the_same_file_gives_the_same_class_until_it_is_edited(here) -> None:
    first = get_stepper("ralston.py")
    assert get_stepper(Path("ralston.py")) is first
    Path("ralston.py").write_text(EXAMPLES["ralston.py"].replace("3 / 4", "0.75"))
    assert get_stepper("ralston.py") is not first
    assert "ralston" not in STEPPERS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "there is no stepper file mine.py"),
        ("class Mine(: pass", r"mine.py fails: SyntaxError: .*\(mine.py, line 1\)"),
        ("x = 1\n\n1 / 0", r"mine.py fails: ZeroDivisionError: .* \(mine.py, line 3\)"),
        ("x = 1", "mine.py must define one stepper, a class with a name; it has none"),
        (RK, "mine.py must define one stepper, a class with a name; it has none"),
        (
            RK + EULER.format("A", "one") + EULER.format("B", "two"),
            "one stepper, .* it has one, two",
        ),
        (
            RK + EULER.format("A", "one") + EULER.format("B", "one"),
            "class B: there is a stepper 'one'",
        ),
        (RK + EULER.format("A", "rk4"), "class A: there is a stepper 'rk4' already, in swe_sphere"),
        (BASE, "stepper A does not define advance"),
        (RK + "class A(RungeKutta):\n    name = 'a'\n", "stepper a has no `order`"),
        (
            RK + EULER.format("A", "one") + "    family = 'mine'\n",
            "stepper one: `family` must be explicit or .*, got 'mine'",
        ),
        (
            RK + EULER.format("A", "one") + "    safety = -1.0\n",
            "stepper one: safety must be above 0, got -1.0",
        ),
        (
            RK + EULER.format("A", "one") + "    longest = float('nan')\n",
            "stepper one: longest must be above 0, got nan",
        ),
        (
            RK + EULER.format("A", "one") + "    def __init__(self, model, dt, x=3): pass\n",
            "stepper one: option x lacks type or default",
        ),
    ],
)
def test_a_bad_file_is_one_clear_line(here, text: str | None, message: str) -> None:
    if text is not None:
        Path("mine.py").write_text(text)
    known = dict(STEPPERS)
    with pytest.raises(ConfigError, match=message) as error:
        get_stepper("mine.py")
    assert "\n" not in str(error.value)
    assert dict(STEPPERS) == known


def test_a_class_needs_a_name() -> None:
    class Nameless(RungeKutta):
        order, a, b = 2, ((0.5,),), (0.0, 1.0)

    with pytest.raises(ConfigError, match=r"stepper .*Nameless has no name: define `name`"):
        Simulation("williamson2", ne=2, np=4, stepper=Nameless)


def test_a_bad_file_of_a_preconditioner_is_one_clear_line(here) -> None:
    model = Model(Mesh.build(2, 4), get_scene("williamson5"))
    known = dict(PRECONDITIONERS)
    for text, message in (
        ("x = 1", "mine.py must define one preconditioner, a class with a name; it has none"),
        (EXAMPLES["rotation.py"].replace("apply", "applied"), "RotationOnly does not define apply"),
    ):
        Path("mine.py").write_text(text)
        with pytest.raises(ConfigError, match=message):
            make_preconditioner("mine.py", model)
    assert dict(PRECONDITIONERS) == known


def test_a_failing_step_names_the_line(here) -> None:
    text = EXAMPLES["low_storage.py"].replace(
        "        for a, b, c in", "        1 / 0\n        for a, b, c in"
    )
    Path("mine.py").write_text(text)
    line = text.splitlines().index("        1 / 0") + 1
    summary = run_scene(make_config(SMALL | {"stepper": "mine.py", "dt": "auto"}))
    assert summary["reason"] == (
        f"mine.py fails: ZeroDivisionError: division by zero (mine.py, line {line})"
    )


@pytest.mark.parametrize(
    ("limit", "message"),
    [("'long'", "stable_dt of stepper low-storage must be a number, got 'long'"),
     ("0.0", "the stability limit of low-storage is 0 s: choose a step with --dt"),
     ("float('nan')", "the stability limit of low-storage is nan s: choose a step"),
     ("-5", "the stability limit of low-storage is -5 s: choose a step")],
)  # fmt: skip
def test_a_limit_that_is_none_is_one_clear_line(here, limit: str, message: str) -> None:
    limited = f"    @classmethod\n    def stable_dt(cls, radii):\n        return {limit}\n"
    Path("mine.py").write_text(EXAMPLES["low_storage.py"] + limited)
    with pytest.raises(ConfigError, match=message):
        run_scene(make_config(SMALL | {"stepper": "mine.py", "dt": "auto"}))


def test_a_failing_preconditioner_names_the_line(here) -> None:
    text = EXAMPLES["rotation.py"].replace("n, angle = self._nodes", "n, angle = self._edges")
    Path("mine.py").write_text(text)
    summary = run_scene(make_config(SMALL | {"stepper": "tr-bdf2", "preconditioner": "mine.py"}))
    line = next(i for i, line in enumerate(text.splitlines(), 1) if "_edges" in line)
    expected = rf"mine.py fails: AttributeError: .* \(mine.py, line {line}\)$"
    assert re.match(expected, summary["reason"])


def test_options_come_from_the_signature(here) -> None:
    text = "    def __init__(self, model, dt, part: float = 1.0):\n"
    text += "        super().__init__(model, dt)\n"
    Path("mine.py").write_text(EXAMPLES["ralston.py"] + text)
    config = SMALL | {"stepper": "mine.py", "dt": "auto"}
    assert run_scene(make_config(config | {"settings": ["stepper.part=0.5"]}))["completed"]
    with pytest.raises(ConfigError, match="stepper ralston has no option 'piece'; it has part"):
        run_scene(make_config(config | {"settings": ["stepper.piece=0.5"]}))
    with pytest.raises(ConfigError, match="stepper ralston: part must be a number"):
        run_scene(make_config(config | {"settings": ["stepper.part=half"]}))


@pytest.mark.parametrize(
    ("what", "file", "stepper"),
    [("stepper", "sdirk2.py", "sdirk2.py"), ("preconditioner", "smoothing.py", "tr-bdf2")],
)
def test_a_restart_with_an_edited_file_is_refused(here, what: str, file: str, stepper: str) -> None:
    asked = SMALL | {"stepper": stepper} | ({what: file} if what == "preconditioner" else {})
    run_scene(make_config(asked | {"out": "whole.nc", "days": 0.5}))
    run_scene(make_config(asked | {"out": "part.nc"}))
    onwards = asked | {"restart": "part.nc", "days": 0.5}
    run_scene(make_config(onwards | {"out": "rest.nc"}))
    whole, rest = (read_checkpoint(Path(f"{name}.nc.restart")) for name in ("whole", "rest"))
    assert np.array_equal(whole.state_dict["state"], rest.state_dict["state"])
    Path(file).write_text(Path(file).read_text() + "# edited\n")
    with pytest.raises(ConfigError, match=f"^the {what}'s file has been edited since"):
        run_scene(make_config(onwards))


def test_the_effect_of_the_page_is_what_it_says(here) -> None:
    """-k |v| v / h, with its exact derivative and what conserves its mass."""
    scene = get_scene("friction.py")
    mesh = Mesh.build(3, 4)
    model, plain = (Model(mesh, each) for each in (scene, get_scene("williamson5")))
    state, direction = (random_state(model, seed) for seed in (1, 2))
    u, v, h = state.reshape(3, -1)
    friction = tendency(model, state) - tendency(plain, state)
    expected = -3e-3 * np.hypot(u, v) / h * np.stack([u, v, 0.0 * h])
    np.testing.assert_allclose(friction.reshape(3, -1), expected, atol=1e-9)
    small = 1e-5 * direction
    slope = (tendency(model, state + small) - tendency(model, state - small)) / 2e-5
    assert relative(tangent(model, state, direction), slope, 3) < 1e-7
    assert scene.effect("bottom-friction").conserves == {"mass", "tracers"}


def test_a_restart_with_an_edited_effect_is_refused(here) -> None:
    asked = SMALL | {"scene": "friction.py", "stepper": "tr-bdf2"}
    asked["settings"] = ["bottom-friction.k=1e-3"]
    assert run_scene(make_config(asked | {"out": "part.nc"}))["completed"]
    Path("friction.py").write_text(EXAMPLES["friction.py"].replace("-rate * u", "-2.0 * rate * u"))
    with pytest.raises(ConfigError, match=r"^the scene's file has been edited since"):
        run_scene(make_config(asked | {"restart": "part.nc", "days": 0.5}))


# --- diagnostics and callbacks


def test_the_diagnostics_of_the_page_appear_in_the_file(here, capsys):
    options = ["--ne=2", "--np=4", "--days=0.1", "--dt=1800", "--out=jet.nc", "--json"]
    with pytest.raises(SystemExit, match="0"):
        main(["run", "galewsky", "--diagnostics", "eddies.py", *options])
    data, told = open_run("jet.nc"), json.loads(capsys.readouterr().out)
    assert told["eddy_energy"] == pytest.approx(np.average(
        0.5 * data.v.values[-1] ** 2, weights=data.area
    ))  # fmt: skip
    assert data.eddy_energy.units == "m2 s-2"
    assert data.potential_vorticity.dims == ("time", "node")
    assert float(np.average(data.potential_vorticity[0] * data.h[0], weights=data.area)) < 1e-6


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("x = 1\n", "defines no diagnostic"),
        ("x = = 1\n", "SyntaxError"),
        (None, "cannot read mine.py: No such file"),
    ],
)
def test_files_without_diagnostics_are_one_line(here, text, word):
    if text is not None:
        Path("mine.py").write_text(text)
    with pytest.raises(ConfigError, match=word):
        run_scene(make_config(SMALL | {"diagnostics": ["mine.py"]}))


def test_the_order_that_the_page_measures_is_that_of_its_stepper(here):
    script = dedent(next(block for block in BLOCKS if "np.log2" in block))
    names = {}
    exec(script, names)
    orders = np.diff(-np.log2(names["errors"]))
    assert orders == pytest.approx([3.0, 3.0], abs=0.2)


def test_an_implicit_method_without_an_error_constant_is_refused():
    from swe_sphere.steppers.implicit import ImplicitStepper

    with pytest.raises(ConfigError, match=r"stepper own has no `error_constant`.* define it"):
        type("Own", (ImplicitStepper,), {"name": "own", "order": 1})


def test_the_callback_of_the_page_is_called():
    callback = next(block for block in BLOCKS if "callbacks=[follow]" in block)
    exec(callback, {})


def test_callbacks_of_the_page_write_files_on_their_own_schedules(here):
    pytest.importorskip("zarr")
    block = next(block for block in BLOCKS if "append_dim" in block)
    exec(block.replace("ne=4, np=6", "ne=2, np=4"), {})
    grid = xr.open_zarr("grid.zarr", chunks=None)
    assert grid.vorticity.dims == ("time", "lat", "lon") and grid.sizes["time"] == 2


# --- the list of edits

IN_THE_PACKAGE = {
    "my_flow.py": ("testcases", "swe_sphere.testcases", "SCENES", "scene"),
    "ralston.py": ("swe_sphere/steppers", "swe_sphere.steppers", "STEPPERS", "ralston"),
    "rotation.py": ("swe_sphere/solvers/preconditioners", "swe_sphere.solvers.preconditioners",
                    "PRECONDITIONERS", "rotation"),
}  # fmt: skip
"""Examples of the page: the folder of their kind, and the name that they have in its register."""


@pytest.fixture
def copy(tmp_path):
    """A copy of the package, to be edited."""
    for name in ("swe_sphere", "kernels", "testcases"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("*.pyc"))
    (tmp_path / "pyproject.toml").touch()
    return tmp_path


def test_in_the_package_too_each_is_one_file(copy):
    """Nothing else has to be told of a file that is put beside those of its kind."""
    for file, (folder, *_) in IN_THE_PACKAGE.items():
        alone = re.sub(r"\n\n\ndef scene\(\):.*|, get_scene\b", "", EXAMPLES[file],
                       flags=re.DOTALL)  # fmt: skip
        (copy / folder / file).write_text(alone)
        assert f"`{folder}/NAME.py`" in PAGE
    found = [f"'{name}' in {module}.{of}" for _, module, of, name in IN_THE_PACKAGE.values()]
    code = f"import {', '.join(module for _, module, *_ in IN_THE_PACKAGE.values())}\n"
    code += f"print([{', '.join(found)}])"
    told = subprocess.check_output([sys.executable, "-c", code], text=True, cwd=copy)
    assert told.strip() == str([True] * len(found))


MORE_GRAVITY = '''
@dataclass(frozen=True)
class MoreGravity(Effect):
    """-more grad h."""

    name = "more-gravity"
    conserves = MASSES
    dissipation = True  # so that it may be switched on for any scene
    terms = frozenset({"more"})
    more: float

    def coefficients(self, mesh):
        return {"more": self.more}
'''
THREE_FILES = (
    ("swe_sphere/equations/effects.py",
     '"""The nonlinear dynamics without rotation and bottom; a scene may have fewer effects."""\n',
     MORE_GRAVITY),
    ("kernels/terms.py", "    momentum: bool = False\n", "    more: bool = False\n"),
    ("kernels/terms.py", "return self.advection or self.pressure", " or self.more"),
    ("kernels/terms.py", '            "nu": terms.diffusion and real,\n',
     '            "more": terms.more and real,\n'),
    ("kernels/dynamics.py", "            head += geo.gravity * surface(geo, node, h)\n",
     "        if wp.static(terms.more):\n            head += geo.more * h\n"),
    ("kernels/dynamics.py", "            head += geo.gravity * h\n",
     "        if wp.static(terms.more):\n            head += geo.more * h\n"),
)  # fmt: skip
"""A file, a text that stands in it once, and what is put behind that."""
TRIED = """
from dataclasses import replace
import numpy as np
from swe_sphere.equations.effects import EFFECTS
from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import Planet
from swe_sphere.testcases import get_scene

def rates(gravity, *more):
    scene = replace(get_scene("williamson2"), planet=Planet(gravity=gravity))
    for effect in more:
        scene = scene.with_effect(effect)
    model = Model(Mesh.build(2, 4), scene)
    state = model.initial_state()
    there = model.device_mesh.upload(np.cos(np.arange(model.size)))
    rate, change = model.zeros(), model.zeros()
    model.tendency(state, 0.0, rate)
    model.jacobian().update(state, 0.0)(there, change)
    return np.stack([rate.numpy(), change.numpy()])

ours, theirs = rates(6.0, EFFECTS["more-gravity"](2.0)), rates(8.0)
print(*np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1))
"""


@pytest.mark.thorough
def test_an_effect_with_derivatives_is_three_files(copy):
    """With its derivative: a push by the slope of the depth is more gravity."""
    kind = "| an effect with derivatives"
    row = next(line for line in PAGE.splitlines() if line.startswith(kind))
    assert {file for file, *_ in THREE_FILES} <= set(re.findall(r"`([\w/]+\.py)`", row))
    for file, there, more in THREE_FILES:
        text = (copy / file).read_text()
        assert text.count(there) == 1
        (copy / file).write_text(text.replace(there, there + more))
    told = subprocess.check_output([sys.executable, "-c", TRIED], text=True, cwd=copy)
    assert all(float(each) < 1e-12 for each in told.splitlines()[-1].split())


def test_diagnostics_and_callbacks_are_no_file_of_the_package(here):
    """They reach file, summary and sweeps from a file that no source of the package names."""
    sources = (path.read_text() for path in (ROOT / "swe_sphere").rglob("*.py"))
    assert not any("eddy_energy" in text for text in sources)
    asked = SMALL | {"diagnostics": ["eddies.py"], "out": "run.nc"}
    summary = run_scene(make_config(asked))
    assert summary["eddy_energy"] == open_run("run.nc").eddy_energy[-1] > 0.0
    swept = sweep("williamson5", "rk4", ne=2, np=4, days=0.25, dt=1800.0, repeats=1)
    assert swept.eddy_energy[swept.role.values == "grid"].item() == summary["eddy_energy"]
