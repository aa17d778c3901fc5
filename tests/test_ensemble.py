"""Ensembles of perturbed seeds: what is kept, and how fast the spread of the unstable jet grows."""

import json
import os
import signal

import numpy as np
import pandas as pd
import pytest
from netCDF4 import Dataset

from swe_sphere.cli.main import main
from swe_sphere.equations.scene import Array
from swe_sphere.errors import ConfigError, Interrupted, RunFailed
from swe_sphere.io.runfile import RunFile
from swe_sphere.planet import DAY, EARTH
from swe_sphere.simulation.config import make_config
from swe_sphere.studies.ensemble import run_members, spread, write_spread
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.harmonics import legendre
from swe_sphere.testcases.jets import JET

SMALL = {"scene": "galewsky", "ne": 2, "np": 4, "days": 0.1, "dt": 600.0}


WINDS = """from dataclasses import replace
from swe_sphere.testcases import get_scene
def scene(seed: int = 0):
    base = get_scene("williamson5")
    def initial(lon, lat):
        u, v, h = base.initial(lon, lat)
        return (1.0 + 0.01 * seed) * u, v, h
    return replace(base, name="winds", initial=initial)
"""
"""Scene file: the seeds change only the wind, over a mountain."""


def growth(m: int, degree: int) -> float:
    """Of the fastest wave of zonal wavenumber m on the jet [day-1], by linear theory.

    Eigenvalues of the shallow-water equations linearised about the zonal flow, in coefficients of
    vorticity, divergence and depth by associated Legendre functions, with Gauss quadrature:

        ∂ζ'/∂t = -∇·F,  ∂δ'/∂t = k·∇×F - ∇²(u u' + g h'),  ∂h'/∂t = -∇·(h' u, 0) - ∇·(H v'),

    where F = ζ' (u, 0) + (ζ + f) v'.
    """
    a, (sine, weights) = EARTH.radius, np.polynomial.legendre.leggauss(3 * degree // 2)
    lat = np.arcsin(sine)
    u, _, depth = (x[:, None] for x in get_scene("galewsky", perturbed=False).initial(0 * lat, lat))
    step = 1e-4
    shear = np.diff([JET(lat + s) * np.cos(lat + s) for s in (-step, step)], axis=0)[0] / (2 * step)
    absolute = (2.0 * EARTH.rotation * sine - shear / (a * np.cos(lat)))[:, None]
    value, over_cos, slope = list(zip(range(m + 1), legendre(degree, lat), strict=False))[m][1]
    laplacian = -np.arange(m, degree + 1) * np.arange(m + 1, degree + 2) / a**2
    along, across = (x.T / laplacian / a for x in (1j * m * over_cos, slope))
    none = 0.0 * across
    east, north = np.hstack([-across, along, none]), np.hstack([along, across, none])
    vorticity, h = np.hstack([value.T, none, none]), np.hstack([none, none, value.T])

    def mean(of: Array, field: Array) -> Array:
        return 0.5 * (weights * of) @ field

    def divergence(x: Array, y: Array) -> Array:
        return -(mean(-1j * m * over_cos, x) + mean(slope, y)) / a

    fluxes = u * vorticity + absolute * east, absolute * north
    energy = laplacian[:, None] * mean(value, u * east + EARTH.gravity * h)
    tendency = np.vstack([
        -divergence(*fluxes), divergence(fluxes[1], -fluxes[0]) - energy,
        -divergence(u * h + depth * east, depth * north),
    ])  # fmt: skip
    return float(np.linalg.eigvals(tendency).real.max() * DAY)


@pytest.mark.thorough
def test_the_spread_of_the_jet_grows_as_its_fastest_wave(tmp_path, capsys):
    """Small noise on the jet alone; on day 3 other waves still take a few per cent of the rate."""
    arguments = (
        "ensemble galewsky --seeds 1,2 --ne 8 --np 6 --days 3 --every 24"
        " --set scene.perturbed=false --set scene.noise=1e-3 --out"
    )
    with pytest.raises(SystemExit, match="0"):
        main([*arguments.split(), str(tmp_path)])
    assert "growth" in capsys.readouterr().out
    table = np.genfromtxt(tmp_path / "spread_vorticity.csv", delimiter=",", skip_header=1)
    fastest = growth(7, 80)
    assert table[-1, 0] == 3.0 and 0.9 * fastest < table[-1, 2] < 1.02 * fastest
    assert (tmp_path / "spread_vorticity.png").stat().st_size > 5_000


def test_a_spread_is_that_of_the_members(tmp_path):
    told: list[str] = []
    files = run_members(make_config(SMALL), (1, 2, 3), tmp_path, told.append)
    found = spread(files, "u")
    scenes = [get_scene("galewsky", seed=seed) for seed in (1, 2, 3)]
    mesh = RunFile(files[0]).mesh
    winds = np.array([scene.initial(mesh.lon, mesh.lat)[0] for scene in scenes])
    square = np.average(((winds - winds.mean(axis=0)) ** 2).sum(axis=0) / 2.0, weights=mesh.area)
    assert found["spread"][0] == pytest.approx(np.sqrt(square), rel=1e-9)
    assert found["spread"][0] == pytest.approx(0.1 / np.sqrt(2.0), rel=0.5)
    rate = np.log(found["spread"][1] / found["spread"][0]) / (found["day"][1] - found["day"][0])
    assert np.isnan(found["growth"][0]) and found["growth"][1] == pytest.approx(rate, rel=1e-9)
    before = [file.stat().st_mtime_ns for file in files]
    run_members(make_config(SMALL), (1, 2, 3), tmp_path, told.append)
    assert [file.stat().st_mtime_ns for file in files] == before
    assert all("kept" in line for line in told[3:]) and len(told) == 6
    for changes in ({"days": 0.5 * SMALL["days"]}, {"dt": 720.0}):
        with pytest.raises(ConfigError, match="holds a finished run"):
            run_members(make_config(SMALL | changes), (1, 2), tmp_path, told.append)
    files += run_members(make_config(SMALL | {"ne": 3}), (4, 5), tmp_path, told.append)
    with pytest.raises(ConfigError, match=r"seed4\.nc has another mesh or other times than"):
        spread(files)


def test_an_ensemble_grows_in_days_and_seeds_and_another_time_limit_is_the_same_run(tmp_path):
    told: list[str] = []
    asked = SMALL | {"every": 1.2, "dt": 1440.0}
    few = asked | {"days": 0.05, "time_limit": 1e6}
    run_members(make_config(few), (1, 2), tmp_path, told.append)
    before = (tmp_path / "galewsky_seed1.nc").stat().st_mtime_ns
    run_members(make_config(few | {"time_limit": 2e6}), (1, 2, 3), tmp_path, told.append)
    assert [": kept, " in line for line in told] == [False, False, True, True, False]
    assert (tmp_path / "galewsky_seed1.nc").stat().st_mtime_ns == before
    files = run_members(make_config(asked | {"days": 0.1}), (1, 2, 3), tmp_path, told.append)
    for file in files:  # frames of the first half are kept, and the second is what it would be
        assert RunFile(file).times.tolist() == [4320.0 * k for k in range(3)]
    whole = run_members(make_config(asked | {"days": 0.1}), (1, 2), tmp_path / "whole", print)
    for file, right in zip(files, whole, strict=False):
        ours, theirs = (RunFile(each).frame()["h"] for each in (file, right))
        assert np.array_equal(ours, theirs)


def test_a_member_of_no_days_is_not_kept_as_one_of_the_days_of_the_scene(tmp_path):
    told: list[str] = []
    run_members(make_config(SMALL | {"days": 0}), (1, 2), tmp_path, told.append)
    whole = {name: value for name, value in SMALL.items() if name != "days"}
    with pytest.raises(RunFailed, match="the same command resumes it"):
        run_members(make_config(whole | {"time_limit": 1e-9}), (1, 2), tmp_path, told.append)
    assert not any(": kept, " in line for line in told)


@pytest.mark.thorough
def test_a_member_that_took_too_long_is_resumed_from_where_it_was(tmp_path, monkeypatch):
    """So that a member longer than the limit is finished by some number of commands."""
    asked = SMALL | {"every": 0.4, "dt": 480.0, "days": 0.1, "time_limit": 1e-9}
    reached, told = [], []
    for _ in range(40):
        with pytest.raises(RunFailed, match="the same command resumes it") as failed:
            run_members(make_config(asked), (1, 2), tmp_path, told.append)
        reached.append(RunFile(tmp_path / "galewsky_seed1.nc").frame_time(None))
        if "seed 2" in str(failed.value):
            break
    assert reached == sorted(reached) and reached[0] == 480.0 and reached[-1] == 8640.0
    asked["time_limit"] = None
    run_members(make_config(asked), (1, 2), tmp_path, told.append)
    assert ": kept, " in told[-2]


def test_members_of_other_code_or_of_an_edited_scene_are_not_kept(tmp_path, monkeypatch):
    scene = tmp_path / "mine.toml"
    scene.write_text('base = "galewsky"\n')
    asked = make_config(SMALL | {"scene": str(scene)})
    run_members(asked, (1, 2), tmp_path, print)
    with monkeypatch.context() as edited:
        edited.setattr("swe_sphere.studies.ensemble.code_fingerprint", lambda: "other")
        with pytest.raises(ConfigError, match=r"seed1\.nc was made by other code.*--overwrite"):
            run_members(asked, (1, 2), tmp_path, print)
    scene.write_text('base = "galewsky"\n[effects]\nviscosity = { nu = 1e5 }\n')
    with pytest.raises(ConfigError, match="or from files that have been edited since"):
        run_members(asked, (1, 2), tmp_path, print)
    told: list[str] = []
    run_members(asked.model_copy(update={"overwrite": True}), (1, 2), tmp_path, told.append)
    assert not any("kept" in line for line in told)
    run_members(asked, (1, 2), tmp_path, told.append)
    assert all("kept" in line for line in told[2:])


def test_a_member_whose_file_does_not_say_its_length_is_not_kept(tmp_path):
    (file, _) = run_members(make_config(SMALL), (1, 2), tmp_path, print)
    with Dataset(file, "a") as altered:
        altered.configuration = json.dumps(json.loads(altered.configuration) | {"days": "long"})
    with pytest.raises(ConfigError, match="holds a finished run"):
        run_members(make_config(SMALL), (1, 2), tmp_path, print)


@pytest.mark.parametrize(
    ("values", "seeds", "error", "message"),
    [
        ({}, (1,), ConfigError, "give 2 to 1000 different numbers, got 1"),
        ({}, (1, 1), ConfigError, "different numbers, got 1,1"),
        ({}, (-1, 1), ConfigError, "scene.seed must not be negative, got -1"),
        ({"scene": "williamson2"}, (1, 2), ConfigError, "has no parameter 'seed'"),
        ({"dt": 20000.0, "days": 5.0}, (1, 2), RunFailed, "seed 1: "),
    ],
)
def test_what_is_no_ensemble(tmp_path, values, seeds, error, message):
    with pytest.raises(error, match=message):
        run_members(make_config(SMALL | values), seeds, tmp_path, lambda _: None)


def test_equal_values_have_no_spread(tmp_path):
    """Round-off of a variance is none: three members over a mountain, which the seeds leave."""
    (tmp_path / "winds.py").write_text(WINDS)
    asked = make_config(SMALL | {"scene": str(tmp_path / "winds.py")})
    files = run_members(asked, (1, 2, 3), tmp_path, lambda _: None)
    with pytest.raises(ConfigError, match="field b: it is the same in all members"):
        spread(files, "b")
    found = spread(files, "h")
    assert found["spread"][0] == 0.0 and found["spread"][1] > 0.0 and found["growth"].isna().all()


def test_a_frame_without_spread_is_left_out_of_the_picture(tmp_path, capsys):
    (tmp_path / "winds.py").write_text(WINDS)
    line = ["ensemble", str(tmp_path / "winds.py"), "--ne", "2", "--np", "4", "--dt", "600"]
    line += ["--days", "0.2", "--every", "1.6", "--seeds", "1-3", "--field", "h"]
    with pytest.raises(SystemExit, match="0"):
        main([*line, "--out", str(tmp_path / "a")])
    assert "0           0  –" in capsys.readouterr().out
    table = np.genfromtxt(tmp_path / "a" / "spread_h.csv", delimiter=",", skip_header=1)
    assert len(table) == 4 and table[0, 1] == 0.0 and np.isnan(table[:2, 2]).all()
    assert np.isfinite(table[2:]).all()
    assert (tmp_path / "a" / "spread_h.png").stat().st_size > 5_000


def test_the_table_has_the_units_of_a_custom_field(tmp_path):
    own = tmp_path / "own.py"
    own.write_text(
        "from swe_sphere.simulation.diagnostics import diagnostic\n"
        "@diagnostic(units='m2')\n"
        "def squared(sim):\n"
        "    return sim.snapshot.fields['h'] ** 2\n"
    )
    line = ["ensemble", "galewsky", "--ne", "2", "--np", "4", "--days", "0.05", "--seeds", "1,2"]
    with pytest.raises(SystemExit, match="0"):
        main([*line, "--diagnostics", str(own), "--field", "squared", "--out", str(tmp_path / "a")])
    assert (tmp_path / "a" / "spread_squared.csv").read_text().startswith("day,spread [m²],")


def test_a_spread_of_zero_is_drawn_and_the_table_is_written_before_the_picture(
    tmp_path, monkeypatch
):
    table = pd.DataFrame({"day": [0.0, 1.0], "spread": 0.0, "growth": np.nan})
    files = write_spread(table, "h", tmp_path)
    assert files[1].stat().st_size > 5_000
    text = files[0].read_text()
    files[0].unlink()
    monkeypatch.setattr("swe_sphere.studies.ensemble.draw_panel", None)
    with pytest.raises(TypeError):
        write_spread(table, "h", tmp_path)
    assert files[0].read_text() == text


@pytest.mark.parametrize("name", ["spread_h.csv", "spread_h.png"])
def test_a_table_or_picture_of_somebody_else_is_not_replaced(tmp_path, capsys, name):
    line = ["ensemble", "galewsky", "--ne", "2", "--np", "4", "--dt", "600", "--days", "0.1"]
    line += ["--seeds", "1,2", "--field", "h", "--out", str(tmp_path)]
    (tmp_path / name).write_text("mine")
    with pytest.raises(SystemExit, match="2"):
        main(line)
    err = capsys.readouterr().err
    assert f"{name} is not of an ensemble, and would be replaced" in err and err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]
    for more in (["--overwrite"], []):
        with pytest.raises(SystemExit, match="0"):
            main([*line, *more])
    assert len([*tmp_path.glob("spread_h.*")]) == 2


