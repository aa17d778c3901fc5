"""Preconditioners: counts, reuse of the set-up, scaling, coarse spaces, refusals."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import warp as wp
from support import make_scene, nodal_values, relative
from threadpoolctl import threadpool_limits

from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.operators import sparse
from swe_sphere.operators.schur import SchurMatrix
from swe_sphere.planet import HOUR, Planet
from swe_sphere.solvers.krylov import FlexibleGMRES, LinearResult
from swe_sphere.solvers.preconditioners import PRECONDITIONERS, make_preconditioner
from swe_sphere.solvers.preconditioners.coarse import coarse_spaces
from swe_sphere.solvers.vector_space import VectorSpace
from swe_sphere.steppers import get_stepper
from swe_sphere.steppers.implicit import StageProblem
from swe_sphere.steppers.runge_kutta import RK4
from swe_sphere.steppers.stage_solver import energy_weights
from swe_sphere.testcases import get_scene

ELIMINATING = [name for name in PRECONDITIONERS if name != "none"]
STEPS = (1800.0, 3600.0, 7200.0, 14400.0)


@pytest.fixture(autouse=True, scope="module")
def _one_blas_thread():
    """As in implicit steppers: two libraries with threads of their own get in each other's way."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


# --- Krylov iterations of a Newton system


class Newton:
    """The first Newton system of the midpoint rule, six hours into williamson5."""

    def __init__(self, ne: int, stretch: float = 1.0, settings: tuple[str, ...] = ()) -> None:
        mesh = Mesh.build(ne, 4, stretch=stretch, centre=(270.0, 30.0))
        self.model = Model(mesh, apply_settings(get_scene("williamson5"), settings))
        self.model.for_solves = self.model  # linear systems in float64
        dt = HOUR / np.ceil((1.0 + len(settings)) * 0.5 * ne * stretch)
        stepper = RK4(self.model, dt)
        stepper.start(self.model.initial_state())
        for _ in range(round(6.0 * HOUR / dt)):
            stepper.step()
        self.state, self.rate = stepper.state, self.model.zeros()
        self.model.tendency(self.state, 0.0, self.rate)
        self.space = VectorSpace(energy_weights(self.model))
        self.gmres = FlexibleGMRES(self.space, 200)

    @functools.cache  # noqa: B019 - lives as long as the tests
    def problem(self, name: str) -> StageProblem:
        return StageProblem(self.model, self.space, name)

    def solve(self, name: str, dt: float, **options: float) -> LinearResult:
        problem = self.problem(name)
        problem.tau = 0.5 * dt
        if problem.precondition is not None:
            problem.precondition.update(self.state, problem.tau)
        problem.linearise(self.state)
        rhs, x = self.model.zeros(), self.model.zeros()
        self.space.axpy(problem.tau, self.rate, rhs)
        options = {"rtol": 1e-2, "max_iterations": 400} | options
        return self.gmres.solve(problem.jacobian, rhs, x, problem.precondition, **options)

    def counts(self, name: str, steps=STEPS) -> list[int]:
        results = [self.solve(name, dt) for dt in steps]
        assert all(result.converged for result in results)
        return [result.iterations for result in results]


newton = functools.cache(Newton)


@pytest.mark.parametrize("ne", [8, 16, pytest.param(32, marks=pytest.mark.thorough)])
def test_helmholtz_needs_few_iterations(ne: int) -> None:
    counts = newton(ne).counts("helmholtz")
    assert all(mine <= most for mine, most in zip(counts, (3, 4, 6, 10), strict=True)), counts


@pytest.mark.thorough
def test_hyperviscosity_takes_at_most_two_iterations_more() -> None:
    """Three at steps of four hours; without F in the Schur complement it takes many times more."""
    plain = newton(8).counts("helmholtz")
    damped = newton(8, 1.0, ("hyperviscosity.factor=30",)).counts("helmholtz")
    for without, among, more in zip(plain, damped, (2, 2, 2, 3), strict=True):
        assert among <= without + more, (plain, damped)


def test_exact_inverse_needs_hardly_more_at_large_steps() -> None:
    counts = newton(8).counts("helmholtz-direct")
    assert all(mine <= most for mine, most in zip(counts, (2, 3, 3, 4), strict=True)), counts


def test_counts_do_not_grow_with_resolution() -> None:
    coarse, fine = (newton(ne).counts("helmholtz", STEPS[:3]) for ne in (8, 16))
    for few, many in zip(coarse, fine, strict=True):
        assert many <= max(few + 1, 1.3 * few)


def test_counts_without_coarse_levels_grow_with_the_step() -> None:
    """What the good ones save: none needs several times their iterations."""
    few, many = (newton(16).counts(name, STEPS[1:3]) for name in ("helmholtz", "none"))
    assert many[0] > 4 * few[0] and many[1] > 8 * few[1], many
    assert many[1] > 1.8 * many[0]


