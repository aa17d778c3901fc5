"""A file that is there already: what a run does not replace unasked, and how it goes on in it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray

from swe_sphere import Output, Simulation, open_run
from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.io.checkpoint import checkpoint_path, read_checkpoint
from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import HOUR
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import run_scene

SMALL = {"scene": "williamson6", "ne": 2, "np": 4, "dt": 1800.0, "every": 3.0, "days": 0.5}


def small(**values):
    return run_scene(make_config(SMALL | values))


def go_on(file, **values):
    return run_scene(make_config({"scene": SMALL["scene"], "restart": file, "out": file, **values}))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A finished run."""
    file = tmp_path_factory.mktemp("kept") / "jet.nc"
    assert small(out=file).completed
    return file


@pytest.fixture
def finished(kept, tmp_path):
    """A copy of a finished run."""
    for file in (kept, checkpoint_path(kept)):
        shutil.copy(file, tmp_path)
    return tmp_path / kept.name


# --- what is not replaced


def test_a_finished_run_is_replaced_only_when_asked(finished):
    before = finished.read_bytes()
    with pytest.raises(ConfigError, match=r"holds a finished run of williamson6: .*--overwrite"):
        small(scene="williamson2", out=finished)
    assert finished.read_bytes() == before
    assert small(scene="williamson2", out=finished, overwrite=True).completed
    assert RunFile(finished).attributes["scene"] == "williamson2"


SOURCES = {
    "flow.py": "from swe_sphere.testcases import get_scene\n"
    "def scene():\n    return get_scene('williamson6')\n",
    "flow.toml": 'base = "flow.py"\n',
    "heun.py": "from swe_sphere.steppers.runge_kutta import RungeKutta\n"
    "class Heun(RungeKutta):\n    name, order, a, b = 'heun', 2, ((1.0,),), (0.5, 0.5)\n",
    "own.py": "from swe_sphere.solvers.preconditioners import Preconditioner\n"
    "class Own(Preconditioner):\n    name = 'own'\n    def setup(self, state, tau): pass\n"
    "    def apply(self, r, out): out.assign(r)\n",
    "mean.py": "def mean(frame): return float(frame.h.mean())\n",
    "run.toml": 'stepper = "rk4"\n',
}
"""What a run may read."""


@pytest.mark.parametrize(
    ("written", "asked"),
    [
        ("flow.py", ["flow.py"]),
        ("flow.toml", ["flow.toml"]),
        ("flow.py", ["flow.toml"]),
        ("heun.py", ["williamson6", "--stepper", "heun.py"]),
        ("own.py", ["williamson6", "--stepper", "tr-bdf2", "--preconditioner", "own.py"]),
        ("mean.py", ["williamson6", "--diagnostics", "mean.py"]),
        ("run.toml", ["williamson6", "--config", "run.toml"]),
        ("data.nc", ["williamson7", "--set", "scene.file=data.nc"]),
    ],
)
def test_what_a_run_reads_is_not_replaced(tmp_path, monkeypatch, capsys, written, asked):
    monkeypatch.chdir(tmp_path)
    for name, text in SOURCES.items():
        (tmp_path / name).write_text(text)
    Simulation("williamson2", ne=2, np=4).run(days=0.1, out="run.nc", progress=False)
    with open_run("run.nc") as run:
        run.swe.to_latlon(19, 36).isel(time=-1).rename(h="z").to_netcdf("data.nc")
    before = (tmp_path / written).read_bytes()
    mesh = ["--ne", "2", "--np", "4", "--days", "0.1"]
    with pytest.raises(SystemExit, match="2"):
        main(["run", *asked, *mesh, "--out", written, "--overwrite"])
    assert f"out: {written} is a file that the run reads" in capsys.readouterr().err
    assert (tmp_path / written).read_bytes() == before