def test_seeds_that_are_none(tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["ensemble", "galewsky", "--seeds", "1-x", "--out", str(tmp_path)])
    assert "seeds: give whole numbers, 1,2,3 or 1-8, got '1-x'" in capsys.readouterr().err


def test_a_moved_folder_keeps_its_members(tmp_path):
    told = []
    run_members(make_config(SMALL), [1, 2], tmp_path / "here", told.append)
    (tmp_path / "here").rename(tmp_path / "there")
    run_members(make_config(SMALL), [1, 2], tmp_path / "there", told.append)
    assert [": kept, " in line for line in told] == [False, False, True, True]


def test_ctrl_c_ends_an_ensemble_with_130_and_the_same_command_goes_on(tmp_path, capsys):
    from swe_sphere.simulation.loop import Interruption

    line = ["ensemble", "galewsky", "--ne", "2", "--np", "4", "--dt", "600", "--days", "0.1"]
    line += ["--seeds", "1,2", "--out", str(tmp_path / "members")]
    with pytest.MonkeyPatch.context() as patch:
        told = property(lambda _: "Ctrl-C", lambda *_: None)
        patch.setattr(Interruption, "received", told, raising=False)
        with pytest.raises(SystemExit) as ended:
            main(line)
    assert ended.value.code == 130 and "the same command runs the others" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(line)
    told = capsys.readouterr()
    assert (ended.value.code, told.err) == (0, "")
    times = [*RunFile(tmp_path / "members" / "galewsky_seed1.nc").times]
    assert times == [0.0, 576.0, 8640.0]  # it was resumed after its first step


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--field", "b"], "it is the same in all members"),
        (["--fields", "h,u"], "the field 'vorticity' is missing; there are h, u, b"),
        (["--seeds", "1-2000000000"], "give 2 to 1000 different numbers"),
        (["--seeds", "1-1000000000000000000000"], "seeds: give 2 to 1000 different numbers"),
        (["--set", "scene.seed=4"], "scene.seed differs between members: set it with seeds"),
    ],
)
def test_an_ensemble_that_comes_to_nothing_is_one_line(tmp_path, capsys, more, said):
    line = ["ensemble", "galewsky", "--ne", "2", "--np", "4", "--dt", "600", "--days", "0.1"]
    with pytest.raises(SystemExit) as ended:
        main([*line, "--seeds", "1,2", "--out", str(tmp_path / "a"), *more])
    told = capsys.readouterr().err
    assert ended.value.code == 2 and said in told and told.count("\n") == 1
    assert (tmp_path / "a").exists() == (more == ["--field", "b"])  # what cannot be is told at once


def test_a_folder_that_is_a_file_is_one_line(tmp_path, capsys):
    (tmp_path / "a").write_text("")
    with pytest.raises(SystemExit) as ended:
        main(["ensemble", "galewsky", "--ne", "2", "--out", str(tmp_path / "a")])
    assert ended.value.code == 2 and "cannot write to" in capsys.readouterr().err


def test_a_signal_in_the_last_step_of_a_member_ends_the_ensemble(tmp_path, monkeypatch):
    from swe_sphere.simulation.simulation import Simulation

    take = Simulation.take

    def interrupted(sim, most):
        take(sim, most)
        if sim.steps == sim.plan.steps:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(Simulation, "take", interrupted)
    config = make_config({"scene": "turbulence", "ne": 2, "np": 4, "days": 0.05, "dt": 864.0})
    with pytest.raises(Interrupted, match="SIGTERM"):
        run_members(config, [1, 2], tmp_path, lambda line: None)
    assert RunFile(tmp_path / "turbulence_seed1.nc").attributes["completed"]
    assert not (tmp_path / "turbulence_seed2.nc").exists()