@pytest.mark.parametrize("name", ELIMINATING)
def test_one_application_brings_the_solution_nearer(name: str) -> None:
    """By |d - M^-1 A d| on a rough d, and by the residual of GMRES after one iteration."""
    result = newton(8).solve(name, 1800.0, rtol=0.0, max_iterations=1)
    plain = newton(8).solve("none", 1800.0, rtol=0.0, max_iterations=1)
    assert result.residual < 0.9 * plain.residual < 0.9 * result.history[0]


@pytest.mark.parametrize("name", PRECONDITIONERS)
def test_all_find_the_same_solution(name: str) -> None:
    """To 1e-10 in float64, although most are single precision inside."""
    result = newton(8).solve(name, 1800.0, rtol=1e-10)
    assert result.converged
    assert result.residual <= 1e-10 * result.history[0]


@pytest.mark.parametrize("shape", ["element", "node"])
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", ELIMINATING)
@pytest.mark.thorough
def test_number_types_and_launch_shapes_agree(name: str, precision: str, shape: str) -> None:
    mesh = Mesh.build(2, 4, stretch=1.5, spin=17.0)
    scene = make_scene("advection", "pressure", "rotation")
    results = []
    for model in (Model(mesh, scene), Model(mesh, scene, precision=precision, shape=shape)):
        made = make_preconditioner(name, model)
        made.setup(model.initial_state(), 2000.0)
        r, out = model.device_mesh.upload(rough(model.size)), model.zeros()
        made.apply(r, out)
        results.append(out.numpy().astype(np.float64))
    assert relative(results[1], results[0], 3) < 2e-4


