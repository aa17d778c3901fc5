"""Interpolation from the mesh: exact at nodes, spectrally accurate between them, anywhere."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.mesh.sphere import frame, longitude_latitude, position

PLACEMENTS = [
    {},
    {"centre": (40.0, 23.0), "spin": 17.0},
    {"stretch": 2.5, "centre": (-109.0, 46.0), "spin": -11.0},
    {"stretch": 1.5, "centre": (0.0, -90.0)},
]


def smooth(xyz: np.ndarray) -> np.ndarray:
    """A smooth function on the sphere without symmetries, of order one."""
    x, y, z = np.moveaxis(xyz, -1, 0)
    return np.exp(0.7 * x - 0.3 * z) * np.cos(1.5 * y + 0.4) + x * y * z


def flow(xyz: np.ndarray) -> np.ndarray:
    """A smooth tangent vector field (..., 3) that crosses both poles."""
    spin = np.cross([0.8, -0.5, 0.3], xyz)
    return spin * (1.0 + 0.5 * xyz[..., :1])


def targets() -> tuple[np.ndarray, np.ndarray]:
    """A grid with poles, date line and longitudes beyond a turn, and the corners of the cube."""
    lon, lat = np.meshgrid(np.linspace(-math.pi, 3.0 * math.pi, 49), np.linspace(-90, 90, 31))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / math.sqrt(
        3
    )
    extra = longitude_latitude(corners)
    return np.append(lon, extra[0]), np.append(np.radians(lat), extra[1])


def error(ne: int, np_: int, placement: dict) -> float:
    mesh = Mesh.build(ne, np_, **placement)
    lon, lat = targets()
    return np.abs(Interpolator(mesh, lon, lat)(smooth(mesh.xyz)) - smooth(position(lon, lat))).max()


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize(("ne", "np_"), [(1, 5), (4, 4), (3, 16)])
def test_a_node_gives_its_own_value(ne: int, np_: int, placement: dict) -> None:
    mesh = Mesh.build(ne, np_, **placement)
    noise = np.random.default_rng(1).standard_normal(mesh.size)
    found = Interpolator(mesh, mesh.lon, mesh.lat)(noise)
    assert np.abs(found - noise).max() < 1e-11


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_smooth_functions_to_round_off_at_high_order(placement: dict) -> None:
    assert error(6, 16, placement) < 1e-13


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_error_falls_exponentially_in_np(placement: dict) -> None:
    errors = [error(3, np_, placement) for np_ in (4, 6, 8, 10)]
    assert np.divide(errors[:-1], errors[1:]).min() > 10.0


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("np_", [3, 4, 5])
def test_error_falls_with_order_np_in_ne(np_: int, placement: dict) -> None:
    points = np.random.default_rng(2).standard_normal((6000, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    errors = []
    for ne in (10, 20):
        mesh = Mesh.build(ne, np_, **placement)
        found = Interpolator(mesh, *longitude_latitude(points))(smooth(mesh.xyz))
        errors.append(np.sqrt(np.mean((found - smooth(points)) ** 2)))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(np_, abs=0.1)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_wind_is_smooth_across_the_poles(placement: dict) -> None:
    mesh = Mesh.build(6, 14, **placement)
    lon, lat = targets()
    nodal = flow(mesh.xyz)
    u, v = (np.sum(nodal * unit, axis=-1) for unit in (mesh.east, mesh.north))
    found = Interpolator(mesh, lon, lat).wind(u, v)
    for values, unit in zip(found, frame(lon, lat), strict=True):
        assert np.abs(values - np.sum(flow(position(lon, lat)) * unit, axis=-1)).max() < 1e-12


def test_a_value_depends_on_one_element_and_constants_are_kept() -> None:
    mesh = Mesh.build(3, 5, stretch=2.0)
    weights = Interpolator(mesh, *targets())(np.eye(mesh.size))
    assert weights.shape == (targets()[0].size, mesh.size)
    assert np.count_nonzero(weights, axis=1).max() == 25
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-14


def test_shape_of_the_points_is_kept() -> None:
    mesh = Mesh.build(2, 4)
    lon, lat = np.meshgrid([0.0, 1.0, 2.0], [0.0, 0.5])
    interpolator = Interpolator(mesh, lon, lat)
    assert interpolator(mesh.lat).shape == (2, 3)
    assert interpolator.wind(mesh.lat, mesh.lon)[1].shape == (2, 3)
    twice = np.stack([mesh.lat, mesh.lon], axis=-1)[:, None, :]
    assert interpolator(twice).shape == (2, 3, 1, 2)
    np.testing.assert_array_equal(interpolator(twice)[..., 0, 0], interpolator(mesh.lat))
    assert Interpolator(mesh, 0.3, 0.4)(mesh.lat).shape == ()


@settings(max_examples=100, deadline=None)
@given(
    lon=st.floats(-20.0, 20.0),
    lat=st.floats(-math.pi / 2, math.pi / 2),
    placement=st.sampled_from(PLACEMENTS),
)
def test_any_point_of_the_sphere(lon: float, lat: float, placement: dict) -> None:
    mesh = Mesh.build(2, 12, **placement)
    found = Interpolator(mesh, lon, lat)(smooth(mesh.xyz))
    assert found == pytest.approx(smooth(position(np.asarray(lon), np.asarray(lat))), abs=1e-5)


@pytest.mark.parametrize(("lon", "lat"), [(math.nan, 0.0), (0.0, math.inf), (0.0, 90.0)])
def test_bad_points_are_refused(lon: float, lat: float) -> None:
    with pytest.raises(ConfigError, match="latitude"):
        Interpolator(Mesh.build(1, 3), [0.0, lon], [0.0, lat])


def test_points_are_those_given_whatever_becomes_of_the_arrays():
    mesh = Mesh.build(2, 4)
    lon, lat = np.array([0.1, 0.2]), np.array([0.1, 0.2])
    field = np.cos(mesh.lon) * np.cos(mesh.lat)
    moved, expected = Interpolator(mesh, lon, lat), Interpolator(mesh, lon, lat)(field)
    lon[:] = 2.0
    np.testing.assert_array_equal(moved(field), expected)
