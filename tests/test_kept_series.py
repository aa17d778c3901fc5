"""Series of diagnostics in the file of a run are never dropped by a run that resumes in it."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from swe_sphere.analysis.accessor import open_run
from swe_sphere.cli.main import main
from swe_sphere.errors import ConfigError
from swe_sphere.io.runfile import RunFile
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, diagnostic
from swe_sphere.simulation.simulation import Simulation

from .support import thorough

NUMBER = """
from swe_sphere import diagnostic
@diagnostic(units="m")
def deepest(sim):
    "largest depth"
    return sim.state.h.max()
"""
FIELD = (
    NUMBER
    + """
@diagnostic(units="m")
def twice(sim):
    return 2.0 * sim.state.h.values
"""
)


@pytest.fixture(autouse=True)
def none_left():
    DIAGNOSTICS.clear()
    yield
    DIAGNOSTICS.clear()


def command(*words):
    DIAGNOSTICS.clear()
    with pytest.raises(SystemExit) as end:
        main([*map(str, words)])
    return end.value.code


@pytest.mark.parametrize("source", [NUMBER, FIELD])
def test_the_printed_command_keeps_recorded_diagnostics(tmp_path, monkeypatch, capsys, source):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d.py").write_text(source)
    words = ["run", "williamson2", "--ne=2", "--np=4", "--dt=1800", "--days=0.5", "--every=3"]
    words += ["--diagnostics", "d.py", "--out"]
    assert command(*words, "whole.nc") == 0
    assert command(*words, "run.nc", "--time-limit=1e-9") == 1
    printed = capsys.readouterr().err.partition("resume with: swe-sphere ")[2].splitlines()[0]
    assert command(*shlex.split(printed)) == 0
    ours, right = open_run("run.nc"), open_run("whole.nc")
    assert ours.deepest.attrs == right.deepest.attrs
    for name in ("time", "h", "deepest", *(["twice"] if source == FIELD else [])):
        assert name in ours and np.array_equal(ours[name][-1], right[name][-1])
    assert np.isfinite(ours.deepest).all()


OWN = """
from swe_sphere.solvers.preconditioners.block_elimination import Helmholtz

class Mine(Helmholtz):
    name = "mine"
