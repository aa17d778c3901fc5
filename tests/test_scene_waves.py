"""Waves: the splash and the dam break in one dimension, in a turning frame; equatorial waves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support import advance

from swe_sphere import Simulation
from swe_sphere.equations.effects import DYNAMICS, Orography, Rotation
from swe_sphere.equations.model import Model
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Interpolator, Mesh
from swe_sphere.planet import DAY, EARTH, HOUR
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.flows import distance
from swe_sphere.testcases.harmonics import legendre
from swe_sphere.testcases.waves import DEPTH, PLANET, EquatorialMode

MESH = Mesh.build(6, 8)


def after(scene: Scene, hours: float, dt: float = 300.0, mesh=MESH) -> dict[str, Array]:
    """The fields after some hours of rk4."""
    model = Model(mesh, scene)
    stepper = advance("rk4", model, model.initial_state(), dt, hours * HOUR)
    return model.fields(stepper.state, stepper.time)


def mean_square(mesh, values: Array) -> float:
    return float(np.sqrt(np.average(values**2, weights=mesh.area)))


class Radial:
    """Axisymmetric flow without rotation: finite volumes in the angle γ from the centre.

        ∂(h s)/∂t + ∂(h u s)/∂γ / a = 0,  s = sin γ
        ∂(h u s)/∂t + ∂((h u² + g h²/2) s)/∂γ / a = g h²/2 cos γ / a

    Second order (harmonic limiter, HLL fluxes, Heun's method): nothing of it is shared with the
    model.
    """

    def __init__(self, profile: Callable[[Array], Array], cells: int = 1500) -> None:
        edges = np.linspace(0.0, np.pi, cells + 1)
        self.angle, self.sine = 0.5 * (edges[1:] + edges[:-1]), np.sin(edges)
        self.size = -np.diff(np.cos(edges)) * EARTH.radius
        self.width = EARTH.radius * np.pi / cells
        self.state = np.stack([profile(self.angle), np.zeros(cells)])

    def run(self, hours: float) -> Array:
        """The depth [m] after some hours."""
        left = hours * HOUR
        while left > 0.0:
            h, q = self.state
            dt = min(left, 0.4 * self.width / (np.abs(q / h) + np.sqrt(EARTH.gravity * h)).max())
            guess = self.state + dt * self.rate(self.state)
            self.state = 0.5 * (self.state + guess + dt * self.rate(guess))
            left -= dt
        return self.state[0]

    def rate(self, state: Array) -> Array:
        (hl, hr), (ul, ur) = edges_of(state[0]), edges_of(state[1] / state[0])
        flux = hll(hr[:-1], ur[:-1], hl[1:], ul[1:]) * self.sine[1:-1]
        rate = -np.diff(np.pad(flux, ((0, 0), (1, 1))), axis=1) / self.size
        rate[1] += 0.5 * EARTH.gravity * state[0] ** 2 * np.diff(self.sine) / self.size
        return rate


def edges_of(f: Array) -> tuple[Array, Array]:
    """Values at the two edges of each cell."""
    padded = np.pad(f, 1, mode="edge")
    back, on = f - padded[:-2], padded[2:] - f
    slope = np.where(back * on > 0.0, back * on / (back + on + 1e-300), 0.0)
    return f - slope, f + slope


def hll(h0: Array, u0: Array, h1: Array, u1: Array) -> Array:
    g = EARTH.gravity
    c0, c1 = np.sqrt(g * h0), np.sqrt(g * h1)
    slow, fast = np.minimum(u0 - c0, u1 - c1).clip(max=0.0), np.maximum(u0 + c0, u1 + c1).clip(0.0)
    left, right = (np.stack([h * u, h * u**2 + 0.5 * g * h**2]) for h, u in ((h0, u0), (h1, u1)))
    jump = np.stack([h1 - h0, h1 * u1 - h0 * u0])
    return (fast * left - slow * right + slow * fast * jump) / (fast - slow)


def angles(mesh=MESH) -> Array:
    return distance(mesh.lon, mesh.lat, 1.5 * np.pi, 0.0)


@pytest.mark.parametrize(
    ("name", "given", "hours", "mean", "largest"),
    [
        ("dam-break", {"width": 0.1}, 4.0, 1.6, 20.0),
        ("dam-break", {"width": 0.05}, 2.0, 5.0, 50.0),
        ("splash", {}, 6.0, 1.0, 20.0),
    ],
)
def test_depth_is_that_of_one_dimension(
    name: str, given: dict[str, float], hours: float, mean: float, largest: float
) -> None:
    """Errors [m] of steps of 1000 m, before the bore is as steep as the mesh can hold."""
    scene = get_scene(name, **given)
    radial = Radial(lambda g: scene.initial(1.5 * np.pi - g, 0.0 * g)[2])
    error = after(scene, hours)["h"] - np.interp(angles(), radial.angle, radial.run(hours))
    assert mean_square(MESH, error) < mean and np.abs(error).max() < largest


def test_dam_break_stays_positive_and_keeps_its_mass() -> None:
    """For a day, though the bore rings."""
    scene = get_scene("dam-break")
    mesh = Mesh.build(8, 4)
    start = scene.initial(mesh.lon, mesh.lat)[2]
    h = after(scene, 24.0, 600.0, mesh)["h"]
    assert 300.0 < h.min() < h.max() < 2500.0
    assert np.average(h, weights=mesh.area) == pytest.approx(np.average(start, weights=mesh.area))
    with pytest.raises(ConfigError, match=r"dam-break: width must be positive, got -1\.0"):
        get_scene("dam-break", width=-1.0)


def turning_splash() -> Scene:
    """The splash seen from a frame that turns backwards by (40 m/s) / a.

    The bottom stands for the centrifugal force, which many codes leave out; depths are those of the
    still frame, turned eastward.
    """
    still, speed = get_scene("splash"), 40.0

    def centrifugal(lon: Array, lat: Array) -> Array:
        return (speed * np.sin(lat)) ** 2 / (2.0 * EARTH.gravity) + 0.0 * lon

    return replace(
        still, effects=(*DYNAMICS, Rotation(), Orography()), bottom=centrifugal,
        initial=lambda lon, lat: (speed * np.cos(lat), *still.initial(lon, lat)[1:]),
        planet=replace(EARTH, rotation=-speed / EARTH.radius),
    )  # fmt: skip


def test_splash_in_a_turning_frame_is_the_same_splash() -> None:
    """The depth is that of the still frame, turned; without the centrifugal force it is not."""
    hours, turning = 6.0, turning_splash()
    shift = 40.0 / EARTH.radius * hours * HOUR
    still, other = after(get_scene("splash"), hours), after(turning, hours)
    carried = Interpolator(MESH, MESH.lon - shift, MESH.lat)
    error = {name: other[name] - carried(still[name]) for name in "uvh"}
    error["u"] -= 40.0 * np.cos(MESH.lat)
    assert mean_square(MESH, error["h"]) < 0.7
    assert max(mean_square(MESH, error[name]) for name in "uv") < 0.04
    flat = after(turning.without_effect("orography"), hours)["h"]
    assert mean_square(MESH, flat - carried(still["h"])) > 10.0


def test_air_at_rest_among_the_stars_stays_at_rest() -> None:
    """The background of the turning splash is steady: exactly so in the equations."""
    scene = turning_splash()
    calm = replace(
        scene, initial=lambda lon, lat: (40.0 * np.cos(lat), 0.0 * lat, 2000.0 + 0.0 * lat)
    )
    fields = after(calm, 24.0, 600.0)
    assert np.abs(fields["h"] - 2000.0).max() < 1e-5 and np.abs(fields["v"]).max() < 1e-6


def test_splash_comes_together_at_the_antipode() -> None:
    """At the hour that one dimension tells: the crest arrives at day 1.44."""
    mesh = Mesh.build(6, 6)
    model = Model(mesh, get_scene("splash"))
    far = angles(mesh).argmax()
    stepper, height = advance("rk4", model, model.initial_state(), 450.0, 1.2 * DAY), {}
    while stepper.time < 1.7 * DAY:
        stepper.step()
        height[stepper.time / DAY] = model.fields(stepper.state)["h"][far]
    day = max(height, key=height.get)
    assert day == pytest.approx(1.44, abs=0.02) and height[day] > 4000.0


def spherical_frequencies(k: int, degree: int = 60) -> Array:
    """ω [s-1] of all waves of zonal wavenumber k on a fluid at rest on the sphere.

    Eigenvalues of the linear equations for ψ, χ and g h in spherical harmonics (Longuet-Higgins
    1968): no β-plane.
    """
    sine, weights = np.polynomial.legendre.leggauss(degree + 20)
    _, over_cos, slope = list(legendre(degree, np.arcsin(sine)))[k]
    east, n = 1j * k * over_cos / PLANET.radius, np.arange(k, degree + 1)
    north, f = slope / PLANET.radius, 2.0 * PLANET.rotation * sine
    winds = ((-north, east), (east, north))  # of ψ and of χ

    def tested(fx: Array, fy: Array) -> Array:
        return 0.5 * ((east.conj() * weights) @ fx.T + (north.conj() * weights) @ fy.T)

    m, square = len(n), n * (n + 1.0) / PLANET.radius**2
    rates = np.zeros((3 * m, 3 * m), dtype=complex)
    for j, (u, v) in enumerate(winds):
        rates[:m, j * m : (j + 1) * m] = -tested(f * u, f * v) / square[:, None]
        rates[m : 2 * m, j * m : (j + 1) * m] = tested(f * v, -f * u) / square[:, None]
    rates[m : 2 * m, 2 * m :] = -np.eye(m)
    rates[2 * m :, m : 2 * m] = np.diag(PLANET.gravity * DEPTH * square)
    return (1j * np.linalg.eigvals(rates)).real


def frequency(scene: Scene, mode: EquatorialMode, mesh, steps: int) -> float:
    """ω [s-1] of the model, from the phase of v after about a period."""
    model, end = Model(mesh, scene), scene.days * DAY
    stepper = advance("rk4", model, model.initial_state(), end / steps, end)
    shape = (
        mesh.area * mode.state(0.0 * mesh.lon, mesh.lat, 0.0)[1] * np.exp(-1j * mode.k * mesh.lon)
    )
    waves = [np.sum(shape * model.fields(s)["v"]) for s in (model.initial_state(), stepper.state)]
    phase = -np.angle(waves[1] / waves[0])
    return (phase + 2.0 * np.pi * round((mode.frequency * end - phase) / (2.0 * np.pi))) / end


@pytest.mark.parametrize("wave", ["eig", "wig"])
def test_matsuno_waves_move_as_on_the_sphere(wave: str) -> None:
    """Nearer to the sphere's frequency than that is to the β-plane's, of which it is 0.3 % off."""
    mode = EquatorialMode(wave, 5, 1, 1e-5)
    known = spherical_frequencies(5)
    exact = known[np.abs(known - mode.frequency).argmin()]
    assert 2e-3 < abs(exact / mode.frequency - 1.0) < 5e-3
    found = frequency(get_scene("matsuno", wave=wave), mode, Mesh.build(8, 6), 150)
    assert found == pytest.approx(exact, rel=6e-4)


def test_matsuno_rossby_wave_keeps_its_shape_for_a_period() -> None:
    scene, mesh = get_scene("matsuno"), Mesh.build(5, 6)
    fields = after(scene, 24.0 * scene.days, scene.days * DAY / 800, mesh)
    u, v, h = scene.exact(mesh.lon, mesh.lat, scene.days * DAY)
    assert mean_square(mesh, fields["v"] - v) < 0.055 * mean_square(mesh, v)
    assert mean_square(mesh, fields["u"] - u) < 0.055 * mean_square(mesh, u)
    assert mean_square(mesh, fields["h"] - h) < 0.055 * mean_square(mesh, h - DEPTH)


def test_matsuno_frequencies_and_published_values() -> None:
    """Periods of 18.488, 1.880 and 2.093 days; the three roots of the cubic add up to nothing."""
    periods = {"rossby": -18.488, "eig": 1.880, "wig": -2.093}
    roots = {wave: EquatorialMode(wave, 5, 1, 1.0).frequency for wave in periods}
    for wave, days in periods.items():
        assert 2.0 * np.pi / roots[wave] / DAY == pytest.approx(days, abs=1e-3)
    assert abs(sum(roots.values())) < 1e-12 * roots["eig"]


@pytest.mark.parametrize("wave", ["rossby", "eig", "wig"])
def test_matsuno_solves_the_equations_of_the_beta_plane(wave: str) -> None:
    mode, t, d = EquatorialMode(wave, 2, 3, 1.0), 5e3, 1e-4
    lon, lat = np.meshgrid(np.linspace(0.0, 6.0, 5), np.linspace(-0.5, 0.5, 11))
    a, f = PLANET.radius, 2.0 * PLANET.rotation * lat

    def slope(move: Callable[[float], tuple[Array, Array, Array]], step: float) -> Array:
        up, down = (np.array(move(s * step)) for s in (1.0, -1.0))
        return (up - down) / (2.0 * step)

    rate = slope(lambda s: mode.state(lon, lat, t + s), 20.0)
    east = slope(lambda s: mode.state(lon + s, lat, t), d) / a
    north = slope(lambda s: mode.state(lon, lat + s, t), d) / a
    u, v, _ = mode.state(lon, lat, t)
    residuals = {
        "u": (rate[0] - f * v + PLANET.gravity * east[2], f * v),
        "v": (rate[1] + f * u + PLANET.gravity * north[2], f * u),
        "h": (rate[2] + DEPTH * (east[0] + north[1]), rate[2]),
    }
    for residual, scale in residuals.values():
        assert np.abs(residual).max() < 1e-5 * np.abs(scale).max()


def test_full_equations_give_the_same_wave_at_a_tiny_amplitude() -> None:
    linear, full = (get_scene("matsuno", wave="eig", linear=x) for x in (True, False))
    assert full.effect("linearised") is None and linear.effect("linearised") is not None
    one, two = (after(scene, 12.0, 1800.0, Mesh.build(3, 6)) for scene in (linear, full))
    np.testing.assert_allclose(one["v"], two["v"], rtol=0.0, atol=1e-4 * np.abs(one["v"]).max())
    with pytest.raises(ConfigError, match="matsuno: k must be 1 to 500 and n 1 to 40, got 5 and 0"):
        get_scene("matsuno", n=0)
    with pytest.raises(ConfigError, match="matsuno: wave must be one of rossby, eig, wig, got 'x'"):
        get_scene("matsuno", wave="x")


@pytest.mark.thorough
def test_the_wave_of_williamson6_reaches_its_nondivergent_speed() -> None:
    """12.195 degrees a day, which is missed by less, as one over the depth, the deeper it is."""
    exact = np.degrees((28.0 * 7.848e-6 - 2.0 * EARTH.rotation) / 30.0 * DAY)
    assert exact == pytest.approx(12.195, abs=1e-3)
    slower = []
    for depth in (8e4, 8e5):
        scene = get_scene("williamson6", depth=depth)
        sim = Simulation(scene, ne=4, np=6, stepper="semi-implicit", dt=900.0)
        pattern = sim.mesh.area * np.sin(sim.mesh.lat) * np.exp(-4j * sim.mesh.lon)
        before = np.sum(pattern * sim.state.v.values)
        sim.run(days=1.0)
        turned = -np.angle(np.sum(pattern * sim.state.v.values) / before) / 4.0
        slower.append(1.0 - np.degrees(turned) / exact)
    assert 0.0 < slower[1] < 2e-3
    assert slower[0] == pytest.approx(10.0 * slower[1], rel=0.2)
