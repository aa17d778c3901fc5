"""The constants and shapes that papers and public codes give for the scenes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.integrate import quad

from swe_sphere.equations.scene import Array
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.jets import JET

SPEED = 38.610682767  # 2 π a / 12 days [m s-1]


def random_points(count: int = 400, south: float = -1.4, north: float = 1.4) -> tuple[Array, Array]:
    rng = np.random.default_rng(7)
    return rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(south, north, count)


def test_lauter_ranges() -> None:
    lon, lat = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 721), np.linspace(-0.5, 0.5, 721) * np.pi)
    scene = get_scene("lauter")
    h, b = scene.initial(lon, lat)[2], scene.bottom(lon, lat)
    assert (h.min(), h.max()) == pytest.approx((1256.34, 13631.33), abs=0.05)
    assert ((h + b).min(), (h + b).max()) == pytest.approx((12005.8, 13889.4), abs=0.1)
    assert b.max() == pytest.approx(11006.5, abs=0.1)


@pytest.mark.parametrize("alpha", [0.0, 0.05, np.pi / 4, np.pi / 2])
def test_williamson1_bell_goes_once_around(alpha: float) -> None:
    scene = get_scene("williamson1", alpha=alpha)
    lon, lat = random_points(20000)
    start = scene.initial(lon, lat)[2]
    np.testing.assert_allclose(scene.exact(lon, lat, 12.0 * DAY)[2], start, atol=1e-9)
    assert start.min() == 0.0 and 990.0 < start.max() <= 1000.0
    assert scene.initial(np.array([1.5 * np.pi]), np.zeros(1))[2] == pytest.approx(1000.0)
    assert np.mean(start > 0.0) == pytest.approx(np.mean(distance(lon, lat) < 1.0 / 3.0))
    assert scene.exact(np.array([0.5 * np.pi]), np.zeros(1), 6.0 * DAY)[2] == pytest.approx(1000.0)


def distance(lon: Array, lat: Array) -> Array:
    """From (3π/2, 0), on the unit sphere."""
    return np.arccos(np.clip(np.cos(lat) * np.cos(lon - 1.5 * np.pi), -1.0, 1.0))


def test_williamson1_bell_has_the_published_shape() -> None:
    lon, lat = np.full(3, 1.5 * np.pi), np.array([1.0 / 6.0, 1.0 / 12.0, 0.34])
    bell = get_scene("williamson1").initial(lon, lat)[2]
    np.testing.assert_allclose(bell, [500.0, 500.0 + 250.0 * np.sqrt(2.0), 0.0], atol=1e-9)
    smooth = get_scene("williamson1", gaussian=True).initial(lon, lat)[2]
    np.testing.assert_allclose(smooth, 1000.0 * np.exp(-10.0 * (1.0 - np.cos(lat))), rtol=1e-12)


@pytest.mark.parametrize("alpha", [0.0, np.pi / 4, 1.2])
def test_williamson2_extremes(alpha: float) -> None:
    # rotated pole and a point of the rotated equator
    lon, lat = np.array([np.pi, 1.5 * np.pi]), np.array([np.pi / 2.0 - alpha, 0.0])
    u, v, h = get_scene("williamson2", alpha=alpha).initial(lon, lat)
    assert h == pytest.approx([1092.833, 2998.115], abs=1e-3)
    assert np.hypot(u, v) == pytest.approx([0.0, SPEED], abs=1e-8)


def test_mountain_extremes_and_wrap() -> None:
    bottom, radius = get_scene("williamson5").bottom, np.pi / 9.0
    lon = 1.5 * np.pi + np.array([0.0, radius / 2, -radius / 2, 0.0, radius, -radius, 0.0])
    lat = np.pi / 6.0 + np.array([0.0, 0.0, 0.0, radius / 2, 0.0, 0.0, -1.01 * radius])
    expected = [2000.0, 1000.0, 1000.0, 1000.0, 0.0, 0.0, 0.0]
    for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
        np.testing.assert_allclose(bottom(lon + turn, lat), expected, atol=1e-9)
    many = bottom(*random_points(5000))
    assert many.min() == 0.0 and many.max() < 2000.0


def test_williamson6_extremes_and_mean() -> None:
    scene, (lat, weights) = get_scene("williamson6"), gauss(200)
    lon, lat = np.meshgrid(np.arange(360) * np.pi / 180.0, lat)
    u, v, h = scene.initial(lon, lat)
    # the mean depth is also that of an independent spectral-transform model
    assert weights @ h.mean(axis=1) == pytest.approx(9522.99656, abs=1e-5)
    assert h.max() == pytest.approx(10556.40, abs=0.2) and h.min() >= 8000.0
    assert np.hypot(u, v).max() == pytest.approx(100.0, abs=0.05)
    pole = scene.initial(np.zeros(2), np.array([-0.5, 0.5]) * np.pi)
    np.testing.assert_allclose(pole[2], 8000.0, atol=1e-9)


def gauss(count: int) -> tuple[Array, Array]:
    """Latitudes [rad] and weights that sum to one, for means over the sphere."""
    sine, weights = np.polynomial.legendre.leggauss(count)
    return np.arcsin(sine), weights / 2.0


def test_galewsky_constants() -> None:
    scene, (lat, weights) = get_scene("galewsky", perturbed=False), gauss(2000)
    depth = scene.initial(np.zeros_like(lat), lat)[2]
    assert weights @ depth == pytest.approx(10000.0, abs=1e-8)
    u, _, ends = scene.initial(np.zeros(3), np.array([-0.5, 0.25, 0.5]) * np.pi)
    assert u == pytest.approx([0.0, 80.0, 0.0], abs=1e-11)
    assert ends[0] - ends[2] == pytest.approx(1086.97823249, abs=1e-8)


def test_other_winds_are_in_balance_too() -> None:
    """Slopes of the surface against a u (f + u tan θ / a); the wave's wind goes with ω."""
    lat = np.linspace(-0.2, 1.1, 9)
    lon, step = np.full_like(lat, 0.3), 1e-4
    jet = get_scene("galewsky", perturbed=False, speed=30.0)
    over_plain = get_scene("williamson5", speed=5.0)
    for scene, fastest in ((jet, 30.0), (over_plain, 5.0)):
        u = scene.initial(lon, lat)[0]
        rise = scene.initial(lon, lat + step)[2] - scene.initial(lon, lat - step)[2]
        slope = EARTH.gravity * rise / (2.0 * step)
        turn = 2.0 * EARTH.rotation * np.sin(lat) + u * np.tan(lat) / EARTH.radius
        np.testing.assert_allclose(slope, -EARTH.radius * u * turn, atol=2e-3 * fastest)
        assert np.abs(scene.initial(lon, np.linspace(0.0, 1.0, 9))[0]).max() <= fastest
    whole, half = (get_scene("williamson6", omega=w).initial(lon, lat) for w in (8e-6, 4e-6))
    np.testing.assert_allclose(half[0], 0.5 * whole[0], rtol=1e-12)
    np.testing.assert_allclose(half[1], 0.5 * whole[1], rtol=1e-12)


