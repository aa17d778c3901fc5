"""Tides, planetary waves in a deep ocean, the relaxed jet: solutions, and the model's."""

import numpy as np
import pytest

from swe_sphere import Simulation
from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, EARTH, Planet
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.waves import TIDES, TidalEquations

SCENES = [
    *(("tide", {"constituent": name}) for name in TIDES),
    ("slow-ocean", {"linear": True, "speed": 10.0, "m": 2, "n": 4}),
]


def slope(function, step):
    """Centred difference of fourth order at 0."""
    near, far = (np.array(function(s * step)) - function(-s * step) for s in (1.0, 2.0))
    return (8.0 * near - far) / (12.0 * step)


@pytest.mark.parametrize(("name", "given"), SCENES)
def test_the_solution_solves_the_tidal_equations(name, given):
    scene = get_scene(name, **given)
    rng, t = np.random.default_rng(2), 0.7 * DAY
    lon, lat = rng.uniform(0.0, 6.0, 40), rng.uniform(-1.3, 1.3, 40)
    at, depth = scene.exact, scene.base(lon, lat)[2]

    def state(lon, lat, t):
        u, v, h = at(lon, lat, t)
        return np.array([u, v, h - depth])

    u, v, _ = state(lon, lat, t)
    rate = slope(lambda s: state(lon, lat, t + s), 200.0)
    east = slope(lambda s: state(lon + s, lat, t), 0.005) / (EARTH.radius * np.cos(lat))
    north = slope(lambda s: state(lon, lat + s, t), 0.005) / EARTH.radius
    f, g = scene.coriolis(lon, lat), EARTH.gravity
    force = scene.forcing(lon, lat, t) if scene.forcing else (0.0, 0.0, 0.0)
    outflow = east[0] + north[1] - v * np.tan(lat) / EARTH.radius
    for rest, scale in (
        (rate[0] - f * v + g * east[2] - force[0], f * v),
        (rate[1] + f * u + g * north[2] - force[1], f * u),
        (rate[2] + depth * outflow, depth * outflow),
    ):
        assert np.abs(rest).max() < 2e-6 * np.abs(scale).max() + 1e-11


def test_limits_that_are_known_in_closed_form():
    """A planet that does not turn, an ocean without end, and Laplace's diurnal tide."""
    still, frequency = Planet(EARTH.radius, EARTH.gravity, 0.0), 1.4e-4
    own = 6.0 * EARTH.gravity * 4000.0 / EARTH.radius**2
    found = TidalEquations(2, 4000.0, still).forced(-frequency, np.array([0.1]))
    assert found.coefficients[2, 2, 2] == pytest.approx(0.1 * own / (own - frequency**2), rel=1e-12)
    wave = TidalEquations(3, 1e12, EARTH).free(5)
    assert wave.frequency == pytest.approx(-2.0 * EARTH.rotation * 3 / 30, rel=1e-8)
    laplace = TidalEquations(1, 4000.0, EARTH)
    turn = laplace.forced(-EARTH.rotation, np.array([0.0, 0.1])).coefficients
    assert np.abs(turn[2]).max() < 1e-15 and np.abs(turn[0]).max() > 1e3


@pytest.mark.thorough
def test_the_model_follows_the_tide():
    summary = Simulation("tide", ne=2, np=8, dt=1800.0).run(days=0.25)
    assert summary["l2_v"] < 2e-4
    assert {"l2_v", "steps"} < {*summary}  # names of values, and an end to them


def test_a_slow_planetary_wave_moves_as_the_linear_equations_say():
    """The full equations differ by the speed of the current, relative to that of the wave."""
    wave = get_scene("slow-ocean", m=2, n=4, speed=1e-3, linear=True).exact
    sim = Simulation(
        "slow-ocean", ne=2, np=8, dt=1800.0, parameters={"m": 2, "n": 4, "speed": 1e-3}
    )
    sim.run(days=0.5)
    lon, lat, state = sim.mesh.lon, sim.mesh.lat, sim.state
    u, v, _ = wave(lon, lat, 0.5 * DAY)
    start, _, _ = wave(lon, lat, 0.0)
    assert np.abs(u - start).max() > 3e-4
    assert max(np.abs(state["u"] - u).max(), np.abs(state["v"] - v).max()) < 1e-6


def test_relaxation_brings_the_mean_depth_back_as_an_exponential():
    sim = Simulation("relaxed-jet", ne=3, np=4, dt=1200.0, parameters={"time": 0.5})
    means = [np.average(sim.state["h"], weights=sim.mesh.area)]
    rest = np.average(sim.scene.equilibrium(sim.mesh.lon, sim.mesh.lat), weights=sim.mesh.area)
    sim.run(days=0.5)
    means.append(np.average(sim.state["h"], weights=sim.mesh.area))
    assert (means[1] - rest) / (means[0] - rest) == pytest.approx(np.exp(-1.0), rel=1e-6)


def test_bounds():
    for name, given, message in (
        ("tide", {"depth": 10.0}, "depth must be 1000 m to 1e6 m, got 10"),
        ("tide", {"constituent": "m3"}, "constituent must be one of m2, s2, k1, o1, got 'm3'"),
        ("slow-ocean", {"n": 3}, "n m to m [+] 12, got 4 and 3"),
        ("slow-ocean", {"speed": 11.0}, "at most 10 m/s, got 11"),
        ("relaxed-jet", {"time": 0.0}, "time must be positive"),
    ):
        with pytest.raises(ConfigError, match=message):
            get_scene(name, **given)
