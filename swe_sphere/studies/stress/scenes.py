"""Scenes that only a stress trial wants: steps in the bottom, noise, thin water, other planets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from swe_sphere.equations.effects import DYNAMICS, Rotation
from swe_sphere.equations.scene import Array, Scalar, Scene
from swe_sphere.planet import Planet
from swe_sphere.studies.stress.random_state import noise, random_scene
from swe_sphere.testcases import get_scene
from swe_sphere.testcases.flows import cone, coriolis, distance
from swe_sphere.testcases.random_flow import BalancedFlow, random_streamfunction

PLACE = (1.5 * np.pi, np.pi / 6.0)
"""Where the mountain of williamson5 stands [rad]."""
RADIUS = np.pi / 9.0

PLANETS = {
    "mars": (Planet(3.3895e6, 3.71, 7.088e-5), 3000.0),
    "jupiter": (Planet(7.1492e7, 24.79, 1.7585e-4), 1.0e5),
    "venus": (Planet(6.0518e6, 8.87, -2.9924e-7), 3000.0),
    "still": (Planet(6.37122e6, 9.80616, 0.0), 3000.0),
}
"""Planets that are not the Earth, and the mean depth of their water here [m]."""


def mesa(lon: Array, lat: Array) -> Array:
    """A mountain with vertical sides: 2000 m within 20 degrees of its centre, else nothing."""
    return np.where(distance(lon, lat, *PLACE) < RADIUS, 2000.0, 0.0)


def _cone_of(height: float) -> Scalar:
    """The cone of williamson5, which is 2000 m high, with another height [m]."""
    return lambda lon, lat: height / 2000.0 * cone(lon, lat)


BOTTOMS: dict[str, Scalar] = {"mesa": mesa, "peak": _cone_of(5000.0), "island": _cone_of(7000.0)}
"""Bottoms by name: the peak is 960 m below the surface at rest, the island looks out of it."""

Bottom = Literal["mesa", "peak", "island"]


def lake_over(bottom: Bottom) -> Scene:
    """The lake at rest over another bottom."""
    lake: Scene = get_scene("lake-at-rest")
    mountain = BOTTOMS[bottom]

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        still = 0.0 * (lon + lat)
        return still, still.copy(), 5960.0 - mountain(lon, lat)

    return replace(
        lake, initial=lambda lon, lat: exact(lon, lat, 0.0), exact=exact, bottom=mountain
    )


def flow_over(bottom: Bottom) -> Scene:
    """The flow of williamson5 over another bottom."""
    base: Scene = get_scene("williamson5")
    mountain = BOTTOMS[bottom]

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = base.initial(lon, lat)
        return u, v, h + cone(lon, lat) - mountain(lon, lat)

    return replace(base, initial=initial, bottom=mountain)


def noisy(name: str, wind: float = 1.0, depth: float = 10.0, seed: int = 1) -> Scene:
    """The scene with noise from node to node: rms of the winds [m s-1] and of the depth [m]."""
    base: Scene = get_scene(name)

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = base.initial(lon, lat)
        du, dv, dh = noise(lon.shape, seed)
        return u + wind * du, v + wind * dv, h + depth * dh

    return replace(base, initial=initial, exact=None)


def thin_layer(outside: float) -> Scene:
    """A dam of 1000 m that breaks onto water of another depth [m]."""
    base: Scene = get_scene("dam-break")

    def initial(lon: Array, lat: Array) -> tuple[Array, Array, Array]:
        u, v, h = base.initial(lon, lat)
        return u, v, outside + (1000.0 - outside) * (h - 1000.0) / 1000.0

    return replace(base, initial=initial)


PlanetName = Literal["mars", "jupiter", "venus", "still"]


def zonal(name: PlanetName, speed: float = 40.0) -> Scene:
    """Steady zonal flow as in williamson2 on another planet (exact)."""
    planet, depth = PLANETS[name]
    fall = (planet.radius * planet.rotation * speed + 0.5 * speed**2) / planet.gravity

    def exact(lon: Array, lat: Array, t: float) -> tuple[Array, Array, Array]:
        h = depth + fall * (1.0 / 3.0 - np.sin(lat) ** 2)
        return speed * np.cos(lat) + 0.0 * lon, 0.0 * (lon + lat), h + 0.0 * lon

    return _on(planet, initial=lambda lon, lat: exact(lon, lat, 0.0), exact=exact)


def eddies(name: PlanetName, speed: float = 10.0) -> Scene:
    """A random balanced flow on another planet, without any dissipation."""
    planet, depth = PLANETS[name]
    psi = random_streamfunction(lambda n: 1.0 / n**2, 8, speed, planet.radius, seed=3)
    flow = BalancedFlow(psi, planet, depth)
    return _on(planet, initial=flow.state, exact=None, effects=(*DYNAMICS, Rotation()))


def _on(planet: Planet, **changes: Any) -> Scene:
    """williamson2 on another planet, with further changes."""
    base: Scene = get_scene("williamson2")
    return replace(base, planet=planet, coriolis=lambda x, y: coriolis(x, y, planet), **changes)


SCENES = {
    "lake-over": lake_over,
    "flow-over": flow_over,
    "noisy": noisy,
    "thin-layer": thin_layer,
    "zonal": zonal,
    "eddies": eddies,
    "random-state": random_scene,
}
"""By the names in files of trials; their keyword parameters are those of the scene."""
