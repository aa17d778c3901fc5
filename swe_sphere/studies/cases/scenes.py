"""Scenes that only cases use; "(exact)" marks scenes with an exact solution."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from swe_sphere.equations import effects
from swe_sphere.equations.scene import Array, Scalar, Scene, UnsteadyState
from swe_sphere.errors import unknown_name
from swe_sphere.planet import DAY, EARTH, Planet
from swe_sphere.settings.values import SCENE
from swe_sphere.simulation import build
from swe_sphere.simulation.config import RunConfig
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.flows import at_rest, cone, distance, sin_tilted_latitude, solid_body
from swe_sphere.testcases.harmonics import BalancedFlow, random_streamfunction
from swe_sphere.testcases.user_scenes import made

ThreeFields = tuple[Array, Array, Array]
"""u, v [m s-1] and h [m], or three other fields on the same points."""
MEAN = 1000.0
"""Mean depth [m]."""
EMPTY = Scene("empty", (), at_rest(MEAN), ne=4, days=1.0)
"""Scene without effects, in which nothing acts on the fluid."""


def decay(nu: float = 0.0, nu4: float = 0.0, default: bool = False) -> Scene:
    """Spherical harmonics that decay by viscosity and hyperviscosity (exact).

    With Y = cos³ θ cos 3λ + ... of degree l = 3, depth 1000 m + 100 m Y and wind
    10 m/s a (grad Y + k x grad Y) decay at the rate nu κ² + nu4 κ⁴ with κ² = l (l + 1)/a². The
    Laplacian of the wind is Hodge's, whose eigenvalue on gradients and curls of Y is the same.

    nu: viscosity [m2 s-1]; nu4: hyperviscosity [m4 s-1]; default: leave the hyperviscosity of the
    model to its scaling with the mesh, so that the error shows whether that is nu4.
    """
    wavenumber = 12 / EARTH.radius**2
    rate = nu * wavenumber + nu4 * wavenumber**2

    def exact(lon: Array, lat: Array, t: float) -> ThreeFields:
        value, east, north = _harmonic(lon, lat)
        left = np.exp(-rate * t)
        wind = 10.0 * left
        return wind * (east - north), wind * (east + north), MEAN + 100.0 * left * value

    diffusion = (effects.Viscosity(nu), effects.Hyperviscosity(None if default else nu4))
    present = tuple(effect for effect in diffusion if not effect.absent)
    return _starting(exact, EMPTY, name="decay", effects=present)


def friction(linear: float, quadratic: float, time: float) -> Scene:
    """Drag and relaxation alone, node by node (exact).

    The wind follows d|v|/dt = -r |v| - c |v|², so |v| = r s / ((r + c s) exp(r t) - c s), where s
    is its initial value. The depth approaches its equilibrium exponentially.

    linear: r [s-1]; quadratic: c [m-1]; time: time scale of the relaxation of depth [s].
    """

    def equilibrium(lon: Array, lat: Array) -> Array:
        return MEAN + 100.0 * np.sin(lat) + 0.0 * lon

    def exact(lon: Array, lat: Array, t: float) -> ThreeFields:
        value, east, north = _harmonic(lon, lat)
        wind = 10.0 * np.stack([east, north])
        first = np.hypot(*wind)
        slower = linear / ((linear + quadratic * first) * np.exp(linear * t) - quadratic * first)
        rest = equilibrium(lon, lat)
        depth = rest + (MEAN + 100.0 * value - rest) * np.exp(-t / time)
        return slower * wind[0], slower * wind[1], depth

    damping = (effects.Drag(linear, quadratic), effects.Relaxation(time))
    return _starting(exact, EMPTY, name="friction", effects=damping, equilibrium=equilibrium)


def driven(alpha: float = np.pi / 4.0) -> Scene:
    """Solid-body flow that is maintained by a forcing of wind and depth (exact).

    The planet does not rotate. With s the sine of the latitude above the equator of the flow,

        h = (3000 m - 1000 m s²) (1 + t/T),
        Fh = h(0)/T,  Fv = (u0² - 2 g 1000 m (1 + t/T)) s grad s / a,

    keep the wind constant. T is 5 days, u0 is 40 m/s, and grad is taken on the unit sphere.

    alpha: tilt of the axis of the flow [rad].
    """
    speed, drop, doubling = 40.0, 1000.0, 5.0 * DAY

    def exact(lon: Array, lat: Array, t: float) -> ThreeFields:
        return *solid_body(lon, lat, alpha, speed), first(lon, lat) * (1.0 + t / doubling)

    def first(lon: Array, lat: Array) -> Array:
        return 3000.0 - drop * sin_tilted_latitude(lon, lat, alpha) ** 2

    def forcing(lon: Array, lat: Array, t: float) -> ThreeFields:
        pull = speed**2 - 2.0 * EARTH.gravity * drop * (1.0 + t / doubling)
        push = pull / EARTH.radius * sin_tilted_latitude(lon, lat, alpha)
        east = np.sin(alpha) * np.sin(lon)
        north = np.sin(alpha) * np.sin(lat) * np.cos(lon) + np.cos(alpha) * np.cos(lat)
        return push * east, push * north, first(lon, lat) / doubling

    driving = (*effects.DYNAMICS, effects.Forcing())
    return _starting(exact, EMPTY, name="driven", effects=driving, forcing=forcing)


def _starting(exact: UnsteadyState, base: Scene, **values: Any) -> Scene:
    """Return `base` with other values and an exact solution, which is also its initial state."""
    return replace(base, initial=lambda lon, lat: exact(lon, lat, 0.0), exact=exact, **values)


def _harmonic(lon: Array, lat: Array) -> ThreeFields:
    """Return Y = x³ - 3 x y² + 15 x y z, and a times its gradient eastward and northward."""
    c, s = np.cos(lat), np.sin(lat)
    value = c**3 * np.cos(3.0 * lon) + 7.5 * s * c**2 * np.sin(2.0 * lon)
    east = -3.0 * c**2 * np.sin(3.0 * lon) + 15.0 * s * c * np.cos(2.0 * lon)
    north = -3.0 * c**2 * s * np.cos(3.0 * lon) + 7.5 * (c**3 - 2.0 * s**2 * c) * np.sin(2.0 * lon)
    return value, east, north


def _changed(name: str, change: Callable[..., ThreeFields], **values: Any) -> Scene:
    """Return a built-in scene with other values, its initial state changed by `change`."""
    base = get_scene(name)
    return replace(base, initial=lambda *at: change(*at, *base.initial(*at)), **values)


HOMME = replace(EARTH, radius=6.376e6)
"""The planet of HOMME, which is 0.08 % larger than that of Williamson et al."""


def homme_mountain() -> Scene:
    """williamson5 on the planet of HOMME.

    The wind of u0 = 20 m/s is the same; its balance makes the surface fall by another
    (a - 6.37122e6 m) Ω u0 sin² θ / g.
    """
    more = (HOMME.radius - EARTH.radius) * EARTH.rotation * 20.0 / EARTH.gravity
    return _changed(
        "williamson5", lambda lon, lat, u, v, h: (u, v, h - more * np.sin(lat) ** 2), planet=HOMME
    )


def homme_wave() -> Scene:
    """williamson6 on the planet of HOMME.

    Its angular speeds are the same: the wind grows with the radius, and the part of the depth
    beyond 8000 m with the square of the radius.
    """
    more = HOMME.radius / EARTH.radius
    return _changed(
        "williamson6", planet=HOMME,
        change=lambda lon, lat, u, v, h: (more * u, more * v, 8000.0 + more**2 * (h - 8000.0)),
    )  # fmt: skip


def nondivergent_wave(depth: float) -> Scene:
    """williamson6 of a polar depth [m]; great depths approach the exact nondivergent limit.

    Without divergence the wave turns eastward at (28 ω - 2 Ω) / 30 and keeps its shape.
    """
    speed = (28.0 * 7.848e-6 - 2.0 * EARTH.rotation) / 30.0
    base = get_scene("williamson6", depth=depth)
    return _starting(lambda lon, lat, t: base.initial(lon - speed * t, lat), base)


def thin_flow(depth: float, alpha: float) -> Scene:
    """The wind of williamson2 in a layer of uniform depth over a bottom that balances it (exact).

    The continuous flow is stable at every depth: in the frame of the fluid it is a layer at rest.
    If the wind is faster than the gravity waves, schemes whose vorticity flux and kinetic energy do
    not match become unstable (Hollingsworth et al. 1983; Peixoto, Thuburn & Bell 2018).

    depth: thickness of the layer [m]; alpha: tilt of the axis of flow and of rotation [rad].
    """
    base = get_scene("williamson2", alpha=alpha)
    return _starting(
        lambda lon, lat, t: (*base.initial(lon, lat)[:2], depth + 0.0 * lon), base,
        bottom=lambda *at: base.initial(*at)[2], effects=(*base.effects, effects.Orography()),
    )  # fmt: skip


def thin_layer(outside: float) -> Scene:
    """A dam of 1000 m that breaks onto water of the depth `outside` [m]."""
    return _changed(
        "dam-break",
        lambda lon, lat, u, v, h: (u, v, outside + (1000.0 - outside) * (h - 1000.0) / 1000.0),
    )


def noisy(name: str) -> Scene:
    """The scene with noise from node to node, 1 m/s in the winds and 10 m in the depth (rms)."""

    def change(lon: Array, lat: Array, u: Array, v: Array, h: Array) -> ThreeFields:
        du, dv, dh = noise(lon.shape, seed=1)
        return u + du, v + dv, h + 10.0 * dh

    return _changed(name, change, exact=None)


def noise(shape: tuple[int, ...], seed: int) -> Array:
    """Return three fields of independent standard normal numbers, uncorrelated between nodes."""
    return np.random.Generator(np.random.PCG64(seed)).standard_normal((3, *shape))


Bottom = Literal["mesa", "peak", "island"]
BOTTOMS: dict[str, Scalar] = {
    "mesa": lambda lon, lat: np.where(
        distance(lon, lat, 1.5 * np.pi, np.pi / 6.0) < np.pi / 9.0, 2000.0, 0.0
    ),
    "peak": lambda lon, lat: 2.5 * cone(lon, lat),
    "island": lambda lon, lat: 3.5 * cone(lon, lat),
}
"""Bottoms by name: the mesa, around the centre of the mountain of williamson5, has vertical sides;
the peak of 5000 m is 960 m below the surface at rest, the island of 7000 m rises above it."""


def lake_over(bottom: Bottom) -> Scene:
    """The lake at rest over another bottom (exact)."""
    mountain = BOTTOMS[bottom]
    return _starting(
        lambda lon, lat, t: (0.0 * lon, 0.0 * lat, 5960.0 - mountain(lon, lat)),
        get_scene("lake-at-rest"), bottom=mountain,
    )  # fmt: skip


def flow_over(bottom: Bottom) -> Scene:
    """The flow of williamson5 over another bottom."""
    mountain = BOTTOMS[bottom]
    return _changed(
        "williamson5", bottom=mountain,
        change=lambda lon, lat, u, v, h: (u, v, h + cone(lon, lat) - mountain(lon, lat)),
    )  # fmt: skip


def zonal(radius: float, gravity: float, rotation: float, depth: float) -> Scene:
    """Steady zonal flow of 40 m/s as in williamson2 (exact), with this mean depth; SI units."""
    speed = 40.0
    fall = (radius * rotation * speed + 0.5 * speed**2) / gravity

    def exact(lon: Array, lat: Array, t: float) -> ThreeFields:
        h = depth + fall * (1.0 / 3.0 - np.sin(lat) ** 2)
        return speed * np.cos(lat) + 0.0 * lon, 0.0 * (lon + lat), h + 0.0 * lon

    planet = Planet(radius, gravity, rotation)
    return _starting(exact, get_scene("williamson2"), planet=planet, coriolis=None)


SHALLOWEST = 0.2
"""A state is admissible if its depth is nowhere below this fraction of the mean."""
FASTEST = 0.6
"""Largest admissible wind, as a fraction of the speed of gravity waves (the Froude number)."""


def random_setting(seed: int) -> tuple[dict[str, Any], dict[str, float]]:
    """Return the mesh of a seed (keys of a run), and its step (`part` and `courant` of a case)."""
    draw = np.random.default_rng((seed, 1))
    nodes = int(draw.choice([3, 4, 6]))
    mesh = {
        "np": nodes, "ne": int(draw.integers(2, 5 if nodes == 6 else 7)),
        "stretch": float(draw.choice([1.0, 1.0, 2.0, 4.0])),
        "centre_lon": float(draw.uniform(0.0, 360.0)),
        "centre_lat": float(draw.uniform(-86.0, 86.0)), "spin": float(draw.uniform(0.0, 86.0)),
    }  # fmt: skip
    part = float(draw.uniform(0.3, 0.95))
    return mesh, {"part": part, "courant": float(10.0 ** draw.uniform(0.0, 1.5))}


def random_state(seed: int) -> Scene:
    """Random balanced flow over random hills on a random planet, out of balance with the hills.

    Radius and gravity are within a factor of three of the Earth's, the rotation is at most twice
    as fast, and the mean depth is 100 m to 20 km. Each hill or hollow is up to a twentieth of the
    depth, and noise from node to node is 0.1 %.  Speeds are halved until the state is admissible.
    """
    draw = np.random.default_rng((seed, 0))
    planet = Planet(
        EARTH.radius * 3.0 ** draw.uniform(-1.0, 1.0),
        EARTH.gravity * 3.0 ** draw.uniform(-1.0, 1.0),
        EARTH.rotation * draw.uniform(-2.0, 2.0),
    )
    depth = 10.0 ** draw.uniform(2.0, 4.3)
    wave = float(np.sqrt(planet.gravity * depth))
    hills = _hills(draw, 0.1 * depth)
    speed = wave * draw.uniform(0.02, 0.2)

    def initial(lon: Array, lat: Array) -> ThreeFields:
        u, v, h = _admissible(planet, depth, speed, seed).state(lon, lat)
        bumps = noise(lon.shape, seed)
        return (u + 1e-3 * wave * bumps[0], v + 1e-3 * wave * bumps[1],
                h - hills(lon, lat) + 1e-3 * depth * bumps[2])  # fmt: skip

    return Scene(
        "random-state", title="random admissible state", initial=initial, bottom=hills, days=1.0,
        effects=(*effects.DYNAMICS, effects.Rotation(), effects.Orography()), planet=planet, ne=4,
    )  # fmt: skip


def _admissible(planet: Planet, depth: float, speed: float, seed: int) -> BalancedFlow:
    """Return the fastest admissible flow; speeds are halved from `speed` on."""
    lon, lat = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 48), np.linspace(-1.57, 1.57, 24))
    while True:
        psi = random_streamfunction(np.ones_like, 8, speed, planet.radius, seed)
        flow = BalancedFlow(psi, planet, depth)
        u, v, h = flow.state(lon, lat)
        froude = float((np.hypot(u, v) / np.sqrt(planet.gravity * np.maximum(h, 1.0))).max())
        if h.min() > (SHALLOWEST + 0.15) * depth and froude < FASTEST:
            return flow
        speed *= 0.5


def _hills(draw: np.random.Generator, height: float) -> Scalar:
    """Return three hills or hollows of at most half that height [m] each, at random places."""
    places = [
        (draw.uniform(0.0, 2.0 * np.pi), np.arcsin(draw.uniform(-1.0, 1.0)),
         draw.uniform(-0.5, 0.5) * height, draw.uniform(0.15, 0.6))
        for _ in range(3)
    ]  # fmt: skip

    def bottom(lon: Array, lat: Array) -> Array:
        height = 0.0 * (lon + lat)
        for x, y, tall, wide in places:
            height = height + tall * np.exp(-((distance(lon, lat, x, y) / wide) ** 2))
        return height

    return bottom


SCENES: dict[str, Callable[..., Scene]] = {
    scene.__name__.replace("_", "-"): scene
    for scene in (
        decay, friction, driven, homme_mountain, homme_wave, lake_over, flow_over, noisy,
        thin_layer, zonal, random_state, nondivergent_wave, thin_flow,
    )
}  # fmt: skip
"""Functions that build scenes, by names in files of cases; their parameters are scene settings."""


def make_scene(config: RunConfig) -> Scene:
    """Return the scene of a run of a case, which may be one of `SCENES`: "cases:NAME"."""
    prefix, _, name = config.scene.partition(":")
    if prefix != "cases":
        return build.make_scene(config)
    if name not in SCENES:
        raise unknown_name("scene of cases", name, SCENES)
    return build.make_scene(config, made(config.scene, SCENES[name], config.settings_of(SCENE)))
