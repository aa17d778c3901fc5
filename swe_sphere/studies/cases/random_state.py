"""Random admissible states: a planet, a mesh, a bottom, a flow and noise, all from one seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Orography, Rotation
from swe_sphere.equations.scene import Array, Scene
from swe_sphere.planet import EARTH, Planet
from swe_sphere.testcases.flows import distance
from swe_sphere.testcases.random_flow import BalancedFlow, random_streamfunction

SHALLOWEST = 0.2
"""A state is admissible if its depth is nowhere below this part of the mean."""
FASTEST = 0.6
"""Nor its wind above this part of the speed of gravity waves (the Froude number)."""
HILLS = 3
DEGREE = 8


@dataclass(frozen=True)
class Length:
    """A random step: a part of the stability limit, or so many gravity-wave limits without one."""

    part: float
    courant: float


def noise(shape: tuple[int, ...], seed: int) -> Array:
    """Three fields of independent normal numbers: as rough as a mesh can show."""
    return np.random.Generator(np.random.PCG64(seed)).standard_normal((3, *shape))


def random_setting(seed: int) -> tuple[dict[str, Any], Length]:
    """Mesh (fields of a run) and step of a seed."""
    draw = np.random.default_rng((seed, 1))
    nodes = int(draw.choice([3, 4, 6]))
    mesh = {
        "np": nodes,
        "ne": int(draw.integers(2, 5 if nodes == 6 else 7)),
        "stretch": float(draw.choice([1.0, 1.0, 2.0, 4.0])),
        "centre_lon": float(draw.uniform(0.0, 360.0)),
        "centre_lat": float(draw.uniform(-86.0, 86.0)),
        "spin": float(draw.uniform(0.0, 86.0)),
    }
    return mesh, Length(float(draw.uniform(0.3, 0.95)), float(10.0 ** draw.uniform(0.0, 1.5)))


def random_scene(seed: int) -> Scene:
    """Random balanced flow over random hills on a random planet, out of balance with the hills.

    Radius and gravity within a factor of three of the Earth's, any rotation up to twice the
    Earth's, mean depths from 100 m to 20 km, hills and hollows of a tenth of that, noise of 0.1 %
    from node to node.  Speeds are halved until the state is admissible.
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

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = _admissible(planet, depth, speed, seed).state(lon, lat)
        bumps = noise(lon.shape, seed)
        return (u + 1e-3 * wave * bumps[0], v + 1e-3 * wave * bumps[1],
                h - hills(lon, lat) + 1e-3 * depth * bumps[2])  # fmt: skip

    return Scene(
        name="random-state",
        title="random admissible state",
        effects=(*DYNAMICS, Rotation(), Orography()),
        initial=initial,
        bottom=hills,
        planet=planet,
        ne=4,
        days=1.0,
    )


def _admissible(planet: Planet, depth: float, speed: float, seed: int) -> BalancedFlow:
    """The flow, as fast as it may be."""
    lon, lat = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 48), np.linspace(-1.57, 1.57, 24))
    while True:
        psi = random_streamfunction(np.ones_like, DEGREE, speed, planet.radius, seed)
        flow = BalancedFlow(psi, planet, depth)
        u, v, h = flow.state(lon, lat)
        froude = float((np.hypot(u, v) / np.sqrt(planet.gravity * np.maximum(h, 1.0))).max())
        if h.min() > (SHALLOWEST + 0.15) * depth and froude < FASTEST:
            return flow
        speed *= 0.5


def _hills(draw: np.random.Generator, height: float) -> Any:
    """Hills and hollows of at most that height [m] each at random places."""
    places = [
        (draw.uniform(0.0, 2.0 * np.pi), np.arcsin(draw.uniform(-1.0, 1.0)),
         draw.uniform(-0.5, 0.5) * height, draw.uniform(0.15, 0.6))
        for _ in range(HILLS)
    ]  # fmt: skip

    def bottom(lon: Array, lat: Array) -> Array:
        parts = (
            tall * np.exp(-((distance(lon, lat, x, y) / wide) ** 2)) for x, y, tall, wide in places
        )
        return np.asarray(sum(parts, start=0.0 * (lon + lat)))

    return bottom
