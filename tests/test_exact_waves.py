"""The exact solutions of `tilted-jet` and `hough`: equations, published periods, and orders."""

from __future__ import annotations

import numpy as np
import pytest

from swe_sphere import Simulation
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.waves import hough_wave

MODES = [("rossby", 1, 2), ("kelvin", 1, 1), ("eastward", 2, 1), ("westward", 3, 2)]


def residual(scene, np_: int, t: float) -> float:
    """Difference of the tendency and the time derivative of the exact solution, relative."""
    mesh = Mesh.build(4, np_)
    model = Model(mesh, scene)
    out, step = model.zeros(), 1.0
    model.tendency(model.state_from(*scene.exact(mesh.lon, mesh.lat, t)), t, out)
    after, before = (
        np.stack(scene.exact(mesh.lon, mesh.lat, t + sign * step)) for sign in (1.0, -1.0)
    )
    expected = ((after - before) / (2.0 * step)).ravel()
    blocks = zip(out.numpy().reshape(3, -1), expected.reshape(3, -1), strict=True)
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in blocks)


@pytest.mark.parametrize("gaussian", [False, True])
def test_the_tilted_jet_solves_the_equations_at_any_time(gaussian):
    scene = get_scene("tilted-jet", gaussian=gaussian, alpha=0.3)
    coarse, fine = (residual(scene, np_, 2e4) for np_ in (6, 12))
    assert fine < coarse / 100 and fine < (1e-3 if gaussian else 1e-6)


def test_without_tilt_the_jet_is_steady():
    scene = get_scene("tilted-jet", alpha=0.0)
    mesh = Mesh.build(2, 4)
    first, later = (np.stack(scene.exact(mesh.lon, mesh.lat, t)) for t in (0.0, 1e4))
    np.testing.assert_allclose(first, later, atol=1e-8)
    assert np.abs(first[1]).max() < 1e-12 and 30.0 < first[0].max() < 50.0


@pytest.mark.parametrize("gaussian", [False, True])
def test_the_tilted_jet_converges(gaussian):
    """Errors after a day; np 4 to 6 on ne 8."""
    found = []
    for np_ in (4, 6):
        sim = Simulation(
            "tilted-jet", ne=8, np=np_, days=1, dt=200, stepper="rk4",
            parameters={"gaussian": gaussian},
        )  # fmt: skip
        sim.run()
        found.append([sim.diagnostics[name] for name in ("l2_h", "l2_v")])
    coarse, fine = np.array(found)
    limit = ([1.6e-4, 7e-3], [3.4e-6, 1.9e-4]) if gaussian else ([1.1e-5, 5.2e-4], [2.8e-8, 1.4e-6])
    assert np.all(coarse < limit[0]) and np.all(fine < limit[1])


def test_a_jet_that_leaves_no_water_is_refused():
    with pytest.raises(ConfigError, match="drains the pole"):
        get_scene("tilted-jet", speed=200.0)


@pytest.mark.parametrize("mode", MODES)
def test_hough_modes_solve_the_linear_equations(mode):
    wave, k, n = mode
    scene = get_scene("hough", wave=wave, k=k, n=n)
    coarse, fine = (residual(scene, np_, 2e4) for np_ in (5, 10))
    assert fine < coarse / 100 and fine < 1e-4


@pytest.mark.parametrize(
    ("wave", "n", "depth", "days"),
    [("rossby", 2, 1e4, 5.0), ("rossby", 1, 1e4, 1.2), ("kelvin", 1, 1e4, 1.35)],
)
def test_hough_modes_have_the_periods_of_the_atmosphere(wave, n, depth, days):
    """The 5-day wave and the mixed mode of 1.2 days (Madden 2007, doi:10.1111/j.1600-0870.2007.
    00257.x, table 1), and the Kelvin wave that goes around in 33 hours (Matsushima 1990)."""
    period = 2.0 * np.pi / hough_wave(wave, 1, n, depth, 1.0).frequency / DAY
    assert abs(period) == pytest.approx(days, rel=0.02)
    assert (period < 0.0) == (wave == "rossby")


def test_slow_rotation_limit_of_rossby_waves():
    """For a deep layer the frequency is that of the barotropic wave, -2 Ω k / (n (n + 1))."""
    found = hough_wave("rossby", 3, 2, 1e12, 1.0).frequency
    assert found == pytest.approx(-2.0 * EARTH.rotation * 3 / (4 * 5), rel=1e-4)


@pytest.mark.parametrize("mode", MODES)
def test_the_pattern_keeps_its_speed_and_its_amplitude(mode):
    """Phase against that of the exact solution, and amplitude, after half a day."""
    wave, k, n = mode
    sim = Simulation(
        "hough", ne=6, np=6, days=0.5, dt=300, stepper="rk4",
        parameters={"wave": wave, "k": k, "n": n},
    )  # fmt: skip
    sim.run()
    scene, mesh = sim.scene, sim.mesh
    exact, shifted = (
        scene.exact(mesh.lon + shift, mesh.lat, 0.5 * DAY)[2] - 1000.0
        for shift in (0.0, 0.5 * np.pi / k)
    )
    pattern = mesh.area * (exact + 1j * shifted)  # the conjugate of A exp(i k λ), times the area
    ratio = np.sum(pattern * (sim.state.h.values - 1000.0)) / np.sum(pattern * exact)
    assert abs(np.angle(ratio)) < 2e-4 and abs(abs(ratio) - 1.0) < 2e-4


def test_a_run_of_a_fast_mode_is_one_period_long():
    scene = get_scene("hough", depth=1e6, k=500, n=40, wave="westward")
    frequency = hough_wave("westward", 500, 40, 1e6, 1.0).frequency
    assert scene.days == pytest.approx(2.0 * np.pi / abs(frequency) / DAY, rel=5e-3)


@pytest.mark.parametrize(
    ("scene", "parameters", "said"),
    [("hough", {"k": 0}, "k must be 1 to 500"), ("hough", {"k": 10**6}, "k must be 1 to 500"),
     ("hough", {"wave": "kelvin", "n": 2}, "1 for kelvin"),
     ("hough", {"depth": -1.0}, "depth must be 1e-3 to 1e6 m"),
     ("hough", {"depth": 1.0, "n": 40}, "take a smaller k or n, or another depth than 1 m"),
     ("matsuno", {"n": 41}, "k must be 1 to 500 and n 1 to 40"),
     ("slow-ocean", {"m": 10**6, "n": 10**6}, "m must be 1 to 50")],
)  # fmt: skip
def test_modes_that_do_not_exist_are_refused(scene, parameters, said):
    with pytest.raises(ConfigError, match=said):
        get_scene(scene, **parameters)