"""


def test_the_printed_command_repeats_the_reference_and_trusts_the_run_s_files(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Simulation("williamson2", ne=2, np=4, days=0.5).run(out="first.nc")
    with open_run("first.nc") as data:
        data.swe.to_latlon(19, 36).isel(time=-1).to_netcdf("reference.nc")
    Path("own.py").write_text(OWN)
    words = ["run", "williamson2", "--ne=2", "--np=4", "--dt=1800", "--days=0.5", "--out=run.nc"]
    words += ["--stepper=tr-bdf2", "--reference=reference.nc"]
    assert command(*words, "--set", "stepper.preconditioner=own.py", "--time-limit=1e-9") == 1
    printed = capsys.readouterr().err.partition("resume with: swe-sphere ")[2].splitlines()[0]
    assert command(*shlex.split(printed), "--json") == 0
    assert "l2_h" in json.loads(capsys.readouterr().out)


def test_a_resume_without_the_file_of_a_diagnostic_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d.py").write_text(NUMBER)
    words = ["run", "williamson2", "--ne=2", "--np=4", "--dt=1800", "--days=0.25", "--out=run.nc"]
    assert command(*words, "--diagnostics=d.py") == 0
    before = (tmp_path / "run.nc").read_bytes()
    again = ["run", "williamson2", "--restart=run.nc", "--out=run.nc", "--days=0.5"]
    assert command(*again) == 2
    assert "names the file d.py, whose code would be executed" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=r"names the file d\.py"):
        Simulation.from_checkpoint("run.nc")
    (tmp_path / "d.py").write_text(NUMBER + "# edited\n")
    assert command(*again, "--trust=d.py") == 2
    assert "d.py has been edited since run.nc was begun: give it again" in capsys.readouterr().err
    assert (tmp_path / "run.nc").read_bytes() == before
    (tmp_path / "d.py").write_text(NUMBER)
    assert command(*again, "--trust=d.py") == 0
    assert np.isfinite(open_run("run.nc").deepest).all()
    (tmp_path / "d.py").write_text(NUMBER + "# edited\n")
    assert command(*again[:-1], "--days=0.75", "--diagnostics=d.py") == 0
    assert np.isfinite(open_run("run.nc").deepest).all()
    (tmp_path / "d.py").unlink()
    assert command(*again[:-1], "--days=1", "--trust=d.py") == 2
    assert "there is no file d.py" in capsys.readouterr().err
    (tmp_path / "more.py").write_text(NUMBER.replace("deepest", "other"))
    assert command(*again[:-1], "--days=1", "--diagnostics=more.py") == 0
    run = open_run("run.nc")
    assert np.isfinite(run.deepest[0]) and np.isnan(run.deepest[-1])
    assert np.isnan(run.other[0]) and np.isfinite(run.other[-1])


@pytest.mark.parametrize("form", ["nc", thorough("zarr")])
def test_the_series_of_a_diagnostic_that_is_gone_stays_in_the_file(tmp_path, form):
    pytest.importorskip("zarr")
    out = tmp_path / f"run.{form}"
    diagnostic(name="jet", units="m s-1")(lambda sim: float(sim.state.u.max()))
    Simulation("williamson2", ne=2, np=4, dt=1800.0).run(days=0.25, out=out)
    DIAGNOSTICS.clear()
    Simulation.from_checkpoint(out).run(days=0.5, out=out)
    jet = open_run(out).jet
    early = slice(np.count_nonzero(jet.diagnostic_time < 0.25 * 86400.0))
    assert early.stop > 3 and np.isfinite(jet[early]).all() and np.isnan(jet[-1])
    assert jet.attrs["units"] == "m s-1"
    Simulation.from_checkpoint(out).run(days=0.75, out=out)
    assert np.array_equal(open_run(out).jet[early], jet[early])


def test_a_spoilt_state_does_not_replace_the_last_good_frame(tmp_path):
    out = tmp_path / "run.nc"
    sim = Simulation("williamson2", ne=2, np=4, dt=1800.0)
    sim.run(days=0.25, out=out)
    restart = out.with_name("run.nc.restart")
    before = [out.read_bytes(), restart.read_bytes()]
    sim.stepper.state.fill_(np.nan)
    ended = sim.run(days=0.5, out=out)
    assert ended.status == "unstable" and "NaN" in ended.reason
    assert [out.read_bytes(), restart.read_bytes()] == before
    assert np.isfinite(RunFile(out).frame()["h"]).all()
    assert Simulation.from_checkpoint(out).run(days=0.5, out=out).completed


@pytest.mark.parametrize("out", ["run.nc", "new.nc"])
@pytest.mark.parametrize("source", [NUMBER, FIELD])
def test_a_resumed_run_reports_diagnostics_that_it_does_not_compute(
    tmp_path, monkeypatch, capsys, source, out
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d.py").write_text(source)
    (tmp_path / "e.py").write_text(NUMBER.replace("deepest", "other"))
    words = ["run", "williamson2", "--ne=2", "--np=4", "--dt=1800"]
    assert command(*words, "--days=0.25", "--diagnostics=d.py", "--out=run.nc") == 0
    capsys.readouterr()
    resumed = ["run", "williamson2", "--restart=run.nc", "--days=0.5", f"--out={out}"]
    status = command(*resumed, "--diagnostics=e.py")
    told = capsys.readouterr().err
    lost = "deepest, twice" if source == FIELD else "deepest"
    assert f"the run in run.nc has diagnostics that are not computed any more: {lost};" in told
    # frames of one file hold the same fields
    assert status == (2 if (source, out) == (FIELD, "run.nc") else 0)
    if status:
        assert "its frames hold other fields" in told
    if out == "new.nc":
        assert command(*resumed[:-1], "--out=whole.nc", "--diagnostics=d.py") == 0
        assert "not computed any more" not in capsys.readouterr().err


def test_damaged_names_of_diagnostics_do_not_matter(tmp_path):
    sim = Simulation("williamson2", ne=2, np=4, dt=1800.0)
    sim.run(days=0.25)
    for damaged in ("[1", "[]", "3", 7):
        resumed = Simulation.from_checkpoint(sim.checkpoint(tmp_path / "a.npz"))
        resumed._restart.attributes["user_diagnostics"] = damaged
        assert resumed.run(days=0.5).status == "completed"