def test_a_picture_does_not_replace_what_a_run_reads(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("flow.py").write_text(
        "from dataclasses import replace\nfrom swe_sphere.testcases import get_scene\n"
        "def scene(file='ground.png'):\n"
        "    return replace(get_scene('williamson6'), parameters={'file': file})\n"
    )
    Path("ground.png").write_bytes(b"ground")
    with pytest.raises(ConfigError, match=r"plot: ground.png is a file that the run reads"):
        small(scene="flow.py", plot="ground.png", overwrite=True)
    assert Path("ground.png").read_bytes() == b"ground"


def test_a_further_file_does_not_replace_the_run_that_is_resumed(tmp_path):
    """Even if the resumed run has no file of its own."""
    file = tmp_path / "a.nc"
    Simulation("williamson2", ne=2, np=4, dt=1800.0).run(days=0.125, out=file, progress=False)
    before = file.read_bytes()
    beside = checkpoint_path(file)
    for fields in ({"outputs": [Output(file)]}, {"plot": file}, {"log": beside}):
        with pytest.raises(ConfigError, match="is a file that the run reads"):
            run_scene(make_config({"scene": "williamson2", "restart": file, "days": 0.25,
                                   "overwrite": True} | fields))  # fmt: skip
    assert file.read_bytes() == before


def test_an_unfinished_run_is_to_be_gone_on_with(tmp_path):
    file = tmp_path / "jet.nc"
    unstable = {"scene": "williamson2", "days": 20.0, "dt": 28800.0, "every": 8.0}
    assert not small(**unstable, out=file).completed
    with pytest.raises(ConfigError, match=rf"stopped at day .*resume it \(--restart {file}\)"):
        small(out=file)


@pytest.mark.parametrize("content", [b"", b"my only copy", b"CDF\x02" + bytes(100)])
def test_what_is_no_run_is_not_replaced(tmp_path, content):
    file = tmp_path / "thesis.nc"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"not a complete file of a run: .*--overwrite") as error:
        small(out=file)
    assert "\n" not in str(error.value) and file.read_bytes() == content
    assert small(out=file, overwrite=True).completed


def test_a_checkpoint_without_its_frames_is_not_replaced(finished):
    """A run can go on from it, and may then write where its frames were."""
    finished.unlink()
    kept = checkpoint_path(finished)
    before = kept.read_bytes()
    with pytest.raises(ConfigError, match=r"jet.nc.restart exists already.*--overwrite"):
        small(out=finished)
    assert kept.read_bytes() == before
    onwards = {"scene": SMALL["scene"], "restart": kept, "out": finished, "days": 1.0}
    assert run_scene(make_config(onwards)).completed


def test_the_program_refuses_in_one_line(finished, capsys):
    command = ["run", "williamson2", "--ne=2", "--days=0.1", "--quiet", f"--out={finished}"]
    for flags, status in (([], 2), (["--overwrite"], 0)):
        with pytest.raises(SystemExit) as end:
            main([*command, *flags])
        assert end.value.code == status
        assert capsys.readouterr().err.count("\n") == bool(status)


# --- going on in the same file


def contents(file):
    """Fields by name, and times, of all frames."""
    with xarray.open_dataset(file, decode_times=False) as data:
        names = ("time", "u", "v", "h", "vorticity")
        return {name: data[name].values for name in names if name in data}


@pytest.mark.parametrize("beside", [False, True], ids=["frames", "checkpoint"])
def test_a_run_goes_on_in_its_own_file(finished, tmp_path, beside):
    """Frame by frame as if it had never stopped; the summary is that of the whole."""
    run_id = RunFile(finished).attributes["run_id"]
    file = checkpoint_path(finished) if beside else finished
    longer = run_scene(
        make_config({"scene": "williamson6", "restart": file, "out": finished, "days": 1.0})
    )
    whole = small(days=1.0, out=tmp_path / "whole.nc")
    expected = contents(tmp_path / "whole.nc")
    assert expected["time"].tolist() == [3.0 * HOUR * k for k in range(9)]
    for name, values in contents(finished).items():
        assert values.tobytes() == expected[name].tobytes(), name
    found = RunFile(finished)
    assert found.attributes["run_id"] == run_id == read_checkpoint(finished).attributes["run_id"]
    assert (found.attributes["completed"], found.attributes["days"]) == (True, 1.0)
    for name in ("steps", "rhs_evaluations", "energy_drift"):
        assert longer[name] == whole[name] == found.attributes[name]
    times, series = found.series()
    assert np.all(np.diff(times) > 0.0) and times[-1] == 24.0 * HOUR
    assert np.isfinite(series["energy"]).all()
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "jet.nc", "jet.nc.restart", "whole.nc", "whole.nc.restart"
    ]  # fmt: skip


