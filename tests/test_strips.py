"""Launches strip by strip: the same bits as one launch after the other, whatever they compute."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import thorough

from swe_sphere import Mesh, Simulation
from swe_sphere.equations.effects import EdgePenalty, Hyperviscosity, Tracers
from swe_sphere.equations.model import Model
from swe_sphere.mesh import partition
from swe_sphere.mesh.partition import Partition, single_part
from swe_sphere.operators import replay, strips
from swe_sphere.solvers.preconditioners.multilevel import schur_operator
from swe_sphere.steppers.stepper import STEPPERS
from swe_sphere.testcases import get_scene

EXPLICIT = [name for name, cls in STEPPERS.items() if cls.family == "explicit"]
STEPS = 24


@pytest.fixture(autouse=True)
def narrow(monkeypatch):
    """Strips as narrow as they can be, so that small meshes have several."""
    monkeypatch.setattr(strips, "NODES", 1)


@pytest.fixture
def waves(monkeypatch):
    """The waves that are launched, with the number of their launches."""
    seen, call = [], strips.StripLaunches.__call__
    monkeypatch.setattr(
        strips.StripLaunches, "__call__", lambda of, n: (seen.append(len(of._rows)), call(of, n))[1]
    )
    return seen


def moved(monkeypatch, mesh, scene, name, in_rings, most=STEPS, **options):
    """All fields, in the order of the mesh, after some steps."""
    monkeypatch.setattr(partition, "RINGED", 0 if in_rings else 10**9)
    model = Model(mesh, scene, **options)
    assert (model.device_mesh.strips is not None) == in_rings
    stepper = STEPPERS[name](model, 20.0)
    stepper.start(model.initial_state())
    while stepper.steps < STEPS:
        stepper.take(min(most, STEPS - stepper.steps))
    return model.fields(stepper.state)


def check(monkeypatch, *case, **options):
    plain = moved(monkeypatch, *case, in_rings=False, **options)
    cut = moved(monkeypatch, *case, in_rings=True, **options)
    for name, values in plain.items():
        assert np.isfinite(values).all()
        np.testing.assert_array_equal(cut[name], values)


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "float64") for name in EXPLICIT),
        *(thorough(name, "float32") for name in EXPLICIT),
    ],
)
def test_explicit_steps_have_the_same_bits(monkeypatch, waves, name, precision):
    """On a mesh whose elements do not fill whole groups."""
    check(monkeypatch, Mesh.build(5, 4), get_scene("williamson5"), name, precision=precision)
    assert waves


@pytest.mark.parametrize(
    "ne, points",
    [(1, 4), thorough(1, 3), (2, 8), thorough(3, 5), (7, 4), thorough(9, 3), thorough(2, 16)],
)
@pytest.mark.parametrize("name", ["rk4", "forward-backward"])
def test_meshes_of_all_shapes_have_the_same_bits(monkeypatch, ne, points, name):
    mesh = Mesh.build(ne, points, stretch=3.0, centre=(120.0, 40.0))
    check(monkeypatch, mesh, get_scene("williamson6"), name)


def with_everything():
    """Tracers with a limiter, hyperviscosity and the edge penalty."""
    scene, bells = get_scene("williamson5"), get_scene("deformational").tracers
    effects = Tracers(limiter=True), Hyperviscosity(1e16), EdgePenalty()
    return replace(scene, effects=(*scene.effects, *effects), tracers=bells)


@pytest.mark.parametrize("name", ["rk4", "leapfrog", "forward-backward", "fb-rk3", "mis2"])
@pytest.mark.parametrize(
    "scene", [with_everything, *map(get_scene, ("williamson4", "deformational"))]
)
def test_effects_and_tracers_have_the_same_bits(monkeypatch, name, scene):
    scene = scene() if callable(scene) else scene
    check(monkeypatch, Mesh.build(3, 4), scene, name)


def test_recorded_products_with_damping_have_the_same_bits(monkeypatch, waves):
    """The damped field is no memory in which preceding strips store fluxes."""
    monkeypatch.setattr(partition, "RINGED", 0)
    model = Model(Mesh.build(4, 4), get_scene("williamson5").with_effect(Hyperviscosity()))
    operator = schur_operator(model, model.coriolis, wp.float32, wp.float64, model.damping)
    operator.configure(3600.0, np.full(model.mesh.size, 5000.0))
    x, out = operator.field(), operator.field()
    operator.put(np.random.default_rng(1).standard_normal(model.mesh.size), x)
    operator.apply(x, out)
    expected, repeat = operator.fetch(out), replay.Replay(operator.mesh.launch)
    for _ in range(3):
        repeat("product", operator.apply, x, out)
        np.testing.assert_array_equal(operator.fetch(out), expected)
    assert waves


@pytest.mark.parametrize("name", ["forward-backward", "leapfrog"])
@pytest.mark.parametrize("c", [0.01, 4.0])
def test_the_edge_penalty_acts_between_steps_taken_at_once(monkeypatch, waves, name, c):
    """The penalty acts in the middle of its cycle, whose length depends on its strength."""
    scene = get_scene("williamson5").with_effect(EdgePenalty(c))
    case = Mesh.build(3, 4), scene, name
    monkeypatch.setitem(globals(), "STEPS", 80)
    check(monkeypatch, *case)
    if c < 1.0:
        moved(monkeypatch, *case, in_rings=True, most=1)
        alone = waves[-1]
        moved(monkeypatch, *case, in_rings=True)
        assert STEPPERS[name].fused_steps * alone in waves


def test_a_step_of_rk4_is_one_wave(monkeypatch, waves):
    moved(monkeypatch, Mesh.build(4, 4), get_scene("williamson5"), "rk4", in_rings=True, most=1)
    assert len(waves) == STEPS - 1 and len({*waves}) == 1 and waves[0] > 3 * 4


@pytest.mark.parametrize("name", ["rk4", "kg5", "forward-backward", "fb-rk3", "leapfrog"])
def test_several_steps_are_one_wave_if_nothing_is_due_between(monkeypatch, waves, name):
    case = Mesh.build(4, 4), get_scene("williamson5"), name
    moved(monkeypatch, *case, in_rings=True, most=1)
    alone = waves[-1]
    moved(monkeypatch, *case, in_rings=True)
    assert STEPPERS[name].fused_steps * alone in waves


def test_launches_that_are_not_cut_stay_in_their_place(monkeypatch, waves):
    """A copy between two launches separates two waves."""
    monkeypatch.setattr(partition, "RINGED", 0)
    model = Model(Mesh.build(3, 4), get_scene("williamson5"))
    x, once, twice = model.initial_state(), model.zeros(), model.zeros()
    repeated = replay.Replay(model.launch)

    def block():
        model.tendency(x, 0.0, once)
        wp.copy(twice, once)
        model.tendency(twice, 0.0, once)

    found = []
    for _ in range(3):
        repeated("key", block)
        found.append((once.numpy().copy(), twice.numpy().copy()))
    assert len(waves) == 2 * 2
    for values in found[1:]:
        np.testing.assert_array_equal(values, found[0])


@pytest.mark.parametrize("ranks", [1, 2, 3])
@pytest.mark.parametrize("ne", [1, 4, 7, 12])
def test_reach_covers_all_nodes_of_a_strip(monkeypatch, ne, ranks):
    """No strip reads a node that is complete only `reach` strips later, or more.

    The rim, if there is one, is the strip that follows the others.
    """
    monkeypatch.setattr(partition, "RINGED", 0)
    mesh, lanes = Mesh.build(ne, 4), 8
    parts = [single_part(mesh, "element")]
    if ranks > 1:
        parts = [Partition(mesh, ranks).part(rank) for rank in range(ranks)]
    for part in parts:
        away = part.interior_elements
        if away == 0:
            continue
        cut = strips.Strips(part, -(-away // lanes), lanes)
        done = np.full(part.node_numbers.size, -1)
        for begin, end, starts, on_rim in cut.spans:
            assert on_rim == (starts is None)
            if not on_rim:
                done[begin:end] = np.searchsorted(starts, np.arange(begin, end), "right") - 1
        group = np.arange(part.element_numbers.size) // lanes
        strip = np.searchsorted(cut.groups.starts, group, "right") - 1
        strip[away:] = -1
        ahead = strip[:, None, None] - done[part.nodes]
        assert ahead[:away].min() >= 0
        assert max(ahead.max(), -ahead.min()) == cut.groups.reach


def test_checkpoints_do_not_depend_on_the_order(monkeypatch, tmp_path):
    """A run that stopped in one order resumes in the other, with the same bits."""
    final = []
    for first, second in ((0, 10**9), (10**9, 0), (0, 0)):
        monkeypatch.setattr(partition, "RINGED", first)
        half = Simulation("williamson5", stepper="forward-backward", ne=3, np=4, days=0.25, dt=600)
        half.run()
        path = half.checkpoint(tmp_path / f"{first}_{second}.npz")
        monkeypatch.setattr(partition, "RINGED", second)
        whole = Simulation.from_checkpoint(path)
        whole.run(days=0.5)
        final.append(whole.state)
    for other in final[1:]:
        assert other.drop_attrs().identical(final[0].drop_attrs())
