"""The mesh against what is known of it: counts, areas, analytic gradients, refinement factor."""

import math

import numpy as np
import pytest
from scipy.special import sph_harm_y

from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.cubed_sphere import FACES, lattice_tangents
from swe_sphere.mesh.gll import derivative_matrix, gll_points, gll_weights
from swe_sphere.mesh.sphere import frame, longitude_latitude, position

TILTED = {"centre": (40.0, 23.0), "spin": 17.0}
STRETCHED = {"stretch": 2.5, "centre": (-109.0, 46.0), "spin": -11.0}
PLACEMENTS = [{}, TILTED, STRETCHED, {"centre": (115.0, 90.0)}]


def harmonic(xyz: np.ndarray, degree: int = 6, order: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A spherical harmonic (...) and its surface gradient (..., 3) on the unit sphere.

    Its own poles are turned away from every node, so that its gradient is regular at ours.
    """
    turn, _ = np.linalg.qr(np.array([[1.0, 2.0, 0.3], [0.2, -1.0, 1.7], [0.9, 0.1, 1.3]]))
    lon, lat = longitude_latitude(xyz @ turn)
    value, slope = sph_harm_y(degree, order, math.pi / 2 - lat, lon, diff_n=1)
    east, north = frame(lon, lat)
    eastward = slope[..., 1].real / np.cos(lat)
    gradient = eastward[..., None] * east - slope[..., 0].real[..., None] * north
    return value.real, gradient @ turn.T


def gradient_errors(mesh: Mesh, order: int = 3) -> np.ndarray:
    """Largest error (E,) in each element of the gradient by D and basis, relative."""
    value, gradient = harmonic(mesh.xyz, order=order)
    local = value[mesh.nodes]
    covariant = np.stack(
        [
            np.einsum("im,emj->eij", mesh.derivative, local),
            np.einsum("jm,eim->eij", mesh.derivative, local),
        ],
        axis=-1,
    )
    numeric = mesh.radius * np.linalg.solve(mesh.basis, covariant[..., None])[..., 0]
    exact = np.stack([np.sum(gradient * k, axis=-1) for k in (mesh.east, mesh.north)], axis=-1)
    scale = np.linalg.norm(exact, axis=-1).max()
    return np.linalg.norm(numeric - exact[mesh.nodes], axis=-1).max(axis=(1, 2)) / scale


def multiplicity(mesh: Mesh) -> np.ndarray:
    return np.bincount(mesh.nodes.ravel(), minlength=mesh.size)


def touching(mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """Which elements (E,) contain one of the nodes."""
    return np.isin(mesh.nodes, nodes).any(axis=(1, 2))


@pytest.mark.parametrize("np_", range(3, 17))
def test_gll_rule_and_derivative_are_exact_for_polynomials(np_: int) -> None:
    points = gll_points(np_)
    weights, derivative = gll_weights(points), derivative_matrix(points)
    assert np.array_equal(points, -points[::-1])
    for power in range(2 * np_ - 2):
        exact = 2.0 / (power + 1) if power % 2 == 0 else 0.0
        assert weights @ points**power == pytest.approx(exact, abs=1e-14)
    for power in range(1, np_):
        slope = power * points ** (power - 1)
        assert derivative @ points**power == pytest.approx(slope, abs=1e-12)
    assert np.abs(derivative.sum(axis=1)).max() < 1e-13


@pytest.mark.parametrize("ne", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("np_", [3, 4, 5, 8])
def test_node_counts(ne: int, np_: int) -> None:
    mesh = Mesh.build(ne, np_)
    assert mesh.nodes.shape == (mesh.elements, np_, np_)
    assert mesh.size == len(mesh.xyz) == 6 * (ne * (np_ - 1)) ** 2 + 2
    counts = np.bincount(multiplicity(mesh), minlength=5)
    # 6 ne^2 - 6 vertices of degree 4 beside the 8 corners of the cube
    vertices = 6 * ne**2 + 2
    assert counts[3] == 8
    assert counts[4] == vertices - 8
    assert counts[2] == 12 * ne**2 * (np_ - 2)
    assert counts[1] == 6 * ne**2 * (np_ - 2) ** 2
    assert counts[0] == 0 and counts.size == 5


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_contributors_of_a_node_agree_on_where_it_is(placement: dict) -> None:
    mesh = Mesh.build(3, 5, **placement)
    alpha = np.arctan(lattice_tangents(3, mesh.gll_points))
    line = np.arange(3)[:, None] * 4 + np.arange(5)
    face, a, b = np.indices((6, 3, 3)).reshape(3, -1)
    axes = FACES[face][:, :, None, None, :]
    across = np.tan(alpha[line[a]])[:, :, None, None]
    upward = np.tan(alpha[line[b]])[:, None, :, None]
    cube = axes[:, 0] + across * axes[:, 1] + upward * axes[:, 2]
    sphere = cube / np.linalg.norm(cube, axis=-1, keepdims=True)
    placed = mesh.placement.place(sphere)
    assert np.abs(placed - mesh.xyz[mesh.nodes]).max() < 4e-15
    gaps = np.linalg.norm(np.diff(mesh.xyz[mesh.nodes], axis=1), axis=-1)
    assert gaps.min() > 1e-3  # different numbers, different places


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_gather_lists_every_contributor_once(placement: dict) -> None:
    mesh = Mesh.build(2, 4, **placement)
    owner = np.repeat(np.arange(mesh.size), np.diff(mesh.gather_offsets))
    assert np.array_equal(mesh.nodes.ravel()[mesh.gather_entries], owner)
    assert np.array_equal(np.sort(mesh.gather_entries), np.arange(mesh.nodes.size))
    assert mesh.gather_offsets.dtype == mesh.gather_entries.dtype == mesh.nodes.dtype == np.int32


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_area_is_that_of_the_sphere(placement: dict) -> None:
    mesh = Mesh.build(4, 16, radius=2.5e6, **placement)
    assert mesh.jacobian.min() > 0.0
    assert mesh.area.sum() == pytest.approx(4.0 * math.pi * 2.5e6**2, rel=1e-12)
    # and is placed right: x^2 integrates to a third of it along any direction
    for direction in np.eye(3):
        third = mesh.area @ (mesh.xyz @ direction) ** 2
        assert third == pytest.approx(mesh.area.sum() / 3.0, rel=1e-12)


@pytest.mark.parametrize("np_", [3, 4])
def test_area_converges_with_the_order_of_the_quadrature(np_: int) -> None:
    errors = [abs(Mesh.build(ne, np_, radius=1.0).area.sum() / (4 * math.pi) - 1) for ne in (8, 16)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2 * np_ - 2, abs=0.1)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_basis_gives_exact_gradients_everywhere_at_high_order(placement: dict) -> None:
    mesh = Mesh.build(8, 16, **placement)
    assert gradient_errors(mesh).max() < 1e-11


@pytest.mark.parametrize(
    ("placement", "last"), [({}, 2e-7), (TILTED, 4e-7), (STRETCHED, 7e-4)], ids=str
)
def test_gradient_converges_exponentially_in_np(placement: dict, last: float) -> None:
    errors = [gradient_errors(Mesh.build(4, np_, **placement)).max() for np_ in (4, 6, 8, 10)]
    ratios = np.divide(errors[:-1], errors[1:])
    assert ratios.min() > 5.0
    assert np.all(np.diff(ratios) > 0.0)  # faster than any power of np
    assert errors[-1] < last


@pytest.mark.parametrize("placement", [{}, TILTED, STRETCHED])
@pytest.mark.parametrize("np_", [3, 4, 5])
def test_gradient_converges_in_ne_with_order_np_minus_1(np_: int, placement: dict) -> None:
    errors = [gradient_errors(Mesh.build(ne, np_, **placement)).max() for ne in (16, 32)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(np_ - 1, abs=0.12)


@pytest.mark.parametrize("ne", [5, 8])
@pytest.mark.parametrize("placement", [{}, TILTED])
def test_corners_and_poles_are_no_worse_than_the_rest(ne: int, placement: dict) -> None:
    mesh = Mesh.build(ne, 5, **placement)
    corner = touching(mesh, np.flatnonzero(multiplicity(mesh) == 3))
    pole = touching(mesh, np.flatnonzero(np.abs(mesh.lat) > 1.2))
    # summed over orders: no single harmonic is equally rough everywhere
    error = np.sqrt(sum(gradient_errors(mesh, order) ** 2 for order in range(7)))
    assert error[corner].max() < 1.2 * error[~corner].max()
    assert error[pole].max() < 1.2 * error[~pole].max()


@pytest.mark.parametrize("stretch", [1.5, 4.0, 30.0])
def test_stretching_refines_by_the_factor(stretch: float) -> None:
    centre = (57.0, 17.0)
    plain, mesh = Mesh.build(4, 5, centre=centre), Mesh.build(4, 5, centre=centre, stretch=stretch)
    point = position(*np.radians(centre))
    near, far = np.argmax(plain.xyz @ point), np.argmin(plain.xyz @ point)
    assert plain.area[near] / mesh.area[near] == pytest.approx(stretch**2, rel=1e-12)
    assert mesh.area[far] / plain.area[far] == pytest.approx(stretch**2, rel=1e-12)
    assert np.allclose(mesh.xyz[[near, far]], plain.xyz[[near, far]], atol=1e-15)


def test_stretching_is_conformal() -> None:
    plain, mesh = Mesh.build(3, 6, **TILTED), Mesh.build(3, 6, stretch=3.0, **TILTED)

    def cosine(m: Mesh) -> np.ndarray:
        first, second = m.basis[..., 0, :], m.basis[..., 1, :]
        lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
        return np.sum(first * second, axis=-1) / lengths

    assert np.abs(cosine(mesh) - cosine(plain)).max() < 1e-13


@pytest.mark.parametrize("placement", [*PLACEMENTS, {"centre": (0.0, -90.0)}])
def test_frames_follow_longitude_and_latitude(placement: dict) -> None:
    mesh = Mesh.build(4, 3, **placement)
    east, north = frame(mesh.lon, mesh.lat)
    assert np.array_equal(mesh.east, east) and np.array_equal(mesh.north, north)
    assert np.abs(position(mesh.lon, mesh.lat) - mesh.xyz).max() < 2e-15
    assert np.abs(np.cross(mesh.east, mesh.north) - mesh.xyz).max() < 2e-15
    assert mesh.lon.min() >= 0.0 and mesh.lon.max() < 2.0 * math.pi


@pytest.mark.parametrize("placement", [{}, {"centre": (115.0, 90.0), "stretch": 3.0}])
def test_a_node_meant_for_the_pole_is_there(placement: dict) -> None:
    mesh = Mesh.build(2, 4, **placement)
    poles = np.flatnonzero(np.abs(mesh.lat) == math.pi / 2)
    assert poles.size == 2
    assert np.array_equal(np.sort(mesh.xyz[poles], axis=0), [[0, 0, -1], [0, 0, 1]])
    assert np.array_equal(mesh.lon[poles], [0.0, 0.0])


def test_longitude_stays_below_a_whole_turn() -> None:
    lon, lat = longitude_latitude(np.array([[1.0, -1e-300, 0.0], [1.0, -0.0, 0.0], [0, -0.0, 1]]))
    assert np.array_equal(lon, [0.0, 0.0, 0.0]) and np.array_equal(lat, [0, 0, math.pi / 2])


def test_the_unplaced_cube_is_mirrored_to_the_bit() -> None:
    points = {tuple(p) for p in Mesh.build(3, 4).xyz}
    for mirror in ([-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]):
        assert {tuple(np.multiply(p, mirror)) for p in points} == points


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_quads_are_anticlockwise_and_cover_the_sphere(placement: dict) -> None:
    mesh = Mesh.build(8, 5, **placement)
    a, b, c, d = np.moveaxis(mesh.xyz[mesh.quads()], 1, 0)
    flat = 0.5 * np.sum(np.cross(c - a, d - b) * (a + b + c + d) / 4.0, axis=-1)
    assert flat.min() > 0.0
    assert flat.sum() == pytest.approx(4.0 * math.pi, rel=0.02)
    assert len(flat) == mesh.elements * (mesh.np - 1) ** 2 == mesh.size - 2


def test_spacing_is_a_length_between_nodes() -> None:
    mesh = Mesh.build(8, 4)
    smallest, largest = mesh.spacing()
    equator = 0.5 * math.pi * mesh.radius / (8 * 3)
    assert 0.6 * equator < smallest < largest < 1.05 * equator
    fine, coarse = Mesh.build(8, 4, stretch=2.0).spacing()
    assert fine < 0.6 * largest and coarse > 1.5 * smallest


def test_arrays_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Mesh.build(1, 3).area[0] = 1.0


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"ne": 0}, "ne=0"),
        ({"ne": 2.5}, "whole"),
        ({"ne": 10**5}, "too large"),
        ({"np": 2}, "np=2"),
        ({"np": 17}, "np=17"),
        ({"stretch": 0.5}, "stretch=0.5"),
        ({"stretch": math.nan}, "stretch=nan"),
        ({"radius": 0.0}, "radius"),
        ({"radius": math.inf}, "radius"),
        ({"centre": (math.nan, 0.0)}, "centre"),
        ({"centre": (0.0, math.nan)}, "centre"),
        ({"centre": (0.0, 91.0)}, "latitude"),
        ({"spin": math.inf}, "spin"),
        ({"radius": 1e-170}, "radius"),
        ({"radius": 10**400}, "needs numbers"),
        ({"centre": ("a", 0.0)}, "needs numbers"),
        ({"centre": (0.0,)}, "needs numbers"),
        ({"stretch": None}, "needs numbers"),
    ],
)
def test_bad_numbers_are_refused_in_one_line(wrong: dict, word: str) -> None:
    with pytest.raises(ConfigError, match=word) as caught:
        Mesh.build(**{"ne": 4, "np": 4, **wrong})
    assert "\n" not in str(caught.value)
