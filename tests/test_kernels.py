"""Right-hand sides and tangents against an independent formulation, in both launch shapes."""

from __future__ import annotations

from itertools import compress, product

import numpy as np
import pytest
from cartesian import Cartesian
from support import make_scene, random_state, relative, tangent, tendency

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh

SHAPES = ("element", "node")
DYNAMICS = ("advection", "pressure", "rotation", "orography")
FULL = (*DYNAMICS, "viscosity", "hyperviscosity")
ROUND_OFF = 1e-12


def three_at_a_time() -> list[tuple[str, ...]]:
    """Sets of effects in which any three are on and off in every combination, and prescribed winds.

    An orthogonal array of strength three (16 runs, resolution IV, generators abc and abd; Box,
    Hunter and Hunter, Statistics for Experimenters): what goes wrong between two or three effects
    shows in one of its sets.
    """
    rows = ((a, b, c, d, a ^ b ^ c, a ^ b ^ d) for a, b, c, d in product((0, 1), repeat=4))
    sets = [tuple(compress(FULL, row)) for row in rows if any(row)]
    carried = [("wind", *c) for c in ((), ("viscosity",), ("orography", "hyperviscosity"))]
    return sets + carried


def check(mesh, names, shape, precision, bound) -> None:
    scene = make_scene(*names)
    model = Model(mesh, scene, shape=shape, precision=precision)
    state = random_state(model)
    expected = Cartesian(mesh, scene).tendency(state, 0.25)
    assert relative(tendency(model, state, 0.25), expected, len(model.names)) < bound


@pytest.mark.parametrize("np_", range(3, 17))
@pytest.mark.thorough
def test_node_shape_for_every_np(np_: int) -> None:
    check(Mesh.build(1, np_, spin=11.0), DYNAMICS, "node", "float64", ROUND_OFF)


@pytest.mark.parametrize("np_", [3, 5, 8, 11, 16])
def test_element_shape_for_many_np(np_: int) -> None:
    check(Mesh.build(1, np_, spin=11.0), DYNAMICS, "element", "float64", ROUND_OFF)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("np_", [4, pytest.param(7, marks=pytest.mark.exhaustive)])
@pytest.mark.thorough
def test_single_precision(np_: int, shape: str) -> None:
    check(Mesh.build(2, np_), FULL, shape, "float32", 1e-5)


@pytest.mark.parametrize("ne", [1, 3])
def test_element_groups_that_are_not_full(ne: int) -> None:
    """6 ne² elements do not fill groups of eight lanes for odd ne."""
    mesh = Mesh.build(ne, 4, stretch=2.0, centre=(57.0, -29.0))
    check(mesh, FULL, "element", "float64", ROUND_OFF)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("names", three_at_a_time(), ids="+".join)
@pytest.mark.thorough
def test_combinations_of_effects(small_mesh, names, shape) -> None:
    """The right-hand side, and its tangent by a complex step and by the exact difference."""
    scene = make_scene(*names)
    model, check = Model(small_mesh, scene, shape=shape), Cartesian(small_mesh, scene)
    blocks = len(model.names)
    state, direction = random_state(model), 0.1 * random_state(model, seed=2)
    ours = tendency(model, state, 0.25)
    assert relative(ours, check.tendency(state, 0.25), blocks) < ROUND_OFF
    product = tangent(model, state, direction, 0.25)
    complex_step = check.tendency(state + 1e-30j * direction, 0.25).imag / 1e-30
    assert relative(product, complex_step, blocks) < ROUND_OFF
    plus, minus = (tendency(model, state + s * direction, 0.25) for s in (1.0, -1.0))
    floor = np.repeat([np.abs(part).max() for part in np.split(plus, blocks)], small_mesh.size)
    assert np.abs((0.5 * (plus - minus) - product) / np.maximum(floor, 1e-300)).max() < ROUND_OFF


@pytest.mark.parametrize("names", [FULL, ("wind", "viscosity")], ids="+".join)
def test_both_shapes_agree(small_mesh, names) -> None:
    models = [Model(small_mesh, make_scene(*names), shape=shape) for shape in SHAPES]
    state = random_state(models[0])
    element, node = (tendency(model, state) for model in models)
    assert relative(element, node, len(models[0].names)) < ROUND_OFF
