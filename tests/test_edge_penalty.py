"""The penalty on jumps of vorticity and divergence at edges of elements."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from support import IMPLICIT, harmonic, make_scene, random_state, relative, tangent, tendency

from swe_sphere import DiagonallyImplicit, Simulation
from swe_sphere.equations.effects import EdgePenalty, Hyperviscosity
from swe_sphere.equations.model import Model
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.local import field_kernel
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.split_diffusion import HeldPenalty
from swe_sphere.steppers.stepper import Stepper
from swe_sphere.testcases import get_scene

from .support import some

SPEED, C = 30.0, 0.02
EFFECT = EdgePenalty(C, SPEED)
STRETCHED = {"stretch": 2.0, "centre": (40.0, 23.0), "spin": 17.0}


def penalty_matrix(mesh: Mesh) -> np.ndarray:
    """The rate of the wind (2N, 2N) by dense matrices: -M^-1 C^T G (I - P) C.

    C takes divergence and vorticity in each element, G has gamma W J on its diagonal, and P is the
    projection on continuous functions that is orthogonal under G.
    """
    n, nodes, count = mesh.np, mesh.nodes.ravel(), mesh.elements * mesh.np**2
    scatter = np.zeros((count, mesh.size))
    scatter[np.arange(count), nodes] = 1.0
    line, elements = np.eye(n), np.eye(mesh.elements)
    along_1 = np.kron(elements, np.kron(mesh.derivative, line))
    along_2 = np.kron(elements, np.kron(line, mesh.derivative))
    dx = mesh.basis.reshape(count, 2, 2)  # [node, coordinate, east or north]
    jacobian = np.linalg.det(dx)
    covariant = [np.hstack([scatter * dx[:, i, k, None] for k in range(2)]) for i in range(2)]
    inverse = np.linalg.inv(dx)
    flux = [
        np.hstack([scatter * (jacobian * inverse[:, k, i])[:, None] for k in range(2)])
        for i in range(2)
    ]
    divergence = (along_1 @ flux[0] + along_2 @ flux[1]) / jacobian[:, None]
    curl = (along_1 @ covariant[1] - along_2 @ covariant[0]) / jacobian[:, None]
    areas = np.einsum("ij,eij->e", mesh.quadrature, mesh.jacobian)
    mass = np.tile(mesh.quadrature.ravel(), mesh.elements) * jacobian
    weight = np.repeat(C * SPEED * np.sqrt(areas), n * n) * mass
    projection = scatter @ ((scatter * weight[:, None]).T / (scatter.T @ weight)[:, None])
    jump = weight[:, None] * (np.eye(count) - projection)
    forms = sum(each.T @ jump @ each for each in (curl, divergence))
    rate: np.ndarray = -forms / np.tile(mesh.area, 2)[:, None]
    return rate


@pytest.fixture(scope="module", params=[{}, STRETCHED], ids=["plain", "stretched"])
def mesh(request) -> Mesh:
    return Mesh.build(2, 4, **request.param)


def penalised(mesh: Mesh, *names: str, **settings) -> Model:
    return Model(mesh, make_scene(*names).with_effect(EFFECT), **settings)


@pytest.mark.parametrize("shape", ["element", "node"])
def test_the_rate_is_that_of_dense_matrices(mesh, shape):
    model = penalised(mesh, shape=shape)
    state = random_state(model)
    rate = tendency(model, state)
    assert np.all(rate[2 * mesh.size :] == 0.0)
    expected = penalty_matrix(mesh) @ state[: 2 * mesh.size]
    assert relative(rate[: 2 * mesh.size], expected) < 1e-13


def test_float32_differs_by_rounding(mesh):
    model, rounded = penalised(mesh), penalised(mesh, precision="float32")
    state = random_state(model)
    assert 1e-9 < relative(tendency(rounded, state), tendency(model, state), 3) < 1e-4


def test_the_operator_is_symmetric_and_only_damps(mesh):
    """In the norm of kinetic energy; winds without jumps keep all of it."""
    rate = penalty_matrix(mesh)
    form = np.tile(mesh.area, 2)[:, None] * rate
    assert np.abs(form - form.T).max() < 1e-12 * np.abs(form).max()
    values = np.linalg.eigvalsh(0.5 * (form + form.T))
    assert values.max() < 1e-12 * -values.min()


def test_it_adds_to_the_other_terms(mesh):
    """Hyperviscosity, Coriolis force and drag beside it; tangent and right-hand side alike."""
    names = ("advection", "pressure", "rotation", "drag", "hyperviscosity")
    plain, model = Model(mesh, make_scene(*names)), penalised(mesh, *names)
    state = random_state(model)
    rate = penalty_matrix(mesh) @ state[: 2 * mesh.size]
    added = (tendency(model, state) - tendency(plain, state))[: 2 * mesh.size]
    assert relative(added, rate) < 1e-10
    change = random_state(model, seed=2)
    added = (tangent(model, state, change) - tangent(plain, state, change))[: 2 * mesh.size]
    assert relative(added, penalty_matrix(mesh) @ change[: 2 * mesh.size]) < 1e-10


def test_linearised_equations_damp_the_difference_from_the_base(mesh):
    model = penalised(mesh, "pressure", "linearised")
    base = model.parameters["base"].numpy()
    assert np.abs(tendency(model, base)).max() == 0.0
    moved = base + random_state(model)
    plain = Model(mesh, make_scene("pressure", "linearised"))
    added = (tendency(model, moved) - tendency(plain, moved))[: 2 * mesh.size]
    expected = penalty_matrix(mesh) @ (moved - base)[: 2 * mesh.size]
    assert relative(added, expected) < 1e-11


def test_a_stage_adds_its_own_part(mesh):
    model = penalised(mesh, "pressure")
    state = random_state(model)
    x, start, out = (model.device_mesh.upload(random_state(model, seed)) for seed in (1, 2, 3))
    model.right_hand_side(stage=(start, 100.0))(x, 0.0, out)
    expected = start.numpy() + 100.0 * tendency(model, state)
    np.testing.assert_allclose(out.numpy(), expected, rtol=1e-13)


@pytest.mark.parametrize("turned", [False, True], ids=["gradient", "rotated"])
def test_smooth_winds_are_hardly_damped(turned):
    """The rate falls at least as fast as the largest error of the derivatives, np - 1."""
    found = []
    for ne in (2, 4, 8):
        mesh = Mesh.build(ne, 5)
        model = Model(mesh, make_scene().with_effect(EFFECT))
        _, value, gradient, rotated = harmonic(mesh, "xyz")
        wind = mesh.radius * (rotated if turned else gradient)
        rate = tendency(model, np.concatenate([*wind, value]))[: 2 * mesh.size]
        weight = np.tile(mesh.area, 2)
        found.append(np.sqrt(np.sum(weight * rate**2) / np.sum(weight * wind.ravel() ** 2)))
    orders = np.log2(np.divide(found[:-1], found[1:]))
    assert orders.min() > 3.5 and found[-1] < 1e-9


def test_the_speed_is_that_of_the_initial_wind_unless_given():
    mesh = Mesh.build(2, 4)
    scene = get_scene("williamson2", alpha=1.0)
    u, v, _ = scene.initial(mesh.lon, mesh.lat)
    largest = float(np.sqrt(u**2 + v**2).max())
    by_default = Model(mesh, scene.with_effect(EdgePenalty(C)))
    given = Model(mesh, scene.with_effect(EdgePenalty(C, largest)))
    state = random_state(given)
    np.testing.assert_array_equal(tendency(by_default, state), tendency(given, state))


def test_energy_falls_and_mass_stays():
    sim = Simulation(
        "williamson6", ne=3, np=4, days=2, stepper="rk4", dt=600, effects={"edge-penalty.c": 0.01}
    )
    sim.run()
    assert -2e-3 < sim.diagnostics["energy_drift"] < -1e-6
    assert abs(sim.diagnostics["mass_drift"]) < 1e-14


THOROUGH = ("forward-backward", "semi-implicit", "bdf2", "epi3")


@pytest.mark.parametrize(
    "stepper", ["rk4", *(pytest.param(each, marks=pytest.mark.thorough) for each in THOROUGH)]
)
def test_a_tilted_steady_flow_keeps_its_accuracy_for_a_hundred_days(stepper):
    """Without the penalty computational modes grow tenfold in 9 days, up to an error of 0.4."""
    found = {}
    for c in (0.0, 0.01):
        sim = Simulation(
            "williamson2", ne=4, np=5, days=100 if c else 50, stepper=stepper,
            parameters={"alpha": 1.0}, effects={"edge-penalty.c": c},
        )  # fmt: skip
        sim.run()
        found[c] = sim.diagnostics["l2_v"]
    assert found[0.01] < 2e-4
    assert not found[0.0] < 1e-2


def test_it_takes_part_in_a_step_of_every_stepper():
    """A cycle of steps changes computational modes by what their rate is, in every method."""
    mesh = Mesh.build(2, 4)
    scene, damped = make_scene(), make_scene().with_effect(EFFECT)
    plain, model = Model(mesh, scene), Model(mesh, damped)
    state = random_state(model)
    rate = penalty_matrix(mesh) @ state[: 2 * mesh.size]
    for name, kind in STEPPERS.items():
        if kind.family == "imex" or name.startswith("mis"):
            continue  # these need waves
        unfiltered = {"strength": 0.0} if name == "leapfrog" else {}
        stepper = kind(model, 1.0, **unfiltered)
        stepper.start(model.device_mesh.upload(state))
        steps = stepper.penalty.every if stepper.penalty else 1
        for _ in range(steps):
            stepper.step()
        change = (stepper.state.numpy() - state)[: 2 * mesh.size]
        assert relative(change, steps * rate) < 1e-3, name
    assert np.all(tendency(plain, state) == 0.0)


@pytest.mark.parametrize("name", IMPLICIT)
def test_stages_contain_it_only_where_it_is_not_split(mesh, name):
    """Elsewhere products with the Jacobian launch the same kernels as without the penalty."""
    names = "pressure", "rotation"
    model, plain = penalised(mesh, *names), Model(mesh, make_scene(*names))
    dt = 0.5 / model.penalty_radius
    stepper = STEPPERS[name](model, dt)
    launched = [
        len(each.right_hand_side("tangent", base=each.zeros()).operations)
        for each in (stepper.model, plain, model)
    ]
    splits = name not in ("gauss-legendre", "esdirk4")
    assert launched[0] == launched[1 if splits else 2] and launched[1] < launched[2]
    assert stepper.order_in(model) == (min(stepper.order, 2) if splits else 4)


def test_stages_of_custom_implicit_methods_contain_it(mesh):
    class Custom(DiagonallyImplicit):
        """Implicit Euler in two stages."""

        name, order, a, b = "custom", 1, ((0.5,), (0.5, 0.5)), (0.5, 0.5)

    try:
        stepper = Custom(penalised(mesh, "pressure"), 600.0)
        assert stepper.model.penalised and stepper.penalty is None
    finally:
        del STEPPERS["custom"]


@pytest.mark.parametrize("name", ["esdirk4", "gauss-legendre"])
def test_separate_diffusion_leaves_it_in_the_stages(mesh, name):
    scene = make_scene("pressure", "hyperviscosity").with_effect(EFFECT)
    stepper = STEPPERS[name](Model(mesh, scene), 600.0, diffusion="apart")
    assert stepper.model.penalised and not stepper.model.diffusive
    assert stepper.diffusion is not None and stepper.penalty is None


def kinetic_energies(stepper: Stepper, count: int) -> list[float]:
    """Return twice the energy of the wind, up to a factor, before each step from a random state."""
    model, energies = stepper.model, []
    stepper.start(model.device_mesh.upload(random_state(model)))
    for _ in range(count):
        u, v, _ = np.split(stepper.state.numpy(), 3)
        energies.append(float(np.sum(model.mesh.area * (u**2 + v**2))))
        stepper.step()
    return energies


@pytest.mark.parametrize("reach", [0.2, 0.74, 2.0, 6.0])
@pytest.mark.parametrize("name", IMPLICIT)
def test_waves_of_any_phase_decay(name, reach):
    """Inertial waves of up to 4.4 radians a step: a rate that leads them would amplify them."""
    mesh, dt = Mesh.build(2, 4), 30000.0
    unit = Model(mesh, make_scene("rotation").with_effect(EdgePenalty(1.0, SPEED)))
    strength = reach / (dt * unit.penalty_radius)
    model = Model(mesh, make_scene("rotation").with_effect(EdgePenalty(strength, SPEED)))
    energies = kinetic_energies(STEPPERS[name](model, dt), 61)
    assert max(energies[20:]) < energies[0] and energies[60] <= energies[40] * (1.0 + 1e-9)


@pytest.mark.parametrize("name", some(["tr-bdf2", "bdf2", "esdirk4", "average-vector-field"]))
def test_the_penalty_is_of_second_order_in_long_steps(name):
    """A strong one, in a flow with slow modes only: errors against the penalty in the stages."""
    mesh = Mesh.build(2, 4)
    scene = make_scene("rotation").with_effect(EdgePenalty(0.2, SPEED))
    model = Model(mesh, scene)
    state, n = random_state(model), 2 * mesh.size
    matrix = np.stack([tendency(model, unit)[:n] for unit in np.eye(model.size)[:n]], axis=1)
    duration = 4.0 * 0.5 / model.penalty_radius
    exact = scipy.linalg.expm(duration * matrix) @ state[:n]
    errors = []
    for steps in (8, 16, 32):
        stepper = STEPPERS[name](model, duration / steps, tolerance=1e-9)
        stepper.start(model.device_mesh.upload(state))
        for _ in range(steps):
            stepper.step()
        errors.append(np.linalg.norm(stepper.state.numpy()[:n] - exact) / np.linalg.norm(exact))
    assert np.log2(errors[1] / errors[2]) > 1.8, errors


@pytest.mark.parametrize("name", IMPLICIT)
def test_steps_of_any_length_damp(name):
    """A step that is ten times as long as an explicit one of the penalty alone may be."""
    mesh = Mesh.build(2, 4)
    model = Model(mesh, make_scene("rotation").with_effect(EdgePenalty(C, 250.0 * SPEED)))
    energies = kinetic_energies(STEPPERS[name](model, 20.0 / model.penalty_radius), 12)
    assert energies[-1] < energies[0]


@pytest.mark.parametrize(
    ("scene", "effects", "said"),
    [
        ("splash", {"edge-penalty.c": 0.01}, "is zero: set edge-penalty.speed"),
        ("williamson1", {"edge-penalty.c": 0.01}, "prescribed wind has no jumps"),
        ("williamson2", {"edge-penalty.c": -1.0}, "edge-penalty.c must be"),
        ("williamson2", {"edge-penalty.c": 1e4}, "times what steps of .* s allow"),
        ("williamson2", {"edge-penalty.speed": float("inf")}, "edge-penalty.speed must be"),
    ],
)
def test_what_cannot_be_penalised_is_refused_in_one_line(scene, effects, said):
    with pytest.raises(ConfigError, match=said) as caught:
        Simulation(scene, ne=2, np=4, days=1, effects=effects).run()
    assert "\n" not in str(caught.value)


def test_a_long_run_without_dissipation_warns_of_computational_modes():
    """Nothing warns where the modes are damped, or where the run ends before they have grown."""
    found = []
    for days, effects in ((20.0, {}), (20.0, {"edge-penalty.c": "default"}), (5.0, {})):
        sim = Simulation("williamson2", ne=2, np=4, effects=effects)
        said: list[str] = []
        sim.run(days=days, warn=said.append)
        found.append(said)
    assert [len(said) for said in found] == [1, 0, 0]
    assert "tenfold in about 12 days" in found[0][0] and "edge-penalty.c=default" in found[0][0]


@pytest.mark.thorough
def test_the_penalty_acts_once_in_a_cycle_that_limits_no_step():
    mesh = Mesh.build(3, 4)
    scene = get_scene("williamson5")
    plain, model = Model(mesh, scene), Model(mesh, scene.with_effect(EdgePenalty()))
    for name in ("rk4", "forward-backward", "leapfrog", "semi-implicit"):
        kind = STEPPERS[name]
        radii = (kind.spectral_radii(x, x.initial_state()) for x in (plain, model))
        limits = [kind.stable_dt(each) for each in radii]
        assert limits[1] >= 0.97 * limits[0]
        penalty = kind(model, min(3600.0, kind.safety * limits[1])).penalty
        due = [step for step in range(3 * penalty.every) if penalty.is_due(step)]
        assert penalty.every % 2 == 0 and 2 <= penalty.every <= 24
        assert len(due) == 3 * (kind.diffusion_steps or 1)


def test_another_penalty_makes_no_other_kernels():
    mesh, scene = Mesh.build(2, 4), make_scene("rotation").with_effect(EFFECT)
    Model(mesh, scene)
    before = field_kernel.cache_info().currsize
    Model(mesh, scene)
    assert field_kernel.cache_info().currsize == before


def test_absent_penalties_leave_the_kernels_as_they_are():
    mesh = Mesh.build(2, 4)
    scene = get_scene("williamson2").with_effect(EdgePenalty(0.0))
    assert not Model(mesh, scene).diffusive
    assert Model(mesh, scene.with_effect(Hyperviscosity())).diffusive


def test_a_part_of_a_long_step_holds_the_rate_of_that_part():
    model = Model(Mesh.build(2, 4), make_scene("rotation").with_effect(EdgePenalty(C, SPEED)))
    state, slope = model.device_mesh.upload(random_state(model)), model.zeros()
    part = 5.0 / model.penalty_radius
    of_whole, of_part = (HeldPenalty(model, dt) for dt in (4.0 * part, part))
    for held in (of_whole, of_part):
        held.find(state, slope, 0.0, part)
    assert np.array_equal(of_whole.rate.numpy(), of_part.rate.numpy())


def test_a_penalty_too_weak_for_any_change_is_no_obstacle():
    sim = Simulation("lake-at-rest", ne=2, np=4, dt=600.0, effects={"edge-penalty.speed": 1e-200})
    assert sim.run(days=0.05).completed