def test_galewsky_bump() -> None:
    lon, (lat, weights) = np.arange(720) * np.pi / 360.0, gauss(400)
    lon, lat = np.meshgrid(lon, lat)
    bump = get_scene("galewsky").initial(lon, lat)[2]
    bump = bump - get_scene("galewsky", perturbed=False).initial(lon, lat)[2]
    assert weights @ bump.mean(axis=1) == pytest.approx(1.0 / 3.0, abs=1e-5)
    centre = np.array([[0.0], [2.0 * np.pi], [1.0 / 3.0]]), np.full((3, 1), np.pi / 4.0)
    top = get_scene("galewsky").initial(*centre)[2]
    top = top - get_scene("galewsky", perturbed=False).initial(*centre)[2]
    height = 120.0 * np.sqrt(0.5)
    np.testing.assert_allclose(top[:, 0], [height, height, height / np.e], atol=1e-9)


def test_galewsky_integral_is_right_to_round_off() -> None:
    def slope(lat: float) -> float:
        wind = float(JET(np.asarray(lat)))
        return wind * (2.0 * EARTH.rotation * EARTH.radius * np.sin(lat) + wind * np.tan(lat))

    ends = np.linspace(0.5, 1.1, 13)
    fresh = [quad(slope, np.pi / 7.0, end, epsabs=0.0, epsrel=1e-13, limit=200)[0] for end in ends]
    np.testing.assert_allclose(JET.drop(ends), fresh, rtol=0.0, atol=3e-11)  # of 1e4 m² s⁻²


def test_galewsky_integral_is_monotone_and_takes_many_latitudes() -> None:
    lat = np.arcsin(np.random.default_rng(1).uniform(-1.0, 1.0, 200_000))
    drop = JET.drop(lat)
    fine = JET.drop(np.linspace(0.4, 1.2, 100_001))
    assert np.all(np.diff(fine) >= 0.0)
    assert drop.max() == fine[-1] and drop.min() == 0.0
    one = JET.drop(0.8)
    assert isinstance(one, np.ndarray) and one == JET.drop(np.array([0.8]))


