"""Absolute angular momentum: exact values, an independent formula, what conserves it."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from swe_sphere import Simulation
from swe_sphere.io.integrals import AXES, MOMENTA, angular_momentum, drifts
from swe_sphere.io.runfile import RunFile
from swe_sphere.mesh import Mesh
from swe_sphere.pictures.panels import panels
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.flows import sin_tilted_latitude, solid_body


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(3, 10)


def vector(found):
    return np.array([found[name] for name in AXES])


def from_cross_products(mesh, u, v, h, rotation):
    """Return I(h r x (V + W x r)) from vectors of three components."""
    place = mesh.radius * mesh.xyz
    wind = u[:, None] * mesh.east + v[:, None] * mesh.north + np.cross(rotation, place)
    return np.average(np.cross(place, h[:, None] * wind), axis=0, weights=mesh.area)


@pytest.mark.parametrize("alpha", [0.0, 0.7])
def test_solid_body_flow_is_exact(mesh, alpha):
    """I(h a^2 (W - r (W.r))) is two thirds of h a^2 W, whatever the axis of W."""
    speed, depth, a = 30.0, 5000.0, mesh.radius
    east, north = solid_body(mesh.lon, mesh.lat, alpha)
    axis = np.array([-np.sin(alpha), 0.0, np.cos(alpha)])
    h, f = np.full(mesh.size, depth), EARTH.coriolis(mesh.lon, mesh.lat)
    found = angular_momentum(mesh, speed * east, speed * north, h, f)
    exact = 2.0 / 3.0 * depth * a * (speed * axis + EARTH.rotation * a * np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(vector(found), exact, atol=1e-11 * np.linalg.norm(exact))
    assert found["axial_angular_momentum"] == pytest.approx(exact[2], rel=1e-11)


def test_the_axis_is_that_of_the_coriolis_parameter(mesh):
    """williamson2 tilts both; a planet that does not rotate has the axis z."""
    alpha, h, still = 1.0, np.full(mesh.size, 100.0), np.zeros(mesh.size)
    f = 2.0 * EARTH.rotation * sin_tilted_latitude(mesh.lon, mesh.lat, alpha)
    found = angular_momentum(mesh, still, still, h, f)
    whole = 2.0 / 3.0 * 100.0 * EARTH.rotation * mesh.radius**2
    exact = whole * np.array([-np.sin(alpha), 0.0, np.cos(alpha)])
    np.testing.assert_allclose(vector(found), exact, atol=1e-11 * whole)
    assert found["axial_angular_momentum"] == pytest.approx(whole, rel=1e-11)
    east, north = solid_body(mesh.lon, mesh.lat, alpha)
    found = angular_momentum(mesh, east, north, h, 0.0)
    assert found["axial_angular_momentum"] == found["angular_momentum_z"]


@pytest.mark.parametrize("stretch", [1.0, 3.0])
def test_any_state_has_that_of_cross_products(stretch):
    mesh = Mesh.build(2, 5, stretch=stretch, centre=(40.0, 20.0))
    rng, rotation = np.random.default_rng(1), np.array([2e-5, -4e-5, 6e-5])
    u, v, h = rng.normal(size=(3, mesh.size)) * [[20.0], [20.0], [300.0]] + [[5.0], [0.0], [4000.0]]
    found = angular_momentum(mesh, u, v, h, 2.0 * mesh.xyz @ rotation)
    right = from_cross_products(mesh, u, v, h, rotation)
    np.testing.assert_allclose(vector(found), right, rtol=1e-12)
    axial = right @ rotation / np.linalg.norm(rotation)
    assert found["axial_angular_momentum"] == pytest.approx(axial, rel=1e-12)
    across = np.linalg.norm(np.cross(right, rotation)) / np.linalg.norm(rotation)
    assert found["equatorial_angular_momentum"] == pytest.approx(across, rel=1e-12)


def test_the_drift_is_relative_to_the_vector():
    start = {**dict(zip(AXES, (3.0, 0.0, 4.0), strict=True)), "axial_angular_momentum": 4.0}
    start |= {"equatorial_angular_momentum": 3.0}
    start |= dict.fromkeys(("mass", "energy", "potential_enstrophy"), 1.0)
    now = start | {"axial_angular_momentum": 4.5, "equatorial_angular_momentum": 2.0}
    assert drifts(start, now)["angular_momentum_drift"] == pytest.approx(0.1)
    assert drifts(start, now)["equatorial_momentum_drift"] == pytest.approx(-0.2)
    still = start | dict.fromkeys(MOMENTA, 0.0)
    assert np.isnan(drifts(still, still)["angular_momentum_drift"])


@pytest.mark.parametrize(("scene", "bound"), [("williamson6", 5e-13), ("tilted-jet", 1e-14)])
def test_resolved_flow_conserves_it_up_to_the_time_error(scene, bound):
    """Over a level bottom, and over one that is symmetric about the axis of rotation."""
    coarse, fine = (
        Simulation(scene, ne=3, np=np_, dt=100.0).run(days=0.25)["angular_momentum_drift"]
        for np_ in (5, 12)
    )
    assert abs(fine) < bound
    assert abs(coarse) > 100.0 * abs(fine)


def test_the_equatorial_part_of_a_flow_fixed_among_the_stars_turns():
    """The vector of tilted-jet is steady among them and turns backwards as seen from the planet."""
    sim = Simulation("tilted-jet", ne=3, np=10, dt=200.0)
    before = sim.diagnostics["angular_momentum_x"] + 1j * sim.diagnostics["angular_momentum_y"]
    now = sim.run(days=0.5)
    after = now["angular_momentum_x"] + 1j * now["angular_momentum_y"]
    assert after / before == pytest.approx(np.exp(-0.5j * DAY * EARTH.rotation), abs=1e-7)
    assert now["equatorial_angular_momentum"] == pytest.approx(abs(after))
    assert abs(now["equatorial_momentum_drift"]) < 1e-9


def test_over_a_level_bottom_the_equatorial_part_is_not_conserved():
    """Seen from the planet it changes by -W x I(h r x V), without a centrifugal force."""

    def start(lon, lat):
        hill = np.exp(-8.0 * (1.0 - np.cos(lat - 0.8) * np.cos(lon)))
        return 0.0 * lon, 0.0 * lon, 3000.0 + 100.0 * hill

    def rate():
        state = sim.state
        fields = (state[name].values for name in ("u", "v", "h"))
        return -np.cross(axis, from_cross_products(mesh, *fields, 0.0 * axis))

    scene = replace(get_scene("williamson2"), name="hill", initial=start, exact=None)
    sim, axis = Simulation(scene, ne=3, np=10, dt=100.0), np.array([0.0, 0.0, EARTH.rotation])
    mesh, first = sim.mesh, sim.diagnostics
    rates = [rate()]
    for step in range(12):
        sim.run(days=(step + 1) / 48.0)
        rates.append(rate())
    expected = 1800.0 / 3.0 * np.array([1, *[4, 2] * 5, 4, 1]) @ np.array(rates)
    now = sim.diagnostics
    np.testing.assert_allclose(
        vector(now) - vector(first), expected, atol=1e-4 * np.abs(expected).max()
    )
    assert abs(now["angular_momentum_drift"]) < 1e-9 < abs(now["equatorial_momentum_drift"])


def test_a_mountain_changes_it_by_its_torque():
    """The axial component changes by -I(g h db/dlon), integrated with Simpson's rule here."""

    def bottom(lon, lat):
        return 2000.0 * np.exp(-8.0 * (1.0 - np.cos(lat) * np.cos(lon)))

    def torque():
        slope = -8.0 * np.cos(mesh.lat) * np.sin(mesh.lon) * bottom(mesh.lon, mesh.lat)
        return -EARTH.gravity * np.average(sim.state.h.values * slope, weights=mesh.area)

    scene = replace(get_scene("williamson5"), bottom=bottom)
    sim = Simulation(scene, ne=3, np=10, dt=150.0)
    mesh, first = sim.mesh, sim.diagnostics["axial_angular_momentum"]
    rates = [torque()]
    for step in range(12):
        sim.run(days=(step + 1) / 48.0)
        rates.append(torque())
    expected = 1800.0 / 3.0 * np.dot(rates, [1, *[4, 2] * 5, 4, 1])
    change = sim.diagnostics["axial_angular_momentum"] - first
    assert change == pytest.approx(expected, rel=1e-3)
    assert abs(sim.diagnostics["angular_momentum_drift"]) > 1e-5


