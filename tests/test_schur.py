"""Block elimination on the device and its Schur complement as a matrix."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp
from support import make_scene, nodal_values, relative, tangent

from swe_sphere.equations.model import Model
from swe_sphere.kernels.simd.memory import MOST_RUNS, in_runs
from swe_sphere.mesh import Mesh
from swe_sphere.operators import DeviceMesh, sparse
from swe_sphere.operators.device_mesh import REALS, Field
from swe_sphere.operators.schur import SchurMatrix, SchurOperator
from swe_sphere.solvers.preconditioners import make_preconditioner
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_steps, schur_bound
from swe_sphere.solvers.preconditioners.coarse import coarse_spaces
from swe_sphere.solvers.preconditioners.multilevel import Multilevel

TAU, GRAVITY = 3000.0, 9.8
ROUNDOFF = {"float64": 1e-12, "float32": 2e-5}
SHAPES = ("element", "node")


@functools.cache
def mesh_of(np_: int):
    """Few elements of that many nodes, stretched and turned."""
    return Mesh.build(
        {3: 3, 4: 2, 6: 2, 8: 1}[np_], np_, stretch=1.5, centre=(40.0, 23.0), spin=17.0
    )


def matrix_of(mesh) -> SchurMatrix:
    """With a Coriolis parameter for which tau f is about 1 in places."""
    return SchurMatrix(mesh, GRAVITY, 3e-4 * np.sin(2.0 * mesh.lat + mesh.lon))


def rough(size: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(size)


def depth_of(mesh) -> np.ndarray:
    return 1000.0 + 300.0 * np.cos(mesh.lat) * np.sin(mesh.lon)


class System:
    """A configured operator, its matrix, and the passage of vectors between numpy and device."""

    def __init__(self, np_: int, precision: str, shape: str, device: str = "cpu") -> None:
        mesh, model = mesh_of(np_), Model(mesh_of(np_), make_scene("pressure"), device)
        self.mesh, self.host, self.depth = mesh, matrix_of(mesh), depth_of(mesh)
        real = REALS[precision]
        on_device = DeviceMesh(mesh, model.device, real, shape)
        self.operator = SchurOperator(on_device, GRAVITY, self.host.coriolis, real)
        self.diagonal = self.host.diagonal(TAU, self.depth)
        self.operator.configure(TAU, self.depth)
        self.matrix = self.host.matrix(TAU, self.depth)
        self.up = on_device.upload

    def field(self, values: np.ndarray) -> Field:
        """Nodal values as a field."""
        field = self.operator.field()
        self.operator.put(values, field)
        return field

    @property
    def turn(self) -> np.ndarray:
        """T as (2, 2, N): east and north of (1 + tau f k x)^-1."""
        angle = TAU * self.host.coriolis
        return np.array([[1.0 + 0.0 * angle, angle], [-angle, 1.0 + 0.0 * angle]]) / (1 + angle**2)

    def turned(self, wind: np.ndarray) -> np.ndarray:
        """T V, (2N,)."""
        return np.einsum("abn,bn->an", self.turn, wind.reshape(2, -1)).ravel()


NPS = [4, *(pytest.param(np_, marks=pytest.mark.thorough) for np_ in (3, 8))]
"""Kernels are compiled for each np."""


@pytest.fixture(params=NPS)
def np_(request):
    """The number of nodes along the edge of an element."""
    return request.param


@pytest.fixture(params=[(p, s) for p in ROUNDOFF for s in SHAPES], ids=str)
def case(request, np_):
    """A system and how exact its number type is."""
    return System(np_, *request.param), ROUNDOFF[request.param[0]]


@pytest.mark.thorough
def test_elimination_against_matrices(case) -> None:
    system, tolerance = case
    n = system.mesh.size
    r, b = rough(3 * n, 1), system.operator.field()
    system.operator.eliminate(system.up(r), b)
    flux = np.tile(system.depth, 2) * system.turned(r[: 2 * n])
    inflow = sparse.divergence(system.mesh) @ flux
    assert relative(system.operator.fetch(b), r[2 * n :] - TAU * inflow) < tolerance


def test_substitution_against_matrices(case) -> None:
    system, tolerance = case
    n = system.mesh.size
    r, h, out = rough(3 * n, 1), 100.0 * rough(n, 2), system.up(np.zeros(3 * n))
    system.operator.substitute(system.up(r), system.field(h), out)
    wind = system.turned(r[: 2 * n] - TAU * GRAVITY * (sparse.gradient(system.mesh) @ h))
    assert relative(out.numpy(), np.concatenate([wind, h])) < tolerance
    assert relative(out.numpy()[2 * n :], h) < tolerance


def test_product_and_residual_against_the_matrix(case) -> None:
    system, tolerance = case
    d, b = rough(system.mesh.size, 3), rough(system.mesh.size, 4)
    out, given, x = system.operator.field(), system.field(b), system.field(d)
    product = system.matrix @ d
    system.operator.apply(x, out)
    assert relative(system.operator.fetch(out), product) < tolerance
    system.operator.residual(given, x, out)
    assert relative(system.operator.fetch(out), b - product) < tolerance
    for mine, before in ((given, b), (x, d)):
        assert relative(system.operator.fetch(mine), before) < tolerance


def test_chebyshev_steps_against_the_matrix(case) -> None:
    """One from given vectors, and one from zero, whatever was there."""
    system, tolerance = case
    b, x = (rough(system.mesh.size, seed) for seed in (5, 6))
    given, ours = system.field(b), system.field(x)
    system.operator.chebyshev_step(1.7, given, ours)
    theirs = x + 1.7 * (b - system.matrix @ x) / system.diagonal
    assert relative(system.operator.fetch(ours), theirs) < tolerance
    system.operator.chebyshev_start(1.7, given, ours)
    assert relative(system.operator.fetch(ours), 1.7 * b / system.diagonal) < tolerance
    assert relative(system.operator.fetch(given), b) < tolerance


def test_matrix_is_what_elimination_leaves_of_the_model() -> None:
    """S = A_hh - A_hV A_VV^-1 A_Vh of the dense I - tau J of the model at rest, rotation on."""
    mesh = mesh_of(3)
    model, rest = Model(mesh, make_scene("pressure", "rotation")), at_rest(mesh)
    n, eye = mesh.size, np.eye(3 * mesh.size)
    jacobian = np.stack([tangent(model, rest, column) for column in eye], axis=1)
    a, two = eye - TAU * jacobian, slice(0, 2 * n)
    wind = np.linalg.solve(a[two, two], a[two, 2 * n :])
    complement = a[2 * n :, 2 * n :] - a[2 * n :, two] @ wind
    host = SchurMatrix(mesh, model.scene.planet.gravity, model.coriolis)
    assert relative(host.matrix(TAU, rest[2 * n :]).toarray(), complement) < 1e-11


def at_rest(mesh) -> np.ndarray:
    return np.concatenate([np.zeros(2 * mesh.size), np.full(mesh.size, 2000.0)])


@pytest.mark.parametrize("rotation", [(), ("rotation",)], ids=["still", "rotating"])
@pytest.mark.parametrize("np_", [4, 8])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.thorough
def test_direct_is_the_inverse_of_the_model_at_rest(np_: int, rotation, shape: str) -> None:
    """Both ways round: M^-1 (I - tau J) d = d and (I - tau J) M^-1 r = r."""
    mesh = mesh_of(np_)
    model, rest = Model(mesh, make_scene("pressure", *rotation), shape=shape), at_rest(mesh)
    direct = make_preconditioner("helmholtz-direct", model)
    direct.setup(wp.array(rest), TAU)
    d, out = rough(3 * mesh.size, 8), model.zeros()
    direct.apply(wp.array(d - TAU * tangent(model, rest, d)), out)
    assert relative(out.numpy(), d, 3) < 1e-10
    direct.apply(wp.array(d), out)
    assert relative(out.numpy() - TAU * tangent(model, rest, out.numpy()), d, 3) < 1e-10


@pytest.mark.parametrize("precision", ROUNDOFF)
def test_diagonal_and_bound_on_the_spectrum(np_: int, precision: str) -> None:
    """The spectrum of S over its diagonal stays below the bound, and not far below it."""
    system = System(np_, precision, "element")
    dense = system.matrix.toarray()
    assert relative(system.diagonal, np.diag(dense)) < 1e-13
    largest = np.abs(np.linalg.eigvals(dense / system.diagonal[:, None])).max()
    bound = schur_bound(system.operator)
    assert largest <= bound <= 1.06 * largest


@pytest.mark.parametrize("np_", [3, 4, 8])
def test_slopes_of_coarse_functions_are_those_of_the_whole_gradient(np_: int) -> None:
    mesh = mesh_of(np_)
    spaces = [space for space in coarse_spaces(mesh) if space.numbers.max() >= 0]
    for space in spaces:
        whole = sparse.gradient(mesh) @ nodal_values(mesh, space)
        assert relative(sparse.gradients(mesh, space).toarray(), whole.toarray()) < 1e-13


def test_galerkin_is_the_symmetric_part() -> None:
    host = matrix_of(mesh_of(4))
    n, depth = host.mesh.size, depth_of(host.mesh)
    weighted = host.mesh.area[:, None] * host.matrix(TAU, depth).toarray()
    basis = sp.csr_array(rough(n * 12, 9).reshape(n, 12))
    expected = basis.T @ (0.5 * (weighted + weighted.T)) @ basis
    assert np.abs(weighted - weighted.T).max() > 1e-3 * np.abs(weighted).max()
    mass = basis.T @ sp.diags_array(host.mesh.area) @ basis
    ours = host.galerkin(mass, (sparse.gradient(host.mesh) @ basis).tocsr(), TAU, depth)
    assert relative(ours.toarray(), expected) < 1e-12


def smoothing_constant(sizes: list[float], largest: float) -> float:
    """max t p²/(1 - p²) over the largest eigenvalue, of the error polynomial p of the steps.

    It decides the bound on a V-cycle, Lottes 2023, doi:10.1002/nla.2518.
    """
    t = np.linspace(1e-4, 1.0, 20001) * largest
    p = np.prod([1.0 - size * t for size in sizes], axis=0)
    assert np.abs(p).max() < 1.0
    return float(np.max(t * p**2 / (1.0 - p**2)) / largest)


@pytest.mark.parametrize("degree", range(1, 17))
def test_chebyshev_steps_have_the_optimal_smoothing_constant(degree: int) -> None:
    """1/(4/pi² (2k + 1)² - 2/3) to a per cent; plain fourth-kind steps have a larger one."""
    constant = smoothing_constant(chebyshev_steps(degree, 2.5), 2.5)
    best = 1.0 / (4.0 / np.pi**2 * (2 * degree + 1) ** 2 - 2.0 / 3.0)
    assert constant == pytest.approx(best, rel=1e-2)
    plain = 0.4 / np.sin(np.pi * np.arange(1, degree + 1) / (2 * degree + 1)) ** 2
    assert constant < 0.9 * smoothing_constant(plain, 2.5)


@pytest.mark.parametrize("degree", range(1, 17))
def test_rounding_errors_of_chebyshev_steps_stay_small(degree: int) -> None:
    """An error made between any two steps grows up to thirtyfold; with ascending sizes 5e6-fold."""
    t, sizes = np.linspace(0.0, 1.0, 2001), chebyshev_steps(degree, 1.0)
    for left in range(1, degree):
        assert np.prod([np.abs(1.0 - size * t) for size in sizes[-left:]], axis=0).max() < 30.0


@pytest.mark.parametrize("np_", [3, 6])
@pytest.mark.parametrize(("tau", "most"), [(TAU, 0.15), (60.0 * TAU, 0.95)])
def test_multilevel_reduces_every_error_in_conjugate_gradients(
    tau: float, most: float, np_: int
) -> None:
    """Without rotation, errors are measured in the norm of S, which conjugate gradients minimise.

    At the larger step it makes more cycles than one at np 3, and more Chebyshev steps at np 6.
    """
    mesh = mesh_of(np_)
    model = Model(mesh, make_scene("pressure"))
    on_device = DeviceMesh(mesh, model.device, wp.float32, model.shape)
    host = SchurMatrix(mesh, GRAVITY, np.zeros(mesh.size))
    operator = SchurOperator(on_device, GRAVITY, host.coriolis, wp.float32)
    depth = depth_of(mesh)
    operator.configure(tau, depth)
    inner = Multilevel(operator, smooths_first=True)
    b, x = operator.field(), operator.field()
    inner.setup(tau, depth)
    columns = []
    for unit in np.eye(mesh.size):
        operator.put(unit, b)
        inner.solve(b, x)
        columns.append(operator.fetch(x))
    matrix = host.matrix(tau, depth).toarray()
    left = np.eye(mesh.size) - np.stack(columns, axis=1) @ matrix
    root = np.linalg.cholesky(mesh.area[:, None] * matrix).T
    assert np.linalg.norm(root @ left @ np.linalg.inv(root), 2) < most


@pytest.mark.parametrize(
    ("np_", "precision"),
    [
        (4, "float64"),
        pytest.param(6, "float32", marks=pytest.mark.thorough),
        pytest.param(8, "float32", marks=pytest.mark.thorough),
    ],
)
def test_all_elements_of_a_node_hold_the_same_bits(np_: int, precision: str) -> None:
    """After coarse corrections and smoothing, so that ranks need not ask whose is the first."""
    system = System(np_, precision, "element")
    inner = Multilevel(system.operator)
    system.operator.configure(TAU, system.depth)
    inner.setup(TAU, system.depth)
    x, mesh = system.operator.field(), system.operator.mesh
    inner.solve(system.field(rough(mesh.size, 8)), x)
    places, numbers = mesh.places(1).numpy(), x.flat.numpy()
    first, empty = numbers[places[:, :1]], mesh.groups * mesh.points * mesh.lanes
    assert np.ptp(first) > 0.0
    assert np.all((numbers[places] == first) | (places < 0) | (places == empty))


def test_diffusion_keeps_the_number_of_chebyshev_steps_of_short_steps() -> None:
    """More of them would amplify waves that diffusion damps, since D is that of S without it."""
    counts = []
    for effects in (["pressure"], ["pressure", "hyperviscosity"]):
        model = Model(mesh_of(6), make_scene(*effects))
        made = make_preconditioner("helmholtz", model)
        made.setup(model.initial_state(), 60.0 * TAU)
        counts.append(len(made._multilevel._last))
    assert counts[0] > counts[1] == 5


@pytest.mark.parametrize("lanes", [8, 16])
def test_every_register_of_places_is_found_in_its_runs(lanes: int) -> None:
    """Registers of one to five runs, of which the kernel has a branch for each kind."""
    places = np.arange(lanes) + 100 * np.random.default_rng(1).integers(0, 9, (400, 1))
    cuts = np.sort(np.random.default_rng(2).integers(1, lanes, (400, 4)), axis=1)
    for row, cut in enumerate(cuts):
        for begin in cut[: row % 5]:
            places[row, begin:] += 7 + begin
    runs, others = in_runs(places.reshape(20, 20, lanes))
    runs, lane = runs.reshape(400, -1), np.arange(lanes)
    start = runs[:, :1]
    for k in range(1, MOST_RUNS):
        start = np.where(lane < runs[:, MOST_RUNS - 1 + k, None], start, runs[:, k, None])
    found, count = start + lane, runs[:, -1]
    found[count < 0] = others[runs[count < 0, 0]]
    np.testing.assert_array_equal(found, places)
    np.testing.assert_array_equal(np.unique(count), [-1, 1, 2, 3, 4])
    assert not np.any(runs[count == 2, 5:7] < lanes)  # the kernel skips the third and fourth run
