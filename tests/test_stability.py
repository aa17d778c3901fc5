"""Limits of the time step: the spectrum of the discrete operator, and what the limits are worth."""

from __future__ import annotations

import numpy as np
import pytest
from support import EXPLICIT, make_scene, random_state, thorough

from swe_sphere.equations.effects import Drag, Viscosity
from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.steppers import STEPPERS, stability
from swe_sphere.steppers.leapfrog import Leapfrog, filtered_factor
from swe_sphere.steppers.runge_kutta import RungeKutta
from swe_sphere.steppers.stability import GROWTH_TIME, NO_GROWTH
from swe_sphere.testcases import get_scene


def coefficients(name: str, *attributes: str) -> dict[str, object]:
    """Return the coefficients of a stepper of the package."""
    return {attribute: getattr(STEPPERS[name], attribute) for attribute in attributes}


WAVES = ("advection", "pressure", "rotation")


def jacobian(model: Model, state, operator) -> np.ndarray:
    """The dense Jacobian by exact differences of a quadratic right-hand side."""
    base = state.numpy()
    columns = []
    plus, minus = model.zeros(), model.zeros()
    for unit in np.eye(model.size):
        for sign, out in ((1.0, plus), (-1.0, minus)):
            operator(model.device_mesh.upload(base + sign * 10.0 * unit), out)
        columns.append((plus.numpy() - minus.numpy()) / 20.0)
    return np.stack(columns, axis=1)


def states(model: Model) -> dict[str, np.ndarray]:
    """At rest, and in smooth motion over a varying depth."""
    n, lat = model.mesh.size, model.mesh.lat
    rest = np.concatenate([np.zeros(2 * n), np.full(n, 3000.0)])
    u, depth = 60.0 * np.cos(lat), 3000.0 - 1000.0 * np.sin(lat) ** 2
    flow = np.concatenate([u, 10.0 * np.cos(model.mesh.lon), depth])
    return {"rest": rest, "flow": flow}


