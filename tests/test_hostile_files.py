"""Files of data that others made: they execute no code that is not given as well."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from swe_sphere.analysis.accessor import open_run
from swe_sphere.equations.effects import Drag
from swe_sphere.errors import ConfigError
from swe_sphere.io.checkpoint import checkpoint_path
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.testcases import get_scene

CODE = {
    "scene": "from swe_sphere.testcases import get_scene\n\ndef scene():\n"
    "    return get_scene('williamson2')\n",
    "stepper": "from swe_sphere import RungeKutta\n\nclass Mine(RungeKutta):\n"
    "    name, order, a, b = 'mine', 2, ((1 / 2,),), (0, 1)\n",
    "preconditioner": "from swe_sphere.solvers.preconditioners.block_elimination import"
    " Helmholtz\n\nclass Mine(Helmholtz):\n    name = 'mine'\n",
}
"""A file for each kind of code that a run may name."""
EXECUTED = "\nfrom pathlib import Path\nPath('executed').touch()\n"


@pytest.fixture
def swe(swe):
    """Return a function that runs the program and returns its status and stderr."""
    return lambda *arguments: swe(*arguments)[::2]


@pytest.fixture
def run_with(swe):
    """Makes run.nc with the code in mine.py, which then leaves a file when it is executed."""

    def make(kind):
        Path("mine.py").write_text(CODE[kind])
        named = {"scene": "williamson2", "stepper": "rk4", kind: "mine.py"}
        if kind == "preconditioner":
            named["stepper"] = "implicit-midpoint"
        words = [word for name in named if name != "scene" for word in (f"--{name}", named[name])]
        small = ("--ne=2", "--np=4", "--dt=1800", "--days=0.0625", "--out=run.nc", "--quiet")
        assert swe("run", named["scene"], *words, *small) == (0, "")
        Path("mine.py").write_text(CODE[kind] + EXECUTED)
        return named["scene"]

    return make


def executed() -> bool:
    """Return whether mine.py was executed since the last call."""
    mark = Path("executed")
    there = mark.exists()
    mark.unlink(missing_ok=True)
    return there


@pytest.mark.parametrize("kind", ["stepper", "preconditioner"])
def test_a_restart_executes_no_code_that_only_the_file_names(swe, run_with, kind):
    scene = run_with(kind)
    restart = ("run", scene, "--restart=run.nc", "--days=0.125", "--quiet")
    status, told = swe(*restart)
    assert status == 2 and told.count("\n") == 1 and not executed()
    assert told.startswith("swe-sphere: run.nc names the file mine.py") and "--trust" in told
    # an edited stepper is noticed when it has been loaded, an edited preconditioner before that
    for given in ("--trust=mine.py", "--trust=./mine.py", f"--{kind}=mine.py"):
        status, told = swe(*restart, given)
        assert status == 2 and "has been edited" in told
    assert executed() == (kind == "stepper")


@pytest.mark.parametrize("kind", CODE)
def test_in_python_a_checkpoint_executes_no_code_either(run_with, kind):
    run_with(kind)
    with pytest.raises(ConfigError, match=r"run.nc names the file mine.py.*trust"):
        Simulation.from_checkpoint("run.nc")
    assert not executed()
    with pytest.raises(ConfigError, match="has been edited"):
        Simulation.from_checkpoint("run.nc", trust=["mine.py"])
    assert executed() == (kind != "preconditioner")
    Path("mine.py").write_text(CODE[kind])
    assert Simulation.from_checkpoint("run.nc", trust=["mine.py"]).steps == 3


@pytest.mark.parametrize("how", ["settings", "options"])
def test_a_preconditioner_among_the_settings_is_executed_with_trust_only(swe, run_with, how):
    run_with("preconditioner")
    value = {"settings": ["stepper.preconditioner=mine.py"]}
    if how == "options":
        value = {"options": {"preconditioner": "mine.py"}}
    one = Simulation("williamson2", stepper="implicit-midpoint", ne=2, np=4, dt=1800, **value)
    one.run(days=0.0625, out="other.nc")
    assert executed()
    with pytest.raises(ConfigError, match=r"other.nc names the file mine.py.*trust"):
        Simulation.from_checkpoint("other.nc")
    assert not executed()
    assert Simulation.from_checkpoint("other.nc", trust=["mine.py"]).steps == 3
    Path("mine.py").write_text(CODE["preconditioner"])
    with pytest.raises(ConfigError, match="has been edited"):
        Simulation.from_checkpoint("other.nc", trust=["mine.py"])


@pytest.mark.parametrize("kind", ["stepper", "preconditioner"])
def test_a_picture_needs_and_executes_no_method(swe, run_with, kind):
    run_with(kind)
    assert swe("plot", "run.nc", "--compare=exact") == (0, "")
    assert not executed()
    Path("mine.py").unlink()
    assert swe("plot", "run.nc", "--compare=exact", "--overwrite") == (0, "")


def test_a_picture_executes_no_scene(swe, run_with):
    run_with("scene")
    status, told = swe("plot", "run.nc", "--compare=exact")
    assert status == 2 and told.startswith("swe-sphere: run.nc names the file mine.py")
    assert not executed()
    assert swe("plot", "run.nc", "--compare=exact", "--trust=mine.py")[0] == 0
    assert executed()


@pytest.mark.parametrize(
    "scene",
    [
        get_scene("williamson2", alpha=1.0),
        get_scene("williamson2").with_effect(Drag(linear=1e-5)),
        replace(get_scene("williamson2"), planet=replace(EARTH, rotation=0.0)),
        replace(get_scene("williamson2"), exact=lambda lon, lat, t: (lon, lat, 1e3 + lon)),
    ],
    ids=["parameters", "effects", "planet", "function"],
)
def test_a_scene_made_in_python_is_compared_with_no_exact_solution(swe, tmp_path, scene):
    sim = Simulation(scene, ne=2, np=4, dt=1800)
    sim.run(days=0.0625, out=tmp_path / "run.nc")
    status, told = swe("plot", "run.nc", "--compare=exact")
    assert (status, told.count("\n")) == (2, 1)
    assert "is of a scene made in Python: compare with another file" in told


def test_the_command_that_resumes_allows_the_code_of_the_run(swe, run_with):
    scene = run_with("stepper")
    Path("mine.py").write_text(CODE["stepper"])
    again = ("run", scene, "--restart=run.nc", "--out=run.nc", "--trust=mine.py", "--days=30")
    for named in ([], ["--stepper=mine.py"]):
        status, told = swe(*again, *named, "--time-limit=1e-9")
        assert status == 1 and told.rstrip().endswith("--days 30 --trust mine.py")


# --- what files say


@pytest.fixture(scope="module")
def small_run(tmp_path_factory):
    """The file of a short run, with its checkpoint beside it."""
    path = tmp_path_factory.mktemp("run") / "run.nc"
    Simulation("williamson2", ne=2, np=4, dt=1800).run(days=0.0625, out=path)
    return path


@pytest.fixture
def copied(small_run, tmp_path):
    """A copy of that file and of its checkpoint."""
    for path in (small_run, checkpoint_path(small_run)):
        shutil.copy(path, tmp_path)
    return tmp_path / small_run.name


def with_attributes(path, **attributes):
    """Changes attributes of a file of frames."""
    with netCDF4.Dataset(path, "a") as file:
        file.setncatts(attributes)


@pytest.mark.parametrize(
    ("attributes", "told"),
    [
        ({"ne": 1026}, "ne=1026 and np=4 make 56844506 nodes, but the file has 218"),
        ({"ne": -2}, "greater than or equal to 0"),
        ({"ne": 2.0}, "valid integer"),
        ({"np": "4"}, "valid integer"),
        ({"radius": 0.0}, "greater than 0"),
        ({"stretch": np.nan}, "finite number"),
        ({"centre": [1.0, 2.0, 3.0]}, "at most 2"),
        ({"centre": "x"}, "valid list"),
        ({"spin": "x"}, "valid number"),
        ({"dt": "x"}, "valid number"),
        ({"title": 3.0}, "valid string"),
        ({"plot_field": [1.0, 2.0]}, "valid string"),
        ({"summary": 3.0}, "valid string"),
    ],
)
def test_attributes_are_checked_before_a_mesh_is_built(copied, attributes, told, monkeypatch):
    with_attributes(copied, **attributes)
    monkeypatch.setattr(Mesh, "build", pytest.fail)
    with pytest.raises(ConfigError, match=told) as raised:
        RunFile(copied).mesh  # noqa: B018
    assert "pydantic" not in str(raised.value)
    with pytest.raises(ConfigError, match=told):
        open_run(copied).swe.mesh  # noqa: B018


HEADERS = {
    "steps": [-1, 1.5, "3", None, True, 2**70],
    "arrays": ["x", [1], {"a": 1}],
    "attributes": ["x", [1], {"dt": "x"}, {"steps_at_once": 0}, {"run_id": 1}],
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, of in HEADERS.items() for v in of])
def test_the_header_of_a_checkpoint_is_checked(copied, name, value):
    path = checkpoint_path(copied)
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(arrays["header"].item())
    header[name] = header[name] | value if isinstance(value, dict) and name != "arrays" else value
    with path.open("wb") as file:
        np.savez(file, **arrays | {"header": np.array(json.dumps(header))})
    with pytest.raises(ConfigError, match="is damaged"):
        Simulation.from_checkpoint(path)


@pytest.mark.parametrize("deep", ["header", "configuration"])
def test_deep_json_in_a_checkpoint_is_one_line(copied, deep):
    path, nested = checkpoint_path(copied), 100_000 * "["
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(arrays["header"].item())
    header["attributes"]["configuration"] = nested
    text = nested if deep == "header" else json.dumps(header)
    with path.open("wb") as file:
        np.savez(file, **arrays | {"header": np.array(text)})
    with pytest.raises(ConfigError, match=r"is damaged|does not state its configuration"):
        Simulation.from_checkpoint(path)


@pytest.mark.parametrize("name", ["array:state", "array:origin", "array:counter_rhs_evaluations"])
@pytest.mark.parametrize(
    "value",
    [np.zeros(3), np.array("x"), np.zeros((2, 2, 2)), np.array(1j), np.array(np.inf)],
)
def test_the_arrays_of_a_checkpoint_are_checked(copied, name, value):
    path = checkpoint_path(copied)
    with np.load(path) as file:
        arrays = dict(file)
    assert name in arrays
    with path.open("wb") as file:
        np.savez(file, **arrays | {name: value})
    with pytest.raises(ConfigError, match=r"do not fit"):
        Simulation.from_checkpoint(path)