def test_series_summary_and_plots_have_it(tmp_path):
    out = tmp_path / "run.nc"
    sim = Simulation("williamson6", ne=2, np=5, dt=900.0)
    summary = sim.run(days=0.5, every=6, out=out)
    assert "angular momentum" in dict(summary.rows())["drift"]
    assert "its equatorial part" in dict(summary.rows())["drift"]
    with xr.open_dataset(out) as file:
        for name in MOMENTA:
            assert file[name].units == "m3 s-1" and "angular momentum" in file[name].long_name
        assert file.angular_momentum_drift.units == "1"
        assert file.angular_momentum_drift.values[-1] == summary["angular_momentum_drift"] != 0.0
    curves = panels(RunFile(out))[-1].curves
    assert {"angular momentum", "equatorial angular momentum"} <= curves.keys()


def test_a_prescribed_wind_has_none():
    found = Simulation("williamson1", ne=2, np=4).diagnostics
    assert not [name for name in found if "angular" in name]


@pytest.mark.parametrize(("ne", "stretch"), [(2, 1.0), (3, 1.0), (3, 3.0)])
def test_without_a_rotation_in_the_coriolis_parameter_the_axis_is_that_of_the_grid(ne, stretch):
    """On an f-plane, and for an even parameter, quadrature errors have no direction."""
    mesh = Mesh.build(ne, 5, stretch=stretch, spin=20.0)
    zero, h = np.zeros(mesh.size), 5000.0 + 100.0 * np.sin(mesh.lat)
    for f in (np.full(mesh.size, 1e-4), 1e-4 * np.abs(np.sin(mesh.lat))):
        found = angular_momentum(mesh, 10.0 * np.cos(mesh.lat), zero, h, f)
        assert found["axial_angular_momentum"] == found["angular_momentum_z"]
