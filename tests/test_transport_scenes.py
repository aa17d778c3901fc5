"""Moving vortices and deformational flow: formulas, and the model against other answers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swe_sphere.equations.effects import Relaxation
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene
from swe_sphere.errors import ConfigError
from swe_sphere.io.integrals import norms
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.planet import DAY, EARTH
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.simulation import Simulation, run_scene
from swe_sphere.steppers import STEPPERS
from swe_sphere.studies.sweep.runs import Study
from swe_sphere.studies.sweep.sweep_plan import make_plan
from swe_sphere.testcases import get_scene

CASES = (1, 2, 3, 4)
A = EARTH.radius


def somewhere(count=60, seed=1):
    """Points away from the poles, where angles are awkward."""
    random = np.random.default_rng(seed)
    return random.uniform(0.0, 2.0 * np.pi, count), np.arcsin(random.uniform(-0.95, 0.95, count))


def slopes(formula, lon, lat):
    """Central differences by lon and lat."""
    e = 1e-4
    by_lon = (formula(lon + e, lat) - formula(lon - e, lat)) / (2.0 * e)
    return by_lon, (formula(lon, lat + e) - formula(lon, lat - e)) / (2.0 * e)


def wind_divergence(scene, lon, lat, t):
    east, _ = slopes(lambda x, y: scene.wind(x, y, t)[0], lon, lat)
    _, north = slopes(lambda x, y: scene.wind(x, y, t)[1] * np.cos(y), lon, lat)
    return (east + north) / (A * np.cos(lat))


@pytest.mark.parametrize("alpha", [0.0, 0.25 * np.pi, 1.2])
@pytest.mark.parametrize("day", [0.0, 3.7, 12.0])
def test_the_front_of_the_moving_vortices_is_carried_by_their_wind(alpha, day):
    scene, t, dt = get_scene("moving-vortices", alpha=alpha), day * DAY, 20.0
    lon, lat = somewhere()
    u, v = scene.wind(lon, lat, t)
    now = (scene.exact(lon, lat, t + dt)[2] - scene.exact(lon, lat, t - dt)[2]) / (2.0 * dt)
    by_lon, by_lat = slopes(lambda x, y: scene.exact(x, y, t)[2], lon, lat)
    along = u / (A * np.cos(lat)) * by_lon + v / A * by_lat
    assert np.abs(now + along).max() < 1e-4 * np.abs(along).max()
    assert np.abs(wind_divergence(scene, lon, lat, t)).max() < 1e-6 * np.hypot(u, v).max() / A


def test_the_vortices_turn_once_and_are_where_they_began():
    scene, centre = get_scene("moving-vortices"), (np.array([1.5 * np.pi]), np.array([0.0]))
    for t in (0.0, 12.0 * DAY):
        assert scene.exact(*centre, t)[2] == pytest.approx(1000.0)
        speed = np.hypot(*scene.wind(*centre, t))
        assert speed == pytest.approx(2.0 * np.pi * A / (12.0 * DAY))  # the background alone
    lon, lat = somewhere()
    assert scene.wind(lon, lat, 0.0)[0] == pytest.approx(scene.wind(lon, lat, 12.0 * DAY)[0])


@pytest.mark.parametrize("case", CASES)
def test_only_case_3_diverges(case):
    scene = get_scene("deformational", case=case)
    lon, lat = somewhere()
    divergence = np.abs(wind_divergence(scene, lon, lat, 2.0 * DAY)).max() * A
    largest = np.hypot(*scene.wind(lon, lat, 2.0 * DAY)).max()
    assert (divergence > 0.1 * largest) if case == 3 else (divergence < 1e-5 * largest)


def test_the_wind_turns_round_at_half_time():
    lon, lat = somewhere()
    for case in (1, 2, 3):
        u, _ = get_scene("deformational", case=case).wind(lon, lat, 2.0 * DAY)
        back, _ = get_scene("deformational", case=case).wind(lon, lat, 10.0 * DAY)
        assert back == pytest.approx(-u)
    u, v = get_scene("deformational", case=4).wind(lon, lat, 6.0 * DAY)
    assert u == pytest.approx(2.0 * np.pi * A / (12.0 * DAY) * np.cos(lat))
    assert v == pytest.approx(0.0 * v, abs=1e-12)


def test_the_deformation_is_as_strong_as_published():
    """Winds in units of a/T at points where all factors but the strength are 1."""
    unit, eighth, start = A / (12.0 * DAY), np.array([0.25 * np.pi]), 0.0
    winds = {case: get_scene("deformational", case=case).wind for case in CASES}
    half, quarter, none = (np.array([x * np.pi]) for x in (1.0, 0.5, 0.0))
    assert winds[1](half, eighth, start)[0] == pytest.approx(12.0 * unit)
    assert winds[1](quarter, none, start)[1] == pytest.approx(6.0 * unit)
    assert winds[2](quarter, eighth, start)[0] == pytest.approx(10.0 * unit)
    assert winds[2](0.5 * quarter, none, start)[1] == pytest.approx(10.0 * unit)
    assert winds[3](half, eighth, start)[0] == pytest.approx(-2.5 * unit)
    assert winds[3](quarter, none, start)[1] == pytest.approx(2.5 * unit)
    turning = 10.0 + 2.0 * np.pi * np.sqrt(0.5)
    assert winds[4](quarter, eighth, start)[0] == pytest.approx(turning * unit)
    assert winds[4](0.5 * quarter, none, start)[1] == pytest.approx(10.0 * unit)


def test_tracers_of_the_deformational_flow():
    tracers = get_scene("deformational", case=4).tracers
    lon, lat = np.array([5.0, 7.0, 0.0]) * np.pi / 6.0, np.zeros(3)
    values = {name: formula(lon, lat) for name, formula in tracers.items()}
    between = 0.95 * np.exp(-5.0 * (2.0 * np.sin(np.pi / 6.0)) ** 2)
    assert values["gaussian_hills"][:2] == pytest.approx(0.95 + between)
    assert values["cosine_bells"] == pytest.approx([1.0, 1.0, 0.1])
    assert values["correlated"] == pytest.approx([0.1, 0.1, 0.892])
    assert values["slotted_cylinders"] == pytest.approx([0.1, 0.1, 0.1])  # the slots
    north, south = (tracers["slotted_cylinders"](lon, lat + side) for side in (0.3, -0.3))
    assert north == pytest.approx([0.1, 1.0, 0.1])
    assert south == pytest.approx([1.0, 0.1, 0.1])


@pytest.mark.parametrize("case", CASES)
def test_tracers_are_the_same_at_longitudes_west_of_greenwich(case):
    lon, lat = np.meshgrid(np.linspace(-np.pi, np.pi, 181), np.linspace(-1.4, 1.4, 57))
    for name, formula in get_scene("deformational", case=case).tracers.items():
        there = formula(np.mod(lon, 2.0 * np.pi), lat)
        np.testing.assert_allclose(formula(lon, lat), there, rtol=0.0, atol=1e-12, err_msg=name)


def test_the_answer_is_known_only_when_all_is_back():
    scene, (lon, lat) = get_scene("deformational", case=3), somewhere()
    assert np.isnan(scene.exact_tracers(lon, lat, 3.0 * DAY)["cosine_bells"]).all()
    assert np.isnan(scene.exact(lon, lat, 3.0 * DAY)[2]).all()
    assert not np.isnan(scene.exact(lon, lat, 3.0 * DAY)[0]).any()
    back = scene.exact_tracers(lon, lat, 12.0 * DAY)
    assert np.array_equal(back["cosine_bells"], scene.tracers["cosine_bells"](lon, lat))
    assert scene.exact(lon, lat, 12.0 * DAY)[2] == pytest.approx(1000.0)
    assert get_scene("deformational", case=1).exact(lon, lat, 3.0 * DAY)[2] == pytest.approx(1000.0)


def test_there_is_no_case_5():
    with pytest.raises(ConfigError, match="case"):
        get_scene("deformational", case=5)


def departure(scene, lon, lat, t):
    """Where the air at lon, lat and time t came from: trajectories by scipy."""

    def back(s, place):
        x, y = place.reshape(2, -1)
        u, v = scene.wind(x, y, t - s)
        return -np.concatenate([u / (A * np.cos(y)), v / A])

    start = np.concatenate([lon, lat])
    return solve_ivp(back, (0.0, t), start, rtol=1e-8, atol=1e-9).y[:, -1].reshape(2, -1)


def stepped(scene, mesh, dt, days, stepper="rk4"):
    model = Model(mesh, scene)
    stepping = STEPPERS[stepper](model, dt)
    stepping.start(model.initial_state())
    for _ in range(round(days * DAY / dt)):
        stepping.step()
    return model.fields(stepping.state, days * DAY)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.thorough
def test_filaments_are_where_trajectories_put_them(case):
    scene, mesh, days = get_scene("deformational", case=case), Mesh.build(5, 8), 3.0
    fields = stepped(scene, mesh, 1200.0, days)
    lon, lat = somewhere(80)
    exact = scene.tracers["gaussian_hills"](*departure(scene, lon, lat, days * DAY))
    q = Interpolator(mesh, lon, lat)(fields["q_gaussian_hills"])
    assert np.abs(q - exact).max() < {1: 8e-3, 2: 5e-3, 3: 2e-3, 4: 8e-3}[case]
    assert np.abs(scene.tracers["gaussian_hills"](lon, lat) - exact).max() > 0.3


def error_of_vortices(ne, np_, dt, days):
    scene, mesh = get_scene("moving-vortices"), Mesh.build(ne, np_)
    fields = stepped(scene, mesh, dt, days)
    return norms(mesh.area, fields["h"], scene.exact(mesh.lon, mesh.lat, days * DAY)[2])


@pytest.mark.thorough
def test_moving_vortices_converge():
    errors = [error_of_vortices(ne, 6, 4800.0 / ne, 3.0)["l2"] for ne in (4, 8)]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] > 2.0**4.2


def test_an_implicit_stepper_carries_the_vortices_as_well():
    scene, mesh = get_scene("moving-vortices"), Mesh.build(5, 4)
    exact = scene.exact(mesh.lon, mesh.lat, 2.0 * DAY)[2]
    results = {name: stepped(scene, mesh, 1800.0, 2.0, name)["h"] for name in ("rk4", "sdirk3")}
    error = norms(mesh.area, results["rk4"], exact)["l2"]
    assert norms(mesh.area, results["sdirk3"], results["rk4"])["l2"] < 0.2 * error


SETTINGS = {"scene": "deformational", "ne": 3, "np": 4, "dt": 3600.0, "every": 12.0, "quiet": True}


def test_numbers_and_files_of_a_run_with_tracers(tmp_path):
    path = tmp_path / "run.nc"
    settings = ("scene.case=2", "tracers.limiter=true")
    summary = run_scene(make_config({**SETTINGS, "days": 1.0, "out": path, "settings": settings}))
    numbers = json.loads(summary.as_json())
    assert numbers["completed"] is True
    assert numbers["l2_q_gaussian_hills"] is None  # not back yet
    assert abs(numbers["mass_drift_q_cosine_bells"]) < 1e-13
    assert 0.1 - 1e-14 < numbers["min_q_slotted_cylinders"] < numbers["max_q_slotted_cylinders"]
    assert numbers["max_q_slotted_cylinders"] < 1.0 + 1e-14
    with netCDF4.Dataset(path) as file:
        assert file["q_correlated"].dimensions == ("time", "node")
        assert file["q_correlated"].units == "1"
        first, last = (file["l2_q_gaussian_hills"][k] for k in (0, -1))
        assert first < 1e-15
        assert np.ma.is_masked(last) or np.isnan(last)
        assert file["q_correlated"][-1].max() < 0.9
        assert file.plot_field == "q_gaussian_hills"


def test_errors_are_told_when_all_is_back():
    summary = run_scene(make_config({**SETTINGS, "days": 12.0, "settings": ("scene.case=3",)}))
    assert 0.0 < summary["l2_q_gaussian_hills"] < summary["l2_q_slotted_cylinders"] < 0.1
    assert 0.0 < summary["l2_h"] < 1e-3


def test_a_restart_goes_on_bit_by_bit(tmp_path):
    whole, half, rest = (tmp_path / f"{name}.nc" for name in ("whole", "half", "rest"))
    settings = ("scene.case=4", "tracers.limiter=true")
    run_scene(make_config({**SETTINGS, "days": 2.0, "out": whole, "settings": settings}))
    run_scene(make_config({**SETTINGS, "days": 1.0, "out": half, "settings": settings}))
    run_scene(make_config({"scene": "deformational", "days": 2.0, "restart": half, "out": rest}))
    with netCDF4.Dataset(whole) as one, netCDF4.Dataset(rest) as other:
        for name in ("h", "q_gaussian_hills", "q_slotted_cylinders"):
            assert np.array_equal(one[name][-1], other[name][-1])


@pytest.mark.thorough
def test_a_tracer_can_be_drawn_and_compared(tmp_path):
    from swe_sphere.io.reference_solution import compare
    from swe_sphere.pictures.plot import plot_file

    path = tmp_path / "run.nc"
    run_scene(make_config({**SETTINGS, "days": 0.5, "out": path}))
    assert plot_file(path, "q_cosine_bells").stat().st_size > 10_000
    assert compare(path, path, "q_cosine_bells")["l2"] == 0.0
    with pytest.raises(ConfigError, match="q_bells"):
        compare(path, path, "q_bells")


def test_the_table_tells_of_tracers_and_not_of_the_energy_of_a_given_wind():
    """Errors at the end of the period, when they are known; drifts of energy mean nothing."""
    short = {"scene": "deformational", "ne": 2, "np": 4, "dt": 7200.0}
    summary = run_scene(make_config(short))
    rows = dict(summary.rows())
    assert {name for name in rows if name.startswith("tracer ")} == {
        "tracer gaussian_hills", "tracer cosine_bells", "tracer correlated",
        "tracer slotted_cylinders",
    }  # fmt: skip
    told = rows["tracer cosine_bells"]
    assert told.startswith(f"l1 {summary['l1_q_cosine_bells']:.3g}, l2 ") and "max" in told
    assert rows["drift"].startswith("mass ") and "energy" not in rows["drift"]
    for name in ("energy_drift", "enstrophy_drift"):
        assert summary.as_dict()[name] is None
    before = dict(run_scene(make_config(short | {"days": 1.0})).rows())
    assert before["tracer cosine_bells"].startswith("min ")


def test_an_effect_that_changes_the_depth_leaves_no_exact_tracers():
    scene = get_scene("deformational", case=3)
    assert scene.exact_tracers is not None
    changed = scene.with_effect(Relaxation(43200.0))
    assert (changed.exact, changed.exact_tracers) == (None, None)
    assert scene.without_effect("prescribed-wind").exact_tracers is None


@pytest.mark.parametrize("stepper", ["forward-backward", "leapfrog"])
def test_automatic_steps_know_the_strongest_wind_of_the_run(stepper: str) -> None:
    """The wind begins at rest and reaches 40 m/s after a day."""

    sim = Simulation(swelling_wind(4.0), ne=16, np=4, stepper=stepper, days=1)
    assert sim.stable_dt() < 3600.0
    assert sim.run().status == "completed"


@pytest.mark.parametrize("stepper", ["forward-backward", "leapfrog"])
def test_a_longer_run_shortens_automatic_steps_for_a_stronger_wind(
    stepper: str, tmp_path: Path
) -> None:
    scene = swelling_wind(4.0)
    sim = Simulation(scene, ne=8, np=4, stepper=stepper)
    assert sim.run(days=0.1, every=2.4).status == "completed"
    at_first = sim.plan.dt
    sim.checkpoint(tmp_path / "state.nc")
    resumed = Simulation.from_checkpoint(tmp_path / "state.nc", scene)
    for each in (sim, resumed):
        assert each.run(days=1, every=2.4).status == "completed"
        assert each.plan.dt < 0.5 * at_first


def test_accurate_steps_know_the_strongest_wind_of_the_run() -> None:
    sim = Simulation(swelling_wind(4.0), ne=16, np=4, stepper="epi3", days=1)
    sim.begin()
    assert 0.2 < 40.0 * sim.plan.dt / sim.mesh.spacing()[0] <= 0.5


def test_no_period_of_a_wind_hides_its_strength_from_automatic_steps() -> None:
    """The wind is at rest at every multiple of half a day."""
    a_day, eight = (
        Simulation(swelling_wind(1.0), ne=4, np=4, stepper="leapfrog", days=days)
        for days in (1.0, 8.0)
    )
    assert eight.stable_dt() == pytest.approx(a_day.stable_dt(), rel=0.02)


def test_steps_of_a_sweep_know_the_strongest_wind_of_the_run() -> None:
    plan = {"ne": [4], "np": [4], "steppers": ["leapfrog"], "days": 1.0, "dt": [3600.0]}
    (setup,) = Study(make_plan({"scene": "deformational"} | plan), swelling_wind(4.0)).setups()
    sim = Simulation(swelling_wind(4.0), ne=4, np=4, stepper="leapfrog", days=1.0)
    assert setup.stable_dt == sim.stable_dt() < 2e4


def swelling_wind(period: float) -> Scene:
    """Return a scene whose wind begins at rest and reaches 40 m/s after a quarter period [days]."""

    def wind(lon, lat, t):
        return 40.0 * np.cos(lat) * np.sin(2.0 * np.pi * t / (period * DAY)), 0.0 * lat

    return replace(
        get_scene("deformational"), wind=wind, exact=None, exact_tracers=None, sheds_waves=False
    )