@pytest.mark.parametrize(("ne", "np_"), [(1, 3), (1, 4), thorough(2, 3), thorough(2, 4)])
@pytest.mark.parametrize("kind", ["rest", "flow"])
def test_wave_spectrum_against_dense_eigenvalues(ne: int, np_: int, kind: str) -> None:
    model = Model(Mesh.build(ne, np_), make_scene(*WAVES))
    state = model.device_mesh.upload(states(model)[kind])
    matrix = jacobian(model, state, lambda x, out: model.tendency(x, 0.0, out))
    exact = np.abs(np.linalg.eigvals(matrix)).max()
    assert model.spectral_radii(state).wave == pytest.approx(exact, rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("effect", ["viscosity", "hyperviscosity"])
def test_dissipation_spectrum_against_dense_eigenvalues(effect: str) -> None:
    model = Model(Mesh.build(2, 3), make_scene(*WAVES, effect))
    state = model.device_mesh.upload(states(model)["flow"])
    exact = np.abs(np.linalg.eigvals(jacobian(model, state, model.dissipative_tendency))).max()
    assert model.spectral_radii(state).dissipation == pytest.approx(exact, rel=0.02)


def test_advection_spectrum_against_dense_eigenvalues() -> None:
    model = Model(Mesh.build(2, 4), get_scene("williamson1", alpha=0.7))
    state = model.initial_state()
    matrix = jacobian(model, state, lambda x, out: model.tendency(x, 0.0, out))
    exact = np.abs(np.linalg.eigvals(matrix)).max()
    assert model.spectral_radii(state).wave == pytest.approx(exact, rel=0.02)


def growth(name: str, model: Model, dt: float, steps: int) -> float:
    """Growth of a small random perturbation of a fluid at rest."""
    rest = states(model)["rest"]
    noise = 1e-6 * (random_state(model) - random_state(model, 2))
    stepper = STEPPERS[name](model, dt)
    stepper.start(model.device_mesh.upload(rest + noise))
    with np.errstate(all="ignore"):
        for _ in range(steps):
            stepper.step()
        last = np.linalg.norm(stepper.state.numpy() - rest) / np.linalg.norm(noise)
    return float(last) if np.isfinite(last) else np.inf


@pytest.mark.parametrize("nu", [0.0, 3e7], ids=["inviscid", "viscous"])
@pytest.mark.parametrize("name", EXPLICIT)
def test_the_limit_is_a_limit(name: str, nu: float) -> None:
    """Three per cent below the limit nothing grows; ten above all does that viscosity lets.

    Multirate steps are limited by the Coriolis force here, of which they know the size alone. The
    limit of fb-rk3 leaves room for faster rotation.
    """
    model = Model(Mesh.build(2, 4), make_scene(*WAVES).with_effect(Viscosity(nu)))
    rest = model.device_mesh.upload(states(model)["rest"])
    spectrum = STEPPERS[name].spectral_radii(model, rest)
    limit = STEPPERS[name].stable_dt(spectrum)
    multirate = name.startswith("mis")
    assert growth(name, model, 0.97 * limit, 600) < (4.0 if multirate else 3.0)
    if not nu and not multirate:
        above = 1.15 if name == "fb-rk3" else 1.1
        assert growth(name, model, above * limit, 600) > 1e6


def test_one_stage_of_diffusion_is_borne_at_the_limit() -> None:
    """By the one stepper that has it, where the stage turns the sign of modes most."""
    kind, plain = STEPPERS["forward-backward"], make_scene(*WAVES)
    model = Model(Mesh.build(2, 4), plain.with_effect(Viscosity(1e6)))
    dt = 0.97 * kind.stable_dt(
        kind.spectral_radii(model, model.device_mesh.upload(states(model)["rest"]))
    )
    nu = 1e6 * 1.239 / (dt * model.diffusion_radius)
    thick = Model(model.mesh, plain.with_effect(Viscosity(nu)))
    assert len(kind(thick, dt).diffusion.stages) == 1
    assert growth("forward-backward", thick, dt, 600) < 3.0


@pytest.mark.parametrize("name", EXPLICIT)
def test_drag_alone_limits_sharply(name: str) -> None:
    """Without waves the limit is that of the real axis."""
    model = Model(Mesh.build(2, 4), make_scene("drag").with_effect(Drag(1e-3)))
    spectrum = STEPPERS[name].spectral_radii(model, model.device_mesh.upload(states(model)["rest"]))
    assert spectrum.wave == 0.0
    limit = STEPPERS[name].stable_dt(SpectralRadii(0.0, spectrum.dissipation))
    assert growth(name, model, 0.97 * limit, 600) < 1.1
    assert growth(name, model, 1.1 * limit, 600) > 1e6


def test_limits_that_theory_knows() -> None:
    """On the imaginary axis: rk4 √8, ssprk3 √3, kg5 √15, per spectral radius; leapfrog below 1."""
    for name, reach in (("rk4", 8**0.5), ("ssprk3", 3**0.5), ("kg5", 15**0.5)):
        assert STEPPERS[name].stable_dt(SpectralRadii(2.0)) == pytest.approx(reach / 2.0, rel=1e-2)
    assert 0.8 < STEPPERS["leapfrog"].stable_dt(SpectralRadii(1.0)) < 1.0


def test_nothing_moves_nothing_limits() -> None:
    assert STEPPERS["rk4"].stable_dt(SpectralRadii(0.0, 0.0)) == np.inf


def test_growth_of_the_filtered_scheme_is_that_of_its_map():
    """Put together by stepping and filtering each of the two levels."""
    rng = np.random.default_rng(4)
    old, new = (rng.standard_normal(200) + 1j * rng.standard_normal(200) for _ in range(2))
    strength, share = Leapfrog.default_strength, Leapfrog.default_share

    def stepped(past, present):
        future = old * past + new * present
        change = 0.5 * strength * (past - 2.0 * present + future)
        return present + share * change, future - (1.0 - share) * change

    matrix = np.transpose([stepped(1.0, 0.0), stepped(0.0, 1.0)], (2, 1, 0))
    expected = np.abs(np.linalg.eigvals(matrix)).max(axis=-1)
    np.testing.assert_allclose(filtered_factor(old, new), expected, rtol=1e-12)


# --- coefficients of custom methods

GAMMA = 1.0 - np.sqrt(0.5)
IMEX = {
    "explicit": ((2.0 * GAMMA,), (0.5, 0.5)),
    "implicit": ((GAMMA, GAMMA), (0.25 * np.sqrt(2.0), 0.25 * np.sqrt(2.0), GAMMA)),
    "b": (0.25 * np.sqrt(2.0), 0.25 * np.sqrt(2.0), GAMMA),
}


PAIR = coefficients("esdirk4", "a", "b", "embedded")
SPLIT = {name: getattr(STEPPERS["mis2"], name) for name in ("alpha", "beta", "gamma")}
EMBEDDED = PAIR | {"estimate_order": 4}


@pytest.mark.parametrize(
    ("family", "order", "coefficients", "message"),
    [
        (
            "rk4",
            1,
            {"a": ((0.5,),), "b": (1.0,)},
            r"rows of `a` must have \[\] numbers, as `b` has 1",
        ),
        ("rk4", 1, {"a": ((0.5, 0.5),), "b": (0.5, 0.5)}, r"`a` must have \[1\] .* got \[2\]"),
        ("rk4", 1, {"a": ((0.5,),), "b": (0.5, 0.4)}, r"order 1 requires sum b = 1, .* by -0\.1"),
        ("rk4", 0, {"a": ((0.5,),), "b": (0.0, 2.0)}, "order 0 requires sum b = 1, .* by 1"),
        ("rk4", 2, {"a": ((0.5,),), "b": (0.5, 0.5)}, "order 2 requires sum b c = 1/2"),
        ("rk4", 3, {"a": ((0.5,),), "b": (0.0, 1.0)}, r"order 3 requires sum b c\^2 = 1/3"),
        (
            "rk4",
            4,
            {"a": ((2 / 3,), (2 / 3, 0.0)), "b": (0.25, 0.375, 0.375)},
            "order 4 requires sum b A c = 1/6",
        ),
        ("sdirk3", 1, {"a": ((1.0, 0.0),), "b": (1.0,)}, r"`a` must have \[1\] .* got \[2\]"),
        ("sdirk3", 1, {"a": ((0.5,), (0.5,)), "b": (0.5, 0.5)}, r"must have \[1, 2\] numbers"),
        (
            "rk4",
            4,
            {"a": ((0.5,), (0.0, 0.75)), "b": (2 / 9, 1 / 3, 4 / 9)},
            r"order 4 requires sum b c\^3 = 1/4",
        ),
        (
            "rk4",
            5,
            {"a": ((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), "b": (1 / 6, 1 / 3, 1 / 3, 1 / 6)},
            r"order 5 requires sum b c\^4 = 1/5",
        ),
        ("esdirk4", 5, coefficients("esdirk4", "a", "b"), r"order 5 requires sum b .* = 1/"),
        (
            "ars343",
            4,
            coefficients("ars343", "explicit", "implicit", "b"),
            r"order 4 requires sum b .* = 1/",
        ),
        ("sdirk3", 2, {"a": ((1.0,),), "b": (1.0,)}, "order 2 requires sum b c = 1/2"),
        ("ark2", 2, IMEX | {"explicit": ((2.0 * GAMMA,), (0.5, 0.4))}, "requires sum b c = 1/2"),
        ("ark2", 3, IMEX, r"order 3 requires sum b c\^2 = 1/3"),
        (
            "ark2",
            1,
            {
                "explicit": ((0.5,), (0.5, 0.5)),
                "implicit": ((0.0, 0.5), (0.25, 0.5, 0.25)),
                "b": (0.25, 0.5, 0.25),
            },
            r"its diagonal, must be equal and positive, got \[0\.5, 0\.25\]",
        ),
        (
            "ark2",
            1,
            IMEX | {"implicit": ((GAMMA,), (GAMMA,))},
            r"`implicit` must have \[2, 3\] numbers",
        ),
        ("sdirk3", 1, {"a": ((np.nan,),), "b": (1.0,)}, "`a` must have finite numbers"),
        ("sdirk3", 1, {"a": ((-0.5,),), "b": (1.0,)}, "diagonal of `a` must not be negative"),
        ("sdirk3", 1, {"a": ((1.0,),)}, "invalid coefficients: .* no attribute 'b'"),
        ("sdirk3", "two", {"a": ((1.0,),), "b": (1.0,)}, "invalid coefficients: .*'str'"),
        ("rk4", 1, {"a": (), "b": 1.0}, "invalid coefficients: .*'float'"),
        ("esdirk4", 4, EMBEDDED | {"embedded": PAIR["embedded"][:-1]}, "`embedded` must have 6"),
        ("esdirk4", 4, EMBEDDED | {"embedded": PAIR["b"]}, "`embedded` must have 6 weights other"),
        ("esdirk4", 4, EMBEDDED | {"estimate_order": 9}, "`estimate_order` must be from 2 to 5"),
        ("esdirk4", 4, EMBEDDED | {"estimate_order": 0}, "`estimate_order` must be from 2 to 5"),
        ("esdirk4", 4, EMBEDDED | {"estimate_order": 5}, r"order 4 requires sum b .* = 1/"),
        (
            "esdirk4",
            4,
            EMBEDDED | {"embedded": (0.5, 0.2, 0.1, 0.0, 0.0, 0.0)},
            r"order 3 requires sum b = 1, .* by -0\.2",
        ),
        ("epi3", 3, {"weights": ((0.6,),)}, r"integrate J\^0 t\^2 exactly, .* by 0\.0167"),
        ("epi3", 4, {"weights": ((2 / 3,),)}, r"integrate J\^1 t\^2 exactly"),
        ("epi4", 4, {"weights": ((11 / 6, -7 / 24),)}, r"integrate J\^1 t\^2 exactly"),
        ("epi3", 3, {"weights": ((np.nan,),)}, r"integrate J\^0 t\^2 exactly, .* by nan"),
        ("mis2", 3, SPLIT, r"order 3 requires sum b .* = 1/"),
        ("mis2", 2, SPLIT | {"gamma": ((0.0,), (0.0, 0.0))}, "order 2 requires sum b"),
    ],
)
def test_coefficients_that_miss_a_condition_are_refused(
    family: str, order: int, coefficients: dict, message: str
) -> None:
    """A method is checked where it is defined; one that fails is not registered."""
    base = STEPPERS[family].__bases__[0]
    with pytest.raises(ConfigError, match=f"^stepper mine: .*{message}") as error:
        type("Mine", (base,), {"name": "mine", "order": order} | coefficients)
    assert "\n" not in str(error.value)
    assert "mine" not in STEPPERS


def test_coefficients_of_the_declared_order_are_accepted() -> None:
    method = type("Mine", (STEPPERS["ark2"].__bases__[0],), {"order": 2} | IMEX)
    method.name = "mine"  # later, so that it is not registered
    method.complete()
    assert method.error_constant > 0.0


def test_order_conditions_are_those_of_all_rooted_trees():
    """1, 1, 2, 4, 9 trees of 1 to 5 nodes (OEIS A000081), of which Butcher's method meets all."""
    branches = []
    for nodes, expected in zip(range(1, 6), (1, 1, 2, 4, 9), strict=True):
        forests = list(stability._forests(branches, nodes - 1))
        assert len(forests) == expected
        branches += [stability._Branch(nodes, 1, "", np.ones(1))] * expected

    class Butcher:
        name, order = "butcher", 5
        b = (7 / 90, 0.0, 32 / 90, 12 / 90, 32 / 90, 7 / 90)

    rows = ((1 / 4,), (1 / 8, 1 / 8), (0.0, -1 / 2, 1.0), (3 / 16, 0.0, 0.0, 9 / 16),
            (-3 / 7, 2 / 7, 12 / 7, -12 / 7, 8 / 7))  # fmt: skip
    a = stability.tableau(rows, 6)
    stability.check_order(Butcher, a)
    for i, j in zip(*np.nonzero(a), strict=True):
        wrong = a.copy()
        wrong[i, j] += 1e-4
        with pytest.raises(ConfigError, match="order 5 requires sum b"):
            stability.check_order(Butcher, wrong)


def test_a_method_without_a_stable_step_may_amplify_waves_by_e_in_15_days():
    """Heun's of second order: |R(iy)| = sqrt(1 + y^4/4), and steps that order needs, not 1e-7."""

    class Heun(RungeKutta):
        a, b = ((1.0,),), (0.5, 0.5)

    for wave in (2e-4, 2e-3):
        dt = Heun.stable_dt(SpectralRadii(wave))
        growth = (1.0 + (wave * dt) ** 4 / 4.0) ** (0.5 * GROWTH_TIME / dt)
        assert growth == pytest.approx(np.e, rel=2e-3)
        assert dt > 4.0 * (8.0 * NO_GROWTH) ** 0.25 / wave
        assert Heun.stable_dt(SpectralRadii(wave, 0.1 * wave)) > 0.999 * dt
