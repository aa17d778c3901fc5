"""Files of data that others made: they execute no code that is not given as well."""

from pathlib import Path

import pytest

from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.simulation.simulation import Simulation

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
def swe(capfd, tmp_path, monkeypatch):
    """Runs the program in this process, in a folder of its own: status and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        return end.value.code, capfd.readouterr().err

    return call


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
    """Whether mine.py was executed since the last call."""
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
        assert status == 2 and "it has been edited" in told
    assert executed() == (kind == "stepper")


@pytest.mark.parametrize("kind", CODE)
def test_in_python_a_checkpoint_executes_no_code_either(run_with, kind):
    run_with(kind)
    with pytest.raises(ConfigError, match=r"run.nc names the file mine.py.*trust"):
        Simulation.from_checkpoint("run.nc")
    assert not executed()
    with pytest.raises(ConfigError, match="it has been edited"):
        Simulation.from_checkpoint("run.nc", trust=["mine.py"])
    assert executed() == (kind != "preconditioner")
    Path("mine.py").write_text(CODE[kind])
    assert Simulation.from_checkpoint("run.nc", trust=["mine.py"]).steps == 3


def test_a_picture_executes_no_scene(swe, run_with):
    run_with("scene")
    status, told = swe("plot", "run.nc", "--compare=exact")
    assert status == 2 and told.startswith("swe-sphere: run.nc names the file mine.py")
    assert not executed()
    assert swe("plot", "run.nc", "--compare=exact", "--trust=mine.py")[0] == 0
    assert executed()


def test_the_command_that_resumes_allows_the_code_of_the_run(swe, run_with):
    scene = run_with("stepper")
    Path("mine.py").write_text(CODE["stepper"])
    again = ("run", scene, "--restart=run.nc", "--out=run.nc", "--trust=mine.py", "--days=30")
    status, told = swe(*again, "--time-limit=1e-9")
    assert status == 1 and told.rstrip().endswith("--days 30 --trust mine.py")
