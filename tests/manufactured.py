"""Scenes made so that the discrete equations have a known solution: every stepper must find it."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from cartesian import Cartesian
from support import EXPLICIT, make_scene

from swe_sphere.equations.effects import Forcing, Hyperviscosity
from swe_sphere.mesh import Mesh

MESH = Mesh.build(2, 4, spin=17.0)
OMEGA = 2.0 * np.pi / 14400.0
DURATION = 3600.0
STEPS = {
    "bdf2": 225.0,
    "epi5": 225.0,
    "mis3c": 112.5,
    "average-vector-field": 900.0,
    "esdirk4": 900.0,
    "gauss-legendre": 900.0,
}
"""Longest step [s] from which the order shows, 450 s for the others."""


def answer(t: float, rate: bool = False) -> np.ndarray:
    """A flow (3N,) that changes in time, or its derivative [s-1 of each]."""
    lon, lat = MESH.lon, MESH.lat
    wave, drift = (np.sin, np.cos) if not rate else (_dsin, _dcos)
    still = 0.0 if rate else 1.0
    u = 10.0 * np.cos(lat) * (still + 0.5 * drift(OMEGA * t))
    v = 5.0 * np.cos(lat) * np.sin(2.0 * lon) * wave(OMEGA * t)
    h = 2000.0 * still + 100.0 * np.cos(lat) * np.sin(lon) * drift(OMEGA * t)
    return np.concatenate([u, v, h + 20.0 * wave(OMEGA * t)])


def _dsin(phase: float) -> float:
    return OMEGA * np.cos(phase)


def _dcos(phase: float) -> float:
    return -OMEGA * np.sin(phase)


@functools.cache  # steppers and halved steps ask for the same times
def manufactured(*names: str, nu: float | None = None):
    """The scene whose forcing makes `answer` the exact solution in time on `MESH`.

    nu: a hyperviscosity [m4 s-1] to take instead of that of the scene.
    """
    unforced = make_scene(*names)
    if nu is not None:
        unforced = unforced.with_effect(Hyperviscosity(nu))
    check = Cartesian(MESH, unforced)

    @functools.cache
    def at(t):
        return np.split(answer(t, rate=True) - check.tendency(answer(t), t), 3)

    def forcing(lon, lat, t):
        assert lon is MESH.lon and lat is MESH.lat
        return at(t)

    def initial(lon, lat):
        return np.split(answer(0.0), 3)

    effects = (*unforced.effects, Forcing())
    return replace(unforced, effects=effects, forcing=forcing, initial=initial)


def tight(name: str, tolerance: float = 1e-9) -> dict[str, float]:
    """The option that has equations solved to a tolerance, where the stepper solves any."""
    solves = name not in EXPLICIT
    return {"tolerance": tolerance} if solves else {}
