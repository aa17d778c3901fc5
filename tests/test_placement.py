"""Rotation and Schmidt stretching of the cube: inverse, derivative, direction of the turn."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swe_sphere import Simulation
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.cubed_sphere import Placement
from swe_sphere.mesh.sphere import frame, position


@settings(max_examples=60, deadline=None)
@given(
    lon=st.floats(-400.0, 400.0),
    lat=st.floats(-90.0, 90.0),
    spin=st.floats(-230.0, 230.0),
    stretch=st.floats(1.0, 100.0),
)
def test_any_placement_can_be_undone(lon: float, lat: float, spin: float, stretch: float) -> None:
    placement = Placement((lon, lat), spin, stretch)
    points = Mesh.build(2, 3).xyz
    placed = placement.place(points)
    assert np.abs(np.linalg.norm(placed, axis=-1) - 1.0).max() < 1e-15
    # a round trip loses at most the s^2 between refined and coarsened side
    assert np.abs(placement.lift(placed) - points).max() < 1e-14 * stretch**2
    centre = position(*np.radians((lon, lat)))
    assert np.abs(placement.place(np.array([1.0, 0.0, 0.0])) - centre).max() < 1e-14


@pytest.mark.parametrize("centre", [(0.0, 0.0), (29.0, -23.0)])
def test_spin_turns_the_cube_anticlockwise_about_its_centre(centre: tuple[float, float]) -> None:
    ahead = Placement(centre, spin=17.0).place(np.array([0.0, 1.0, 0.0]))
    east, north = frame(*np.radians(centre))
    assert math.degrees(math.atan2(ahead @ north, ahead @ east)) == pytest.approx(17.0)


@pytest.mark.parametrize(
    "placement",
    [Placement(), Placement((40.0, 23.0), 17.0), Placement((-109.0, 46.0), -11.0, 3.0)],
)
def test_tangents_are_the_derivative_of_the_placed_points(placement: Placement) -> None:
    points = Mesh.build(2, 4).xyz
    tangents = np.cross([0.3, -0.8, 0.5], points)
    step = 1e-5

    def along(angle: float) -> np.ndarray:
        moved = points + math.tan(angle) * tangents
        return placement.place(moved / np.linalg.norm(moved, axis=-1, keepdims=True))

    difference = (along(step) - along(-step)) / (2.0 * step)
    assert np.abs(placement.place_tangent(points, tangents) - difference).max() < 2e-9


def test_no_placement_keeps_every_bit() -> None:
    points = Mesh.build(2, 4).xyz
    assert np.array_equal(Placement().place(points), points)
    assert np.array_equal(Placement().lift(points), points)


def test_a_mesh_too_coarse_for_its_stretch_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"the areas of the nodes are 3\.5 of the sphere"):
        Simulation("williamson2", ne=4, np=4, stretch=100.0)
    assert Simulation("williamson2", ne=4, np=4, stretch=8.0).mesh.stretch == 8.0