@pytest.mark.parametrize(("cone", "rotating"), list(product([True, False], repeat=2)))
def test_lake_is_level(cone: bool, rotating: bool) -> None:
    scene = get_scene("lake-at-rest", cone=cone, rotating=rotating)
    lon, lat = random_points(5000)
    u, v, h = scene.initial(lon, lat)
    np.testing.assert_allclose(h + scene.bottom(lon, lat), 5960.0, rtol=3e-16)
    assert not u.any() and not v.any()
    top = scene.bottom(np.array([-0.5 * np.pi]), np.array([np.pi / 6.0]))
    assert top == pytest.approx(2000.0) and scene.bottom(lon, lat).max() > 1500.0
    assert (scene.effect("rotation") is not None) is rotating


def test_williamson3_values() -> None:
    # the rotated pole, the edge of the jet and its middle: values of an independent prototype
    lon, lat = np.zeros(3), np.array([0.5, -1.0 / 6.0, 1.0 / 6.0]) * np.pi
    u, v, h = get_scene("williamson3").initial(lon, lat)
    assert h[:2] == pytest.approx([2097.863406, 2998.115470], abs=1e-5)
    assert u == pytest.approx([0.0, 0.0, SPEED], abs=1e-8) and not v.any()
    tilted = get_scene("williamson3", alpha=np.pi / 3).initial(np.array([np.pi]), lat[2:])
    assert tilted[2] == pytest.approx(2097.863406, abs=1e-5)


def test_williamson4_low() -> None:
    scene, centre = get_scene("williamson4"), (np.zeros(1), np.array([np.pi / 4.0]))
    day = 20.0 * DAY / EARTH.radius
    later = scene.exact(centre[0] + day, centre[1], DAY)[2]
    far = scene.initial(np.array([np.pi]), centre[1])[2]
    assert far - scene.initial(*centre)[2] == pytest.approx(305.93, abs=0.01)
    assert later == pytest.approx(scene.initial(*centre)[2], abs=1e-9)
    assert scene.initial(*centre)[0] == pytest.approx(20.0)
    pole = scene.initial(np.zeros(2), np.array([-0.5, 0.5]) * np.pi)[2]
    np.testing.assert_allclose(pole, 1e5 / 9.80616, rtol=1e-12)


def test_mcdonald_bates_winds_are_geostrophic() -> None:
    scene = get_scene("mcdonald-bates")
    lon, lat = random_points(200, 0.3, 1.3)
    u, v, _ = scene.initial(lon, lat)
    d, f = 1e-4, scene.coriolis(lon, lat) / EARTH.gravity
    north = (scene.initial(lon, lat + d)[2] - scene.initial(lon, lat - d)[2]) / (2.0 * d)
    east = (scene.initial(lon + d, lat)[2] - scene.initial(lon - d, lat)[2]) / (2.0 * d)
    np.testing.assert_allclose(u, -north / EARTH.radius / f, atol=1e-5)
    np.testing.assert_allclose(v, east / EARTH.radius / np.cos(lat) / f, atol=1e-5)
    pole = scene.initial(np.zeros(1), np.array([np.pi / 2.0]))
    assert np.hypot(pole[0], pole[1]) == pytest.approx(20.0)
    assert pole[2] == pytest.approx(5.768e4 / EARTH.gravity)


def test_heights_and_bursts_of_the_waves() -> None:
    third = np.array([0.0, 1.0 / 6.0, 1.0 / 3.0])
    heap = get_scene("splash").initial(1.5 * np.pi - third, np.zeros(3))[2]
    np.testing.assert_allclose(heap, [3000.0, 2500.0, 2000.0], atol=1e-9)
    dam = get_scene("dam-break").initial(np.full(3, 1.5 * np.pi), np.array([0.0, np.pi / 9.0, 1.0]))
    np.testing.assert_allclose(dam[2], [2000.0, 1500.0, 1000.0], atol=2e-3)
    lon, lat = np.pi * np.array([0.2, 1.2, 1.6, 0.0]), np.pi * np.array([1 / 3, 0.2, -0.25, 0.5])
    bumps = get_scene("gravity-bumps").initial(lon, lat)[2]
    np.testing.assert_allclose(bumps[:3], 11000.0, atol=2.0)
    assert bumps[3] == pytest.approx(1e4 + 1000.0 * np.exp(-10.0 * (np.pi / 6.0) ** 2), abs=0.1)
    at = np.array([0.5 * np.pi, 1.5 * np.pi, 0.5 * np.pi + 750e3 / EARTH.radius])
    u = get_scene("modons").initial(at, np.zeros(3))[0]
    np.testing.assert_allclose(u, [50.0, -50.0, 50.0 / np.e], rtol=1e-12)
