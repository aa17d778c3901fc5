"""Effects without derivatives that a scene's own file defines."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import warp as wp
from manufactured import tight
from support import advance, make_scene, random_state, relative, tangent, tendency, thorough
from test_generated_code import code_of

from swe_sphere.cli.main import main
from swe_sphere.equations.effects import (
    DYNAMICS,
    MASSES,
    Drag,
    EdgePenalty,
    Orography,
    PointwiseEffect,
    PrescribedWind,
    Relaxation,
    Rotation,
    Tracers,
    Viscosity,
)
from swe_sphere.equations.model import Model
from swe_sphere.equations.right_hand_side import compiling_formulas
from swe_sphere.equations.scene import Scene, apply_settings
from swe_sphere.errors import ConfigError
from swe_sphere.kernels.pointwise import PointTerm, Pointwise
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.config import make_config
from swe_sphere.simulation.restart import run_sources
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.solvers.preconditioners import make_preconditioner
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene

MESH = Mesh.build(2, 4)
FILE = '''
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from swe_sphere.equations.effects import MASSES, PointwiseEffect
from swe_sphere.testcases import get_scene


@dataclass(frozen=True)
class BottomFriction(PointwiseEffect):
    """-(linear + quadratic |v|) v."""

    name = "friction"
    conserves = MASSES
    dissipation = True
    linear: float = 1e-5
    quadratic: float = 3e-6
    steep: bool = True

    @staticmethod
    def wind_tendency(c, i, u, v, h):
        rate = c.linear + c.quadratic * math.sqrt(u * u + v * v)
        return -rate * u, -rate * v

    @staticmethod
    def wind_derivative(c, i, u, v, h, du, dv, dh):
        speed = math.sqrt(u * u + v * v)
        rate, along = c.linear + c.quadratic * speed, c.quadratic * (u * du + v * dv) / speed
        return -rate * du - along * u, -rate * dv - along * v


class Rough(BottomFriction):
    """Without a derivative."""

    wind_derivative = None


@dataclass(frozen=True)
class Rain(PointwiseEffect):
    """`rate` [m s-1] where the sun is high, and evaporation with the depth."""

    name = "rain"
    rate: float = 1e-3
    time: float = 1e6

    def coefficients(self, mesh):
        return {"rain": self.rate * np.cos(mesh.lat) ** 2, "drying": 1.0 / self.time}

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return c.rain[i] - c.drying * h

    @staticmethod
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        return -c.drying * dh


@dataclass(frozen=True)
class Stirring(Rain):
    """Rain that takes as much elsewhere: what is moved adds up to nothing."""

    conserves = MASSES

    def coefficients(self, mesh):
        pattern = np.cos(mesh.lat) ** 2
        return {"rain": self.rate * (pattern - np.average(pattern, weights=mesh.area))}

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return c.rain[i]

    @staticmethod
    def depth_derivative(c, i, u, v, h, du, dv, dh):
        return dh - dh


EFFECTS = {"friction": BottomFriction, "rough": Rough, "rain": Rain, "stirring": Stirring}


def scene(effect: str = "friction", base: str = "williamson5"):
    """The base with one of them."""
    return replace(get_scene(base), name="own", exact=None).with_effect(EFFECTS[effect]())
'''


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("own") / "own.py"
    made.write_text(FILE)
    return made


def own(path: Path, effect: str, base: str = "williamson5"):
    return get_scene(str(path), effect=effect, base=base)


def with_drag():
    return get_scene("williamson5").with_effect(Drag(1e-5, 3e-6))


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("shape", ["element", "node"])
@pytest.mark.thorough
def test_own_drag_is_the_drag_of_the_package(path: Path, shape: str, precision: str) -> None:
    """Right-hand side and derivative, to round-off."""
    models = [
        Model(MESH, scene, shape=shape, precision=precision)
        for scene in (own(path, "friction"), with_drag())
    ]
    state, direction = random_state(models[0]), 0.1 * random_state(models[0], seed=2)
    bound = 1e-14 if precision == "float64" else 1e-6
    assert relative(*(tendency(model, state) for model in models), 3) < bound
    assert relative(*(tangent(model, state, direction) for model in models), 3) < bound


@pytest.mark.parametrize("shape", ["element", thorough("node")])
@pytest.mark.parametrize("stepper", ["rk4", thorough("ark2"), thorough("tr-bdf2")])
def test_steppers_take_it_as_they_take_the_package_s_own(path: Path, stepper: str, shape) -> None:
    """To round-off, in as many iterations."""
    ends = []
    for scene in (own(path, "friction"), with_drag()):
        model = Model(MESH, scene, shape=shape)
        model.for_solves = model  # the package's own effects would allow float32
        ends.append(advance(stepper, model, model.initial_state(), 600.0, 3000.0))
    mine, theirs = ends
    assert relative(mine.state.numpy(), theirs.state.numpy(), 3) < 1e-12
    counts = [dict(end.counters, setup_seconds=0.0) for end in ends]
    assert counts[0] == counts[1]


def test_without_a_derivative_newton_takes_differences(path: Path) -> None:
    """And as many iterations, give or take one in each step."""
    ends, products = [], []
    for effect in ("friction", "rough"):
        model = Model(MESH, own(path, effect))
        ends.append(advance("tr-bdf2", model, model.initial_state(), 600.0, 3000.0, tolerance=1e-6))
        products.append(model.counters["rhs_evaluations"])
    exact, difference = ends
    assert relative(difference.state.numpy(), exact.state.numpy(), 3) < 1e-6
    newton = [stepper.counters["newton_iterations"] for stepper in ends]
    assert abs(newton[0] - newton[1]) <= exact.steps
    assert products[1] > products[0]  # each Jacobian product is a right-hand side


def test_spectrum_knows_it_with_a_derivative_or_without(path: Path) -> None:
    radii = []
    for scene in (own(path, "friction"), own(path, "rough"), with_drag()):
        model = Model(MESH, scene)
        spectrum = model.spectral_radii(model.device_mesh.upload(random_state(model)))
        radii.append((spectrum.wave, spectrum.dissipation))
    np.testing.assert_allclose(radii, [radii[2]] * 3, rtol=1e-4)
    assert radii[2][1] > 1e-5


@pytest.mark.parametrize("name", ["rk4", "ark2", "tr-bdf2", "gauss-legendre"])
@pytest.mark.parametrize("base", ["williamson5", "williamson1"])
@pytest.mark.thorough
def test_a_source_of_mass_brings_its_mass(path: Path, name: str, base: str) -> None:
    """No implicit stepper takes it for an error of its solver; also under a prescribed wind."""
    if name == "ark2" and base == "williamson1":
        pytest.skip("no waves to treat implicitly")
    model = Model(MESH, own(path, "rain", base))
    end = advance(name, model, model.initial_state(), 300.0, 3000.0, **tight(name))
    start, depth = (x.numpy()[-MESH.size :] for x in (model.initial_state(), end.state))
    rain = 1e-3 * np.cos(MESH.lat) ** 2
    mean, wet = (float(np.average(field, weights=MESH.area)) for field in (start, rain))
    left = np.exp(-3000.0 / 1e6)
    expected = mean * left + wet * 1e6 * (1.0 - left)
    assert float(np.average(depth, weights=MESH.area)) == pytest.approx(expected, abs=2e-4)
    assert abs(expected - mean) > 0.1


@pytest.mark.thorough
def test_the_average_vector_field_takes_it_by_the_midpoint_rule(path: Path) -> None:
    """What moves mass is no part of its energy, and the mass it brings is known to the solver."""
    model = Model(MESH, own(path, "rain"))
    tight_midpoint = {"tolerance": 1e-10}
    ends = [
        advance(name, model, model.initial_state(), 300.0, 1500.0, **tight_midpoint).state.numpy()
        for name in ("average-vector-field", "implicit-midpoint")
    ]
    assert relative(*ends, 3) < 1e-7


@pytest.mark.thorough
def test_what_conserves_mass_keeps_it_to_round_off(path: Path) -> None:
    """However roughly it is solved for."""
    model = Model(MESH, own(path, "stirring"))
    end = advance("tr-bdf2", model, model.initial_state(), 600.0, 6000.0, tolerance=1e-2)
    start, depth = (x.numpy()[-MESH.size :] for x in (model.initial_state(), end.state))
    mean, last = (float(np.average(field, weights=MESH.area)) for field in (start, depth))
    assert last == pytest.approx(mean, rel=1e-14)
    assert np.abs(depth - start).max() > 1.0


@pytest.mark.thorough
def test_several_of_them_add_up(path: Path) -> None:
    both = own(path, "friction").with_effect(own(path, "rain").effect("rain"))
    both = both.with_effect(Relaxation(3e4)).with_effect(Drag(2e-5))
    state = random_state(Model(MESH, both))
    plain = tendency(Model(MESH, get_scene("williamson5")), state)
    expected = plain.copy()
    for effect in both.effects[-4:]:
        scene = get_scene("williamson5").with_effect(effect)
        expected += tendency(Model(MESH, scene), state) - plain
    assert relative(tendency(Model(MESH, both), state), expected, 3) < 1e-12


@pytest.mark.parametrize("shape", ["element", "node"])
def test_it_costs_nothing_where_it_is_not(path: Path, shape: str) -> None:
    """The conservative part is word by word that of the base; unread parameters are absent."""
    base, scene = get_scene("williamson5"), own(path, "friction")
    assert code_of(scene, shape, "conservative").text == code_of(base, shape).text
    code = code_of(scene, shape)
    assert code.has("quadratic") and not code.has("steep")
    assert not code_of(base, shape).has("quadratic")


def test_its_parameters_are_set_as_those_of_others(path: Path) -> None:
    scene = own(path, "friction")
    assert apply_settings(scene, ["friction.linear=2e-5"]).effect("friction").linear == 2e-5
    for setting, message in (
        ("friction.linear=much", r"friction\.linear .*number.*'much'"),
        ("friction.cubic=1", "no parameter 'cubic'; it has linear, quadratic"),
        ("fricton.linear=1", "unknown effect 'fricton'; did you mean 'friction'"),
    ):
        with pytest.raises(ConfigError, match=message):
            apply_settings(scene, [setting])


@pytest.mark.parametrize("name", ["weight", "point"])
def test_its_name_may_be_that_of_a_value_in_kernels(tmp_path: Path, name: str) -> None:
    files = tmp_path / "named.py", tmp_path / "friction.py"
    for file, word in zip(files, (name, "friction"), strict=True):
        file.write_text(FILE.replace('name = "friction"', f'name = "{word}"'))
    named, plain = (Simulation(file, ne=2, np=4, dt=600.0) for file in files)
    for sim in (named, plain):
        sim.step()
    assert np.array_equal(named.state.u, plain.state.u)


def test_a_function_stays_as_long_as_an_effect_needs_it() -> None:
    @dataclass(frozen=True)
    class Sink(PointwiseEffect):
        name, needs = "sink", "bottom"
        rate: float = 1e-9

        @staticmethod
        def depth_tendency(c, i, u, v, h):
            return -c.rate * c.bottom[i]

    both = get_scene("williamson5").with_effect(Sink())
    rest = both.without_effect("orography")
    assert rest.bottom is not None and rest.effect("orography") is None
    assert rest.without_effect("sink").bottom is None
    assert both.without_effect("sink").bottom is not None


@pytest.mark.parametrize(
    ("returned", "said"), [(None, "coefficients of sink"), ({"rate": np.array(np.nan)}, "finite")]
)
def test_wrong_coefficients_are_told_in_a_line(returned, said) -> None:
    @dataclass(frozen=True)
    class Sink(PointwiseEffect):
        name = "sink"

        def coefficients(self, mesh):
            return returned

        @staticmethod
        def depth_tendency(c, i, u, v, h):
            return -c.rate * h

    with pytest.raises(ConfigError, match=said):
        Model(MESH, get_scene("williamson5").with_effect(Sink()))


def test_a_coefficient_may_be_an_array_without_dimensions() -> None:
    @dataclass(frozen=True)
    class Sink(PointwiseEffect):
        name = "sink"

        def coefficients(self, mesh):
            return {"rate": np.array(1e-6)}

        @staticmethod
        def depth_tendency(c, i, u, v, h):
            return -c.rate * h

    sim = Simulation(get_scene("lake-at-rest").with_effect(Sink()), ne=2, np=4, dt=600.0)
    before = sim.state.h.values
    sim.step()
    np.testing.assert_allclose(sim.state.h, before * np.exp(-6e-4), rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("return -rate * u, -rate * v", "return -0.5 * u, -rate * v", r"friction .*own\.py, line"),
        ("return -rate * u, -rate * v", "return -c.cubic * u, v", "friction .*cubic"),
        ('name = "friction"', 'name = "drag"', "name of an effect of the package"),
        ('name = "friction"', 'name = "rotation"', "name of an effect of the package"),
        ('name = "friction"', 'name = "Big Friction"', "small letters"),
        *(
            ('name = "friction"', f'name = "{name}"', "the model uses this name for something else")
            for name in ("scene", "stepper")
        ),
        ("linear: float = 1e-5", "linear: float = math.nan", "friction: linear must be finite"),
        ("conserves = MASSES", "conserves: float = 1.0", "the name of the attribute 'conserves'"),
        ("dissipation = True", "terms: float = 1.0", "the name of the attribute 'terms'"),
        (
            "linear: float = 1e-5",
            "needs = 'heating'; linear: float = 1e-5",
            "needs 'heating', which",
        ),
        ("wind_tendency", "tendency", "neither a wind_tendency nor a depth_tendency"),
        (
            "dissipation = True",
            "dissipation = True; depth_tendency = 5",
            "friction': a formula must be a plain Python function, got 5",
        ),
        ('base: str = "williamson5"', 'base: str = "williamson1"', "wind, which is prescribed"),
    ],
)
def test_what_is_wrong_with_it_is_told_in_a_line(
    tmp_path: Path, capsys, old: str, new: str, message: str
) -> None:
    faulty = tmp_path / "own.py"
    faulty.write_text(FILE.replace(old, new))
    with pytest.raises(SystemExit):
        main(["run", str(faulty), "--days", "0.01", "--ne", "2", "--np", "4", "--quiet"])
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert re.search(message, lines[0])


@pytest.mark.parametrize("value", [None, "much", np.inf])
def test_a_coefficient_that_is_no_number_is_told_in_a_line(monkeypatch, value) -> None:
    monkeypatch.setattr(Drag, "coefficients", lambda self, mesh: {"linear": value, "still": 1.0})
    with pytest.raises(ConfigError, match=r"coefficients of drag: linear must be finite, got ."):
        Model(MESH, make_scene("drag"))


def test_an_effect_may_read_the_equilibrium_that_relaxation_has() -> None:
    """Without relaxation too."""

    @dataclass(frozen=True)
    class Recovery(PointwiseEffect):
        name = "recovery"
        needs = "equilibrium"
        rate: float = 1e-5

        @staticmethod
        def depth_tendency(c, i, u, v, h):
            return c.rate * (c.equilibrium[i] - h)

    with_own, with_ours = (make_scene().with_effect(e) for e in (Recovery(), Relaxation(1e5)))
    with pytest.raises(ConfigError, match=r"'recovery' needs the function 'equilibrium'"):
        replace(make_scene(), effects=(Recovery(),))
    state = random_state(Model(MESH, with_own))
    own, ours = (tendency(Model(MESH, scene), state) for scene in (with_own, with_ours))
    assert relative(own, ours, 3) < 1e-12


def test_linearised_dynamics_need_its_derivative(path: Path) -> None:
    linear = make_scene("pressure", "linearised")
    assert Model(MESH, linear.with_effect(own(path, "friction").effect("friction")))
    with pytest.raises(ConfigError, match="no derivative"):
        linear.with_effect(own(path, "rough").effect("friction"))


def test_a_run_knows_the_file_it_comes_from(path: Path) -> None:
    config = make_config({"scene": str(path)})
    sources = run_sources(config, own(path, "friction"))
    path.write_text(FILE.replace("-rate * u", "-2.0 * rate * u"))
    assert run_sources(config, own(path, "friction")) != sources
    path.write_text(FILE)


RATE = wp.constant(wp.float64(1e-5))
RATES = wp.mat22d()


@wp.func
def slowed(v: wp.float64):
    return -RATE * v


@dataclass(frozen=True)
class Slowing(PointwiseEffect):
    """-RATE v, with constants of the program around it and around a function it calls."""

    name = "slowing"

    @staticmethod
    def wind_tendency(c, i, u, v, h):
        return -RATES[0, 0] * u, slowed(v)


@dataclass(frozen=True)
class Differentiable(Slowing):
    """This effect is `Slowing` with its derivative."""

    name = "slowing-with-derivative"

    @staticmethod
    def wind_derivative(c, i, u, v, h, du, dv, dh):
        return -RATES[0, 0] * du, slowed(dv)


def test_implicit_steps_keep_the_number_type_of_its_constants() -> None:
    model = Model(MESH, get_scene("williamson5").with_effect(Differentiable()))
    stepper = STEPPERS["tr-bdf2"](model, 600.0)
    stepper.start(model.initial_state())
    stepper.step()
    assert model.for_solves is model


@pytest.mark.thorough
@pytest.mark.parametrize("shape", ["element", "node"])
def test_a_constant_around_a_formula_may_change(monkeypatch, shape):
    """As in a notebook, one cell of which is run again: no kernel with the old one is taken."""
    scene = get_scene("williamson5")
    plain = Model(MESH, scene, shape=shape)
    state, winds = random_state(plain), slice(0, 2 * MESH.size)
    without = tendency(plain, state)[winds]
    for rate, of_east in ((1e-5, 1e-5), (1e-3, 1e-5), (1e-3, 1e-3), (1e-5, 1e-5)):
        monkeypatch.setitem(globals(), "RATE", wp.constant(wp.float64(rate)))
        RATES[0, 0] = of_east
        model = Model(MESH, scene.with_effect(Slowing()), shape=shape)
        added = tendency(model, state)[winds] - without
        rates = np.repeat([of_east, rate], MESH.size)
        np.testing.assert_allclose(added, -rates * state[winds], rtol=1e-6)


@wp.func
def circular(v: wp.float64):
    return circular(v)


def test_a_function_that_calls_itself_is_told_in_a_line() -> None:
    @dataclass(frozen=True)
    class Circular(PointwiseEffect):
        name = "circular"

        @staticmethod
        def depth_tendency(c, i, u, v, h):
            return circular(h)

    scene = make_scene().with_effect(Circular())
    with pytest.raises(ConfigError, match="the formulas of circular cannot be compiled"):
        Model(MESH, scene).right_hand_side()


def test_a_warp_function_that_is_defined_again_counts() -> None:
    def added(factor: float) -> float:
        @wp.func
        def scaled(x: wp.float64):
            return wp.float64(wp.static(factor)) * x

        @dataclass(frozen=True)
        class Scaled(PointwiseEffect):
            name = "scaled"
            rate: float = 1.0

            @staticmethod
            def depth_tendency(c, i, u, v, h):
                return scaled(c.rate)

        scene = make_scene().with_effect(Scaled())
        return tendency(model := Model(MESH, scene), model.initial_state())[-1]

    assert added(2.0) == pytest.approx(2.0)
    assert added(7.0) == pytest.approx(7.0)


def test_the_number_of_rates_is_named_in_the_message() -> None:
    @dataclass(frozen=True)
    class OneRate(PointwiseEffect):
        name = "one-rate"

        @staticmethod
        def wind_tendency(c, i, u, v, h):
            return u

    scene = make_scene().with_effect(OneRate())
    with pytest.raises(ConfigError, match="a wind formula returns two rates"):
        Model(MESH, scene).right_hand_side()


def test_classes_that_are_no_whole_effect_say_what_they_lack() -> None:
    class Undecorated(PointwiseEffect):
        name = "undecorated"
        k: float = 1.0

    @dataclass(frozen=True)
    class Nameless(PointwiseEffect):
        k: float = 1.0

    class Whole(Slowing):
        """Has no parameters of its own, so that it needs no decorator."""

        name = "whole"
        note: ClassVar[str] = "none"

    for arguments in ({}, {"k": 2.0}):
        with pytest.raises(ConfigError, match=r"Undecorated needs @dataclass\(frozen=True\)"):
            Undecorated(**arguments)
        with pytest.raises(ConfigError, match="give the effect Nameless a name"):
            Nameless(**arguments)
    assert Whole().name == "whole"


def test_an_exact_solution_without_an_effect_is_none_with_it() -> None:
    """Diffusion counts as an error of the discretisation."""
    scene = get_scene("williamson2")
    for effect in (Drag(1e-6), Relaxation(1e5), Slowing()):
        assert scene.with_effect(effect).exact is None
    for effect in (Viscosity(1e5), EdgePenalty(), Drag(0.0)):
        assert scene.with_effect(effect).exact == scene.exact
    slow = replace(scene.with_effect(Drag(1e-6)), exact=scene.exact)
    assert slow.with_effect(Drag(1e-6)).exact == slow.exact
    assert slow.with_effect(Drag(2e-6)).exact is None
    summary = Simulation("williamson2", ne=2, effects={"drag.linear": 1e-6}).run(days=0.05)
    assert summary["l2_h"] is None


@dataclass(frozen=True)
class Bed(PointwiseEffect):
    """The effect reads the bottom of its scene, and changes nothing."""

    name = "bed"
    needs = "bottom"
    conserves = MASSES
    dissipation = True
    rate: float = 0.0

    @staticmethod
    def wind_tendency(c, i, u, v, h):
        return c.rate * c.bottom[i] * u, c.rate * c.bottom[i] * v


@dataclass(frozen=True)
class Turn(Bed):
    """The effect reads the Coriolis parameter of its scene, and changes nothing."""

    name = "turn"
    needs = "coriolis"

    @staticmethod
    def wind_tendency(c, i, u, v, h):
        return c.rate * c.coriolis[i] * u, c.rate * c.coriolis[i] * v


@pytest.mark.parametrize("effect", [Bed(), Turn()], ids=["bottom", "coriolis"])
@pytest.mark.parametrize("stepper", ["average-vector-field", "semi-implicit", "tr-bdf2"])
def test_a_function_that_an_effect_reads_is_not_an_effect_of_its_own(effect, stepper) -> None:
    size = 100.0 if effect.needs == "bottom" else 1e-4
    scene = replace(
        make_scene("advection", "pressure"),
        effects=(*DYNAMICS, effect),
        initial=lambda lon, lat: (10.0 * np.cos(lat), 0.0 * lon, 1000.0),
        **{effect.needs: lambda lon, lat: size * np.sin(lat)},
    )
    without = replace(scene, effects=DYNAMICS, **{effect.needs: None})
    runs = [Simulation(each, ne=2, np=4, stepper=stepper, dt=600.0) for each in (scene, without)]
    for sim in runs:
        for _ in range(3):
            sim.step()
    with_it, plain = (sim.state.u.values for sim in runs)
    assert np.abs(with_it - plain).max() < 1e-5


def test_diffusion_of_tracers_ignores_a_bottom_without_gravity_over_it() -> None:
    scene = replace(
        make_scene("advection", "pressure", "rotation"),
        effects=(*DYNAMICS, Rotation(), Bed(), Viscosity(nu=1e6), Tracers()),
        bottom=lambda lon, lat: 300.0 * np.cos(3.0 * lon + lat),
        tracers={"one": lambda lon, lat: 1.0},
    )
    sim = Simulation(scene, ne=2, np=4, stepper="rk4", dt=300.0)
    for _ in range(5):
        sim.step()
    assert np.abs(sim.state.q_one.values - 1.0).max() < 1e-13


def test_tracers_do_not_diffuse_where_there_is_no_fluid() -> None:
    scene = get_scene("williamson1")
    scene = replace(
        scene,
        effects=(*scene.effects, Orography(), Tracers(), Viscosity(1e5)),
        bottom=lambda lon, lat: 500.0 * np.cos(lat) ** 2,
        tracers={"a": lambda lon, lat: 1.0 + np.sin(lat)},
        exact=None,
    )
    with pytest.raises(ConfigError, match="tracers diffuse only where the depth is positive"):
        Simulation(scene, ne=2, np=4, stepper="rk4").run(days=0.5)


def test_preconditioners_use_the_damping_of_a_custom_effect() -> None:
    model = Model(MESH, replace(make_scene("advection", "pressure"),
                                effects=(*DYNAMICS, Damper(linear=1e-3))))  # fmt: skip
    assert make_preconditioner("helmholtz", model).operator.damping is not None
    plain = Model(MESH, make_scene("advection", "pressure"))
    assert make_preconditioner("helmholtz", plain).operator.damping is None


@dataclass(frozen=True)
class Damper(Drag):
    """Drag that gives preconditioners its rate."""

    name = "damper"

    def damping(self, mesh, squares):
        return self.linear + 0.0 * squares


@pytest.mark.parametrize("error", [MemoryError(), ConfigError("a kernel is damaged")])
def test_other_errors_are_not_blamed_on_formulas(error) -> None:
    point = Pointwise(terms=(PointTerm("drag"),))
    with pytest.raises(ConfigError) as caught, compiling_formulas(make_scene(), point):
        raise error
    assert ("damaged" if isinstance(error, ConfigError) else "MemoryError") in str(caught.value)


def test_an_exact_solution_ends_with_the_effect_that_it_contains() -> None:
    plain = replace(make_scene("advection", "pressure"),
                    exact=lambda lon, lat, t: (0.0 * lon, 0.0 * lon, 1000.0))  # fmt: skip
    damped = replace(plain, effects=(*DYNAMICS, Drag(linear=1e-5), Viscosity(nu=1e4)))
    assert damped.with_effect(Drag()).exact is None
    assert damped.without_effect("drag").exact is None
    assert damped.without_effect("viscosity").exact is not None
    assert plain.with_effect(Drag()) is plain


def test_text_is_no_coefficient() -> None:
    with pytest.raises(ConfigError, match="must be finite and not negative, got a"):
        Viscosity(nu="a")
    assert Viscosity(nu=np.int64(100000)).nu == Viscosity(nu=np.float32(100000.0)).nu


@pytest.mark.parametrize(
    ("effect", "values", "said"),
    [
        (Viscosity, {"nu": True}, "viscosity.nu must be finite and not negative, got True"),
        (Viscosity, {"nu": 10**400}, "viscosity.nu must be finite and not negative"),
        (Relaxation, {"time": True}, "relaxation.time must be positive, got True"),
        (Relaxation, {"time": "a day"}, "relaxation.time must be positive, got a day"),
        (Tracers, {"limiter": "false"}, "tracers.limiter must be True or False, got 'false'"),
        (Tracers, {"limiter": float("nan")}, "tracers.limiter must be True or False, got nan"),
    ],
)
def test_values_of_another_type_are_refused(effect, values, said) -> None:
    with pytest.raises(ConfigError, match=said):
        effect(**values)


@pytest.mark.parametrize(
    "effect",
    [
        Viscosity(nu=np.float32(1e5)), Viscosity(nu=Fraction(100000)), Drag(linear=np.int64(0)),
        Relaxation(time=np.float32(1e5)), Tracers(limiter=np.False_),
    ],
)  # fmt: skip
def test_numbers_of_other_types_can_be_written_to_files(effect, tmp_path: Path) -> None:
    plain = get_scene("williamson6")
    tracers = {"a": lambda lon, lat: 1.0 + 0.0 * lon}
    scene = replace(plain, effects=(*plain.effects, Tracers()), tracers=tracers).with_effect(effect)
    sim = Simulation(scene, ne=2, np=4, dt=600.0, days=0.05)
    sim.run(out=tmp_path / "a.nc")
    assert Simulation.from_checkpoint(tmp_path / "a.nc", scene).run(days=0.1).status == "completed"


@dataclass(frozen=True)
class Uptake(PointwiseEffect):
    """A loss of depth in proportion to a wind that changes in time."""

    name = "uptake"
    dissipation = True
    rate: float = 1e-6

    @staticmethod
    def depth_tendency(c, i, u, v, h):
        return -c.rate * u * h


@pytest.mark.parametrize("name", ["forward-backward", "fb-rk3", "leapfrog", "rk4", "mis2"])
def test_dissipation_sees_the_prescribed_wind_of_the_time(name: str) -> None:
    def wind(lon, lat, t):
        return (10.0 + t / 360.0) * np.cos(lat) + 0.0 * lon, 0.0 * lat

    mesh, effects = Mesh.build(2, 4), (PrescribedWind(), Uptake())
    flow = Scene("flow", effects, initial=lambda lon, lat: (10.0, 0.0, 1000.0), wind=wind)

    def after(stepper: str, steps: int, dt: float, earlier=None):
        made = STEPPERS[stepper](Model(mesh, flow), dt)
        if earlier is None:
            made.start(made.model.initial_state())
        else:
            made.load_state_dict(earlier.state_dict(), earlier.steps)
        for _ in range(steps):
            made.step()
        return made

    whole, resumed = after(name, 6, 600.0), after(name, 2, 600.0, after(name, 4, 600.0))
    assert np.array_equal(whole.state.numpy(), resumed.state.numpy())
    exact = after("rk4", 64, 56.25).state.numpy()
    errors = [np.abs(after(name, n, 3600.0 / n).state.numpy() - exact).max() for n in (6, 12)]
    assert errors[1] < 0.7 * errors[0] < 3.0  # of a change by 60 m


def test_a_class_derived_from_an_effect_of_the_package_runs():
    """It declares what it conserves, but has no formulas."""

    class Mine(Viscosity):
        pass

    for kind in (Viscosity, Mine):
        scene = replace(get_scene("williamson2"), effects=(*DYNAMICS, Rotation(), kind(nu=1e5)))
        sim = Simulation(scene, ne=2, np=4, dt=1800.0, days=0.5)
        assert sim.run(progress=False).completed
    assert [effect.name for effect in sim.scene.effects][-1] == "viscosity"
