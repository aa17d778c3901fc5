"""Error norms and global integrals against values worked out by hand."""

import numpy as np
import pytest

from swe_sphere.io.integrals import (
    MOMENTA,
    area_mean,
    by_name,
    courant_numbers,
    drifts,
    field_errors,
    flow_integrals,
    norms,
    tracer_numbers,
)
from swe_sphere.mesh import Mesh
from swe_sphere.planet import EARTH, Planet


@pytest.fixture(scope="module")
def mesh():
    return Mesh.build(4, 8)


def test_constant_offset_has_equal_norms(mesh):
    exact = np.full(mesh.size, 500.0)
    for norm in norms(mesh.area, exact - 5.0, exact).values():
        assert norm == pytest.approx(0.01, rel=1e-12)


def test_norms_of_a_spherical_harmonic(mesh):
    exact, numeric = np.full(mesh.size, 2.0), 2.0 + 0.3 * np.sin(mesh.lat)
    assert norms(mesh.area, numeric, exact)["l2"] == pytest.approx(0.15 / np.sqrt(3.0), rel=1e-9)
    # |sin| has a kink at the equator, which the quadrature feels
    assert norms(mesh.area, numeric, exact)["l1"] == pytest.approx(0.15 / 2.0, rel=1e-3)
    assert norms(mesh.area, numeric, exact)["linf"] == pytest.approx(0.15, rel=1e-12)


def test_norms_weigh_with_the_area():
    area = np.array([1.0, 3.0])
    exact, numeric = np.array([1.0, 1.0]), np.array([2.0, 1.0])
    assert norms(area, numeric, exact)["l1"] == pytest.approx(0.25)
    assert norms(area, numeric, exact)["l2"] == pytest.approx(0.5)
    assert norms(area, numeric, exact)["linf"] == pytest.approx(1.0)


def test_vector_norms_take_the_length(mesh):
    east, still = np.full(mesh.size, 10.0), np.zeros(mesh.size)
    exact, turned = np.stack([east, still]), np.stack([still, east])
    for norm in norms(mesh.area, turned, exact).values():
        assert norm == pytest.approx(np.sqrt(2.0))


def test_a_vanishing_exact_field_gives_absolute_norms(mesh):
    still = np.zeros((2, mesh.size))
    drift = np.stack([np.full(mesh.size, 3e-9), np.full(mesh.size, 4e-9)])
    for norm in norms(mesh.area, drift, still).values():
        assert norm == pytest.approx(5e-9)


def test_nan_is_not_hidden(mesh):
    exact = np.ones(mesh.size)
    broken = np.where(np.arange(mesh.size) == 7, np.nan, exact)
    assert all(np.isnan(norm) for norm in norms(mesh.area, broken, exact).values())


def test_errors_name_depth_and_wind(mesh):
    flat = np.full(mesh.size, 100.0)
    exact = {"h": flat, "u": flat, "v": 0.0 * flat}
    numeric = {"h": flat + 1.0, "u": 1.02 * flat, "v": 0.0 * flat}
    found = by_name(field_errors(mesh.area, numeric, exact))
    assert set(found) == {"l1_h", "l2_h", "linf_h", "l1_v", "l2_v", "linf_v"}
    assert found["l2_h"] == pytest.approx(0.01)
    assert found["linf_v"] == pytest.approx(0.02)
    surface = by_name(field_errors(mesh.area, {"h": flat + 1.0}, {"h": flat}, bottom=3.0 * flat))
    assert set(surface) == {"l1_h", "l2_h", "linf_h"}
    assert surface["l1_h"] == pytest.approx(1.0 / 400.0)


def test_integrals_of_solid_body_rotation(mesh):
    u0, depth, a = 40.0, 3000.0, mesh.radius
    g, omega = EARTH.gravity, EARTH.rotation
    sine, one = np.sin(mesh.lat), np.ones(mesh.size)
    found = flow_integrals(
        mesh, EARTH, u0 * np.cos(mesh.lat), 0.0 * one, depth * one, 200.0 * one,
        2.0 * omega * sine, 2.0 * u0 / a * sine, 0.0 * one,
    )  # fmt: skip
    assert found["mass"] == pytest.approx(depth, rel=1e-13)
    kinetic = found["energy"] - g * depth * (0.5 * depth + 200.0)
    assert kinetic == pytest.approx(depth * u0**2 / 3.0, rel=1e-6)
    enstrophy = (2.0 * u0 / a + 2.0 * omega) ** 2 / (6.0 * depth)
    assert found["potential_enstrophy"] == pytest.approx(enstrophy, rel=1e-8)
    assert abs(found["total_vorticity"]) < 1e-15 * 2.0 * u0 / a * 10.0
    assert found["max_wind"] == pytest.approx(u0, rel=1e-2)
    assert found["max_wave"] == pytest.approx(np.sqrt(g * depth))
    assert found["max_signal"] == pytest.approx(found["max_wind"] + found["max_wave"])


def test_integrals_where_the_depth_vanishes(mesh):
    """The bell of williamson1 stands on nothing: no potential enstrophy, the rest finite."""
    zero = np.zeros(mesh.size)
    found = flow_integrals(mesh, EARTH, zero, zero, np.maximum(np.sin(mesh.lat), 0.0))
    assert np.isnan(found.pop("potential_enstrophy"))
    assert np.isfinite(list(found.values())).all()


def test_energy_uses_the_gravity_of_the_planet(mesh):
    zero, depth = np.zeros(mesh.size), np.full(mesh.size, 10.0)
    found = flow_integrals(mesh, Planet(gravity=2.0), zero, zero, depth)
    assert found["energy"] == pytest.approx(100.0)


def test_drifts_are_relative():
    same = dict.fromkeys(MOMENTA, 1.0)
    start = {"mass": 2.0, "energy": 10.0, "potential_enstrophy": float("nan")} | same
    now = {"mass": 2.0, "energy": 9.0, "potential_enstrophy": float("nan")} | same
    found = drifts(start, now)
    assert found["mass_drift"] == 0.0
    assert found["energy_drift"] == pytest.approx(-0.1)
    assert np.isnan(found["enstrophy_drift"])


def test_drifts_of_tracers_are_relative(mesh):
    full = np.full(mesh.size, 1.0)
    fields = {"hq_dust": 3.0 * full, "q_dust": 0.5 * full}
    numbers = tracer_numbers(mesh, fields, {"dust": 2.0})
    assert numbers["mass_drift_q_dust"] == pytest.approx(0.5, rel=1e-12)
    assert (numbers["min_q_dust"], numbers["max_q_dust"]) == (0.5, 0.5)
    assert np.isnan(tracer_numbers(mesh, fields, {"dust": 0.0})["mass_drift_q_dust"])


def test_courant_numbers(mesh):
    found = courant_numbers(mesh, 100.0, {"max_wind": 30.0, "max_signal": 300.0})
    assert found["courant_gravity"] == pytest.approx(100.0 * 300.0 / mesh.spacing()[0])
    assert found["courant_advective"] == pytest.approx(found["courant_gravity"] / 10.0)


def test_area_mean_of_one_is_one(mesh):
    assert area_mean(mesh.area, np.ones(mesh.size)) == pytest.approx(1.0, abs=1e-15)
