"""The scenes: their formulas solve the equations, and are smooth over the whole sphere."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import DAY, EARTH
from swe_sphere.testcases import get_scene

Given = dict[str, float | bool | str]
VARIANTS: list[tuple[str, Given]] = [
    *(("williamson1", {"alpha": a, "gaussian": True}) for a in (0.0, np.pi / 4, 1.3)),
    ("williamson1", {"alpha": np.pi / 4}),
    *(("williamson2", {"alpha": a}) for a in (0.0, 0.05, np.pi / 4, np.pi / 2, -2.0)),
    *(("williamson3", {"alpha": a}) for a in (0.0, np.pi / 3, -2.0)),
    *(("williamson4", {"u0": u}) for u in (20.0, 40.0)),
    ("williamson5", {}),
    ("williamson6", {}),
    ("williamson6", {"perturbation": 1.0}),
    ("galewsky", {"perturbed": True}),
    ("galewsky", {"perturbed": False}),
    ("lauter", {}),
    ("lauter", {"alpha": 0.0}),
    ("lauter", {"alpha": 1.1}),
    *(("lake-at-rest", {"cone": c, "rotating": r}) for c in (True, False) for r in (True, False)),
    ("williamson7", {}),
    *(("matsuno", {"wave": w, "k": 3, "n": 2}) for w in ("rossby", "eig", "wig")),
    ("mcdonald-bates", {}),
    ("modons", {}),
    *(("turbulence", {"rotating": r}) for r in (True, False)),
    ("splash", {}),
    ("gravity-bumps", {}),
    ("dam-break", {}),
    *(("tide", {"constituent": c}) for c in ("m2", "o1")),
    *(("slow-ocean", {"linear": x}) for x in (True, False)),
]
EXACT = [(name, given) for name, given in VARIANTS if get_scene(name, **given).exact]
SMOOTH_EXACT = [
    (name, given)
    for name, given in EXACT
    if name not in ("matsuno", "tide", "slow-ocean")  # of other equations: see their own tests
    and given.get("cone") is not True
    and given.get("gaussian", name != "williamson1")
]

Point = Callable[[Array, Array, float], Array]
STEEP = {"galewsky": (3e-4, 1e-9), "williamson3": (3e-3, 1e-10), "williamson4": (3e-3, 1e-10)}
"""Scenes with steep flows: the step of the differences and the bound on the residual."""
STENCIL = {1: 4.0 / 5.0, 2: -1.0 / 5.0, 3: 4.0 / 105.0, 4: -1.0 / 280.0}


def derivative(along: Callable[[float], Array], step: float) -> Array:
    """Centred difference of eighth order at 0."""
    return sum(w * (along(k * step) - along(-k * step)) for k, w in STENCIL.items()) / step


class Residual:
    """Both sides of the shallow-water equations for the functions of a scene."""

    def __init__(self, scene: Scene, step: float) -> None:
        self.scene, self.step = scene, step
        self.state = scene.exact or (lambda lon, lat, t: scene.initial(lon, lat))

    def field(self, index: int) -> Point:
        return lambda lon, lat, t: self.state(lon, lat, t)[index]

    def east(self, f: Point, lon: Array, lat: Array, t: float) -> Array:
        slope = derivative(lambda d: f(lon + d, lat, t), self.step)
        return slope / (EARTH.radius * np.cos(lat))

    def north(self, f: Point, lon: Array, lat: Array, t: float) -> Array:
        return derivative(lambda d: f(lon, lat + d, t), self.step) / EARTH.radius

    def rate(self, f: Point, lon: Array, lat: Array, t: float) -> Array:
        return derivative(lambda d: f(lon, lat, t + d), self.step / EARTH.rotation)

    def divergence(self, east: Point, north: Point, lon: Array, lat: Array, t: float) -> Array:
        flux = self.north(lambda x, y, s: north(x, y, s) * np.cos(y), lon, lat, t)
        return self.east(east, lon, lat, t) + flux / np.cos(lat)

    def bernoulli(self, lon: Array, lat: Array, t: float) -> Array:
        u, v, h = self.state(lon, lat, t)
        bottom = self.scene.bottom(lon, lat) if self.scene.bottom else 0.0
        return 0.5 * (u**2 + v**2) + EARTH.gravity * (h + bottom)

    def momentum(self, lon: Array, lat: Array, t: float) -> tuple[Array, Array, float]:
        """Eastward and northward residual and the largest term [m s-2]."""
        u, v, _ = self.state(lon, lat, t)
        spin = self.divergence(self.field(1), lambda x, y, s: -self.field(0)(x, y, s), lon, lat, t)
        f = self.scene.coriolis(lon, lat) if self.scene.coriolis else 0.0
        push_u = self.east(self.bernoulli, lon, lat, t)
        push_v = self.north(self.bernoulli, lon, lat, t)
        force = self.scene.forcing(lon, lat, t) if self.scene.forcing else (0.0, 0.0, 0.0)
        east = self.rate(self.field(0), lon, lat, t) - (spin + f) * v + push_u - force[0]
        north = self.rate(self.field(1), lon, lat, t) + (spin + f) * u + push_v - force[1]
        return east, north, max(np.abs(push_u).max(), np.abs(push_v).max())

    def continuity(self, lon: Array, lat: Array, t: float) -> tuple[Array, float]:
        """Residual and the largest term [m s-1]."""
        flux_u, flux_v = (
            lambda x, y, s, i=i: self.state(x, y, s)[i] * self.state(x, y, s)[2] for i in (0, 1)
        )
        rate = self.rate(self.field(2), lon, lat, t)
        if self.scene.forcing:
            rate = rate - self.scene.forcing(lon, lat, t)[2]
        scale = np.abs(self.east(flux_u, lon, lat, t)).max()
        return rate + self.divergence(flux_u, flux_v, lon, lat, t), scale


def random_points(count: int = 400, south: float = -1.4, north: float = 1.4) -> tuple[Array, Array]:
    rng = np.random.default_rng(7)
    return rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(south, north, count)


def label(case: tuple[str, Given]) -> str:
    name, given = case
    return "-".join([name, *(f"{k}={v}"[:12] for k, v in given.items())])


@pytest.mark.parametrize("case", SMOOTH_EXACT, ids=label)
def test_exact_solution_solves_the_equations(case: tuple[str, Given]) -> None:
    scene = get_scene(case[0], **case[1])
    step, bound = STEEP.get(scene.name, (0.01, 1e-10))
    residual = Residual(scene, step)
    lon, lat = random_points(400, 0.5, 1.1) if scene.name == "galewsky" else random_points()
    for t in (0.0, 1.7 * DAY):
        if scene.wind is None:
            east, north, largest = residual.momentum(lon, lat, t)
            assert max(np.abs(east).max(), np.abs(north).max()) <= bound * max(largest, 1e-3)
        rest, largest = residual.continuity(lon, lat, t)
        assert np.abs(rest).max() <= 1e-10 * max(largest, 1e-3)


@pytest.mark.parametrize("name", ["lauter", "williamson1"])
def test_unsteady_scene_moves(name: str) -> None:
    scene = get_scene(name, alpha=np.pi / 4)
    lon, lat = random_points()
    early, late = scene.exact(lon, lat, 0.0)[2], scene.exact(lon, lat, 0.3 * DAY)[2]
    assert np.abs(early - late).max() > 30.0


def test_lauter_returns_after_a_turn_of_the_planet() -> None:
    scene = get_scene("lauter")
    lon, lat = random_points()
    turn = 2.0 * np.pi / EARTH.rotation
    assert turn == pytest.approx(86165.6, abs=1.0)
    for start, end in zip(scene.initial(lon, lat), scene.exact(lon, lat, turn), strict=True):
        np.testing.assert_allclose(start, end, rtol=0.0, atol=1e-9 * np.abs(start).max())


def test_williamson5_surface_is_in_balance_and_the_mountain_published() -> None:
    scene = get_scene("williamson5")
    lon, lat = random_points()
    away = np.hypot(np.mod(lon + 0.5 * np.pi + 1.0, 2.0 * np.pi) - 1.0, lat - np.pi / 6) > 0.5
    east, north, largest = Residual(scene, 0.01).momentum(lon[away], lat[away], 0.0)
    assert max(np.abs(east).max(), np.abs(north).max()) < 1e-10 * largest
    equator, zero = scene.initial(np.zeros(1), np.zeros(1)), pytest.approx(0.0)
    assert (equator[0], equator[1], equator[2]) == (pytest.approx(20.0), zero, 5960.0)


def test_williamson6_depth_keeps_the_wind_free_of_divergence() -> None:
    residual = Residual(get_scene("williamson6"), 0.02)
    lon, lat = random_points(100, -1.2, 1.2)
    fields = [lambda x, y, s, i=i: residual.momentum(x, y, s)[i] for i in (0, 1)]
    start = residual.divergence(residual.field(0), residual.field(1), lon, lat, 0.0)
    growth = residual.divergence(fields[0], fields[1], lon, lat, 0.0)
    one = residual.east(fields[0], lon, lat, 0.0)
    assert np.abs(start).max() < 1e-10 * 100.0 / EARTH.radius
    assert np.abs(growth).max() < 1e-7 * np.abs(one).max()


@pytest.mark.parametrize("case", VARIANTS, ids=label)
def test_fields_are_finite_everywhere(case: tuple[str, Given]) -> None:
    scene = get_scene(case[0], **case[1])
    corner = np.arctan(np.sqrt(0.5))
    lon = np.array([0.0, 0.0, *(np.pi / 4 + np.pi / 2 * np.arange(4)).repeat(2)])
    lat = np.array([np.pi / 2, -np.pi / 2, *[corner, -corner] * 4])
    for shape in ((10,), (5, 2)):
        for name, values in functions(scene, lon.reshape(shape), lat.reshape(shape)).items():
            assert values.shape == shape and values.dtype == np.float64, name
            assert np.isfinite(values).all(), name
    assert (functions(scene, lon, lat)["initial h"] >= 0.0).all()


def functions(scene: Scene, lon: Array, lat: Array) -> dict[str, Array]:
    """All that the scene says at the points."""
    found = dict(zip(("initial u", "initial v", "initial h"), scene.initial(lon, lat), strict=True))
    for name in ("bottom", "coriolis"):
        if (function := getattr(scene, name)) is not None:
            found[name] = function(lon, lat)
    for name in ("exact", "wind"):
        if (function := getattr(scene, name)) is not None:
            found |= {f"{name} {i}": f for i, f in enumerate(function(lon, lat, 1.3 * DAY))}
    return found


@pytest.mark.parametrize("case", VARIANTS, ids=label)
def test_wind_is_continuous_through_the_poles(case: tuple[str, Given]) -> None:
    scene = get_scene(case[0], **case[1])
    lon = np.linspace(0.0, 2.0 * np.pi, 9)
    states = [scene.initial] + ([lambda x, y: scene.exact(x, y, DAY)] if scene.exact else [])
    for state, sign in product(states, (-1.0, 1.0)):
        pole = cartesian(np.zeros(1), np.array([sign * np.pi / 2.0]), state)
        near = cartesian(lon, np.full(9, sign * (np.pi / 2.0 - 1e-7)), state)
        at = cartesian(lon, np.full(9, sign * np.pi / 2.0), state)
        np.testing.assert_allclose(near, np.repeat(pole, 9, axis=0), atol=1e-4)
        np.testing.assert_allclose(at, np.repeat(pole, 9, axis=0), atol=1e-10)


def cartesian(lon: Array, lat: Array, state: Callable[..., tuple[Array, Array, Array]]) -> Array:
    """The wind as vectors (..., 3) in space."""
    u, v, _ = state(lon, lat)
    east = np.stack([-np.sin(lon), np.cos(lon), 0.0 * lon], -1)
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    return u[:, None] * east + v[:, None] * np.stack(north, -1)


@pytest.mark.parametrize("case", EXACT, ids=label)
def test_initial_state_is_the_exact_one(case: tuple[str, Given]) -> None:
    scene = get_scene(case[0], **case[1])
    pair = zip(scene.initial(*random_points()), scene.exact(*random_points(), 0.0), strict=True)
    for start, exact in pair:
        np.testing.assert_array_equal(start, exact)
    assert dict(scene.parameters).items() >= case[1].items()