def rough(size: int, seed: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(size)


# --- reuse of the set-up


def applied(made, model: Model) -> np.ndarray:
    """The preconditioner times a rough vector."""
    out = model.zeros()
    made(wp.array(rough(model.size)), out)
    return out.numpy().copy()


def deeper(state: wp.array, factor: float) -> wp.array:
    """The state with its depth times a factor at one node."""
    values = state.numpy().copy()
    values[-7] *= factor
    return wp.array(values)


@pytest.fixture(scope="module")
def small():
    model = Model(Mesh.build(2, 4), make_scene("advection", "pressure", "rotation"))
    return model, model.initial_state()


@pytest.mark.parametrize("name", ELIMINATING)
def test_set_up_is_reused_until_much_changes(small, name: str) -> None:
    model, state = small
    made = make_preconditioner(name, model)
    counts = model.counters
    assert (counts["setups"], counts["setup_seconds"]) == (0, 0.0)
    made.setup(state, 1000.0)
    seconds, first = counts["setup_seconds"], applied(made, model)
    assert counts["setups"] == 1
    assert seconds > 0.0
    for factor, tau in ((1.0, 1000.0), (1.05, 1000.0), (1.0, 1050.0), (0.95, 960.0)):
        made.setup(deeper(state, factor), tau)
        assert (counts["setups"], counts["setup_seconds"]) == (1, seconds)
    assert np.array_equal(applied(made, model), first)
    for count, (factor, tau) in enumerate(((1.3, 1000.0), (1.3, 1500.0), (1.0, 700.0)), start=2):
        made.setup(deeper(state, factor), tau)
        assert counts["setups"] == count
    assert counts["setup_seconds"] > seconds
    assert counts["preconditioner_applications"] == 2


@pytest.mark.parametrize("name", ELIMINATING)
def test_nothing_stale_after_a_new_set_up(small, name: str) -> None:
    """Bit for bit that of an object that never saw the first; the same after a restart."""
    model, state = small
    used, fresh, restored = (make_preconditioner(name, model) for _ in range(3))
    used.setup(state, 4000.0)
    old = applied(used, model)
    used.setup(deeper(state, 1.5), 900.0)
    fresh.setup(deeper(state, 1.5), 900.0)
    restored.load_state_dict(used.state_dict())
    new = applied(used, model)
    assert relative(new, old, 3) > 1e-3
    assert np.array_equal(new, applied(fresh, model))
    assert np.array_equal(new, applied(restored, model))


def test_nothing_to_restore_before_the_first_set_up(small) -> None:
    model, _ = small
    made, other = (make_preconditioner("helmholtz", model) for _ in range(2))
    made.load_state_dict(other.state_dict())
    assert model.counters["setups"] == 0


# --- other units, other planets


def rescaled(scene: Scene, length: float, time: float, depth: float) -> Scene:
    """The same problem with other units of length, of time and, by its own unit, of depth."""
    speed, planet = length / time, scene.planet
    initial, bottom, coriolis = scene.initial, scene.bottom, scene.coriolis

    def start(lon, lat):
        u, v, h = initial(lon, lat)
        return speed * u, speed * v, depth * h

    return replace(
        scene,
        planet=Planet(
            length * planet.radius, speed**2 / depth * planet.gravity, planet.rotation / time
        ),
        initial=start,
        bottom=lambda lon, lat: depth * bottom(lon, lat),
        coriolis=lambda lon, lat: coriolis(lon, lat) / time,
    )


def costs_and_state(name: str, scales: tuple[float, float, float]):
    """Counters after three large steps of williamson5, and the state in the first units."""
    length, time, depth = scales
    scene = rescaled(get_scene("williamson5"), *scales)
    model = Model(Mesh.build(4, 4, radius=scene.planet.radius), scene)
    stepper = get_stepper("implicit-midpoint")(model, 7200.0 * time, preconditioner=name)
    stepper.start(model.initial_state())
    for _ in range(3):
        stepper.step()
    units = np.repeat([length / time, length / time, depth], model.mesh.size)
    counts = {name: n for name, n in stepper.counters.items() if name != "setup_seconds"}
    return counts, stepper.state.numpy() / units


UNITS = {
    "small planet": (1e-3, 1e-3, 1e-3),
    "slow planet": (3.0, 17.0, 0.7),
    "unit sphere and days": (1.0 / 6.37122e6, 1.0 / 86400.0, 1.0 / 5960.0),
    "depth in millimetres": (1.0, 1.0, 1e3),
}


@pytest.mark.parametrize("name", ["helmholtz", "none"])
@pytest.mark.parametrize("units", UNITS)
def test_counts_are_the_same_in_any_units(name: str, units: str) -> None:
    counters, state = reference(name)
    others, other = costs_and_state(name, UNITS[units])
    assert others == counters
    assert counters["newton_iterations"] >= 3
    assert relative(other, state, 3) < 1e-6


@functools.cache
def reference(name: str):
    return costs_and_state(name, (1.0, 1.0, 1.0))


# --- coarse spaces


def face_vertices(mesh: Mesh) -> np.ndarray:
    """(ne + 1, ne + 1) nodes at the element vertices of face 0, along xi1 and xi2."""
    ne = mesh.ne
    corners = mesh.nodes[: ne**2].reshape(ne, ne, mesh.np, mesh.np)
    found = np.zeros((ne + 1, ne + 1), dtype=int)
    for p in (0, 1):
        for q in (0, 1):
            found[p : ne + p, q : ne + q] = corners[:, :, -p, -q]
    assert np.array_equal(found[:-1, 1:], corners[:, :, 0, -1])
    return found


def coarse_bases(mesh: Mesh) -> list[sp.csr_array]:
    """Nodal values of smooth functions, and of modes in both, the first and second direction."""
    smooth, both, either = (nodal_values(mesh, space) for space in coarse_spaces(mesh))
    return [smooth, both, either[:, : both.shape[1]], either[:, both.shape[1] :]]


def coarse_functions(mesh: Mesh, envelope: np.ndarray) -> list[np.ndarray]:
    """Of each space its pattern times an envelope (ne-1, ne-1) on the inner vertices of face 0.

    Where the degree np - 1 is odd the pattern changes sign from vertex to vertex.
    """
    vertices = face_vertices(mesh)[1:-1, 1:-1]
    i, j = np.indices(vertices.shape)
    along_1, along_2 = (-1.0) ** ((mesh.np - 1) * i), (-1.0) ** ((mesh.np - 1) * j)
    functions, spaces = [], coarse_bases(mesh)
    for space, sign in zip(spaces, (1.0, along_1 * along_2, along_1, along_2), strict=True):
        rows = space[vertices.ravel()].toarray()
        coefficients = np.zeros(space.shape[1])
        coefficients[rows.argmax(axis=1)] = (sign * envelope).ravel()
        functions.append(space @ coefficients)
    return functions


@pytest.mark.parametrize("np_", [3, 4, 5, 8])
def test_coarse_spaces(np_: int) -> None:
    """Sizes; the smooth one adds up to 1; each function is 1 at its own vertex and local."""
    mesh = Mesh.build(4, np_)
    spaces = coarse_bases(mesh)
    vertices = 6 * mesh.ne**2 + 2
    shapes = [space.shape for space in spaces]
    assert shapes[1:] == [(mesh.size, n) for n in (vertices, vertices, vertices - 8)]
    cells = -(-(np_ - 1) // 3)
    assert shapes[0] == (mesh.size, 6 * (cells * mesh.ne) ** 2 + 2)
    assert np.allclose(spaces[0].sum(axis=1), 1.0, rtol=0.0, atol=1e-14)
    for space in spaces:
        largest = abs(space).max(axis=0).toarray().ravel()
        twice = np.abs(largest - 2.0) < 1e-14  # both directions of a cube corner together
        assert np.count_nonzero(twice) == (8 if space is spaces[2] else 0)
        assert np.allclose(largest[~twice], 1.0, rtol=0.0, atol=1e-14)
    together = np.concatenate([space.toarray() for space in spaces], axis=1)
    if np_ > 3:  # nearly all of 386 nodes there: a few functions too many
        assert np.linalg.matrix_rank(together) == together.shape[1]


@pytest.mark.parametrize("stretch", [1.0, 3.0])
@pytest.mark.parametrize("np_", [3, 4, 5, 8])
def test_spurious_patterns_have_no_discrete_gradient(np_: int, stretch: float) -> None:
    """Like constants, and on curved and stretched elements too; yet they are anything but flat."""
    mesh = Mesh.build(7, np_, stretch=stretch, centre=(40.0, 23.0))
    gradient, inner = sparse.gradient(mesh), inner_nodes(mesh)
    for function in coarse_functions(mesh, np.ones((6, 6)))[1:]:
        slope = (gradient @ function).reshape(2, -1)
        assert np.abs(slope[:, inner]).max() < 1e-13 * np.abs(slope).max()
        assert np.ptp(function[inner]) > 1.0


def inner_nodes(mesh: Mesh) -> np.ndarray:
    """Nodes of the elements of face 0 that are two away from its edges."""
    return np.unique(mesh.nodes[: mesh.ne**2].reshape(mesh.ne, mesh.ne, -1)[2:-2, 2:-2])


def quotients(ne: int, np_: int) -> np.ndarray:
    """Rayleigh quotients of -D G [m-2] for a bump over face 0 in each space, and the largest."""
    mesh = Mesh.build(ne, np_)
    gradient, weights = sparse.gradient(mesh), np.tile(mesh.area, 2)
    wave = np.sin(np.pi * np.arange(1, ne) / ne) ** 2
    square = (gradient.T @ (sp.diags_array(weights) @ gradient)).tocsr()
    mass = sp.diags_array(1.0 / mesh.area)
    largest = sla.eigs(mass @ square, 1, which="LM", return_eigenvectors=False, tol=1e-2)
    return np.array(
        [f @ square @ f / (mesh.area @ f**2) for f in coarse_functions(mesh, np.outer(wave, wave))]
        + [abs(largest[0])]
    )


@pytest.mark.parametrize("np_", [3, 4, 8])
def test_spurious_waves_are_as_slow_as_their_envelope(np_: int) -> None:
    """With ne doubled and the envelope kept the fastest wave is twice as fast, these are not.

    (The smooth space of np 8 has vertices between those of the elements: no function here.)
    """
    coarse, fine = quotients(6, np_), quotients(12, np_)
    growth = fine / coarse
    assert growth[-1] > 3.5
    assert np.all(growth[1 if np_ > 4 else 0 : -1] < 1.2)
    assert np.all(fine[1:-1] < 0.03 * fine[-1])


def test_computational_modes_pay_on_a_stretched_mesh(monkeypatch) -> None:
    system = newton(8, 4.0)
    (counts,) = system.counts("helmholtz", [3600.0])
    system.problem("helmholtz").precondition.load_state_dict({})

    def stiff(_: SchurMatrix, mass: sp.csr_array, *__: object) -> sp.csr_array:
        return 1e30 * sp.eye_array(mass.shape[0], format="csr")

    monkeypatch.setattr(SchurMatrix, "galerkin", stiff)
    (without,) = system.counts("helmholtz", [3600.0])
    assert without > 1.5 * counts, (without, counts)


# --- refusals


@pytest.mark.parametrize(("name", "np_"), [("helmholtz-direct", 4), ("jacobian-direct", 16)])
def test_too_large_is_refused_before_anything_is_built(name: str, np_: int) -> None:
    """On a mesh of ne 120, of which only the size is read."""
    size = 6 * (120 * (np_ - 1)) ** 2 + 2
    model = SimpleNamespace(mesh=SimpleNamespace(ne=120, np=np_, size=size))
    with pytest.raises(ConfigError, match=r"about \d+ GB; choose the preconditioner helmholtz "):
        PRECONDITIONERS[name](model)


def test_unknown_name_gets_the_nearest() -> None:
    model = Model(Mesh.build(1, 3), make_scene("pressure"))
    with pytest.raises(ConfigError, match="helmholtz-direct"):
        make_preconditioner("helmholtz-dirict", model)


@pytest.mark.parametrize("name", PRECONDITIONERS)
def test_prescribed_wind_gets_none(name: str) -> None:
    model = Model(Mesh.build(1, 3), make_scene("wind"))
    assert make_preconditioner(name, model) is None