def test_frames_after_the_checkpoint_are_written_again(finished, tmp_path):
    """As a run leaves them that is killed between a frame and its checkpoint."""
    early = checkpoint_path(finished).read_bytes()
    go_on(finished, days=1.0)
    expected, samples = contents(finished), RunFile(finished).series()[0]
    checkpoint_path(finished).write_bytes(early)
    go_on(finished, days=1.0)
    for name, values in contents(finished).items():
        assert values.tobytes() == expected[name].tobytes(), name
    assert RunFile(finished).series()[0].tolist() == samples.tolist()


def test_a_simulation_goes_on_in_the_file_it_wrote(tmp_path):
    settings = {name: value for name, value in SMALL.items() if name not in ("scene", "days")}
    sim, whole = (Simulation("williamson6", **settings) for _ in range(2))
    file = tmp_path / "jet.nc"
    sim.run(days=0.5, out=file)
    sim.run(days=1.0, out=file)
    whole.run(days=1.0, out=tmp_path / "whole.nc")
    expected = contents(tmp_path / "whole.nc")
    for name, values in contents(file).items():
        assert values.tobytes() == expected[name].tobytes(), name
    with pytest.raises(ConfigError, match="holds a finished run"):
        whole.run(days=1.25, out=file)


def test_a_run_that_resumes_does_not_replace_its_own_file(finished):
    before = finished.read_bytes()
    with pytest.raises(
        ConfigError, match="overwrite: the run resumes in its file: leave overwrite"
    ):
        go_on(finished, days=0.75, overwrite=True)
    assert finished.read_bytes() == before
    go_on(finished, days=0.75)
    assert RunFile(finished).times.tolist() == [k * HOUR for k in (0, 3, 6, 9, 12, 15, 18)]


def test_a_checkpoint_of_another_run_is_refused(finished, tmp_path):
    other = tmp_path / "other.nc"
    small(days=0.25, out=other)
    checkpoint_path(other).replace(checkpoint_path(finished))
    before = finished.read_bytes()
    for file in (finished, checkpoint_path(finished)):
        with pytest.raises(ConfigError, match="checkpoint of another run"):
            run_scene(make_config({"scene": "williamson6", "restart": file, "out": finished}))
    assert finished.read_bytes() == before


def test_a_mistake_leaves_the_file_alone(finished):
    before = finished.read_bytes()
    for values in ({"days": 0.25}, {"days": 1.0, "dt": 900.0}, {"days": 1.0, "scene": "lauter"}):
        with pytest.raises(ConfigError):
            go_on(finished, **values)
    assert finished.read_bytes() == before
    assert json.loads(xarray.open_dataset(finished).attrs["summary"])["completed"] is True


def test_a_run_of_some_fields_goes_on_with_them(tmp_path):
    """And as bitwise as one of all."""
    small(out=tmp_path / "some.nc", fields="u,h")
    go_on(tmp_path / "some.nc", days=0.75)
    small(out=tmp_path / "all.nc", days=0.75)
    found, expected = contents(tmp_path / "some.nc"), contents(tmp_path / "all.nc")
    assert [*found] == ["time", "u", "h"] and found["h"].shape[0] == 7
    for name, values in found.items():
        assert values.tobytes() == expected[name].tobytes(), name
    with pytest.raises(ConfigError, match="unknown field 'w'"):
        small(out=tmp_path / "none.nc", fields=["w"])


@pytest.mark.parametrize("asked", ["restart", "initial", "reference"])
@pytest.mark.parametrize(
    "other", [{"plot": "a.txt"}, {"out": "nowhere/a.nc"}, {"live": "nothing"}, {"out": "old.nc"}]
)
def test_a_missing_file_is_reported_before_other_mistakes(tmp_path, monkeypatch, asked, other):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.nc").write_text("old")
    with pytest.raises(ConfigError, match=r"there is no file .*nosuch\.nc"):
        run_scene(make_config({"scene": "williamson2", asked: "nosuch.nc", **other}))
