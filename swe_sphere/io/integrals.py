"""Means over the sphere: integrals that the equations conserve, error norms, Courant numbers.

Area means are I(psi) = integral of psi over the sphere / area of the sphere, by the quadrature of
the mesh. With |.| the length of the value (a number or a two-component vector), errors are

    l1 = I(|x - y|) / I(|y|),  l2 = sqrt(I(|x - y|^2) / I(|y|^2)),  linf = max|x - y| / max|y|.

If the exact field y vanishes everywhere, the norms are the absolute ones, in the units of the
field. (Williamson et al. 1992, eqs. 82-87 and 140-142, doi:10.1016/S0021-9991(05)80016-6.)

For each tracer the fields contain the mass hq_NAME (N,) [m] and the mixing ratio q_NAME (N,).
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.planet import Planet

DRIFTS = {
    "mass_drift": "mass", "energy_drift": "energy", "enstrophy_drift": "potential_enstrophy",
    "angular_momentum_drift": "axial_angular_momentum",
    "equatorial_momentum_drift": "equatorial_angular_momentum",
}  # fmt: skip
"""Name of each relative drift, and of the integral that drifts."""
AXES = ("angular_momentum_x", "angular_momentum_y", "angular_momentum_z")
"""Components of the angular momentum, whose length is the scale of its drifts."""
MOMENTA = (*AXES, "axial_angular_momentum", "equatorial_angular_momentum")


def area_mean(area: Array, values: Array) -> float:
    """Return the mean of values (N,) weighted with area (N,) [m2, or any common unit]."""
    return float(np.sum(area * values) / np.sum(area))


def norms(area: Array, numeric: ArrayLike, exact: ArrayLike) -> dict[str, float]:
    """Return the normalised mean, root-mean-square and largest errors "l1", "l2" and "linf".

    numeric, exact: scalars (N,) or vectors (2, N).
    """
    ours, theirs = (np.asarray(x, dtype=float).reshape(-1, area.size) for x in (numeric, exact))
    error, size = np.linalg.norm(ours - theirs, axis=0), np.linalg.norm(theirs, axis=0)
    return {
        "l1": area_mean(area, error) / (area_mean(area, size) or 1.0),
        "l2": float(np.sqrt(area_mean(area, error**2) / (area_mean(area, size**2) or 1.0))),
        "linf": float(np.max(error) / (np.max(size) or 1.0)),
    }


Fields = dict[str, Array]
"""Values (N,) by name of the field."""
Norms = dict[str, dict[str, float]]
"""Norms l1, l2 and linf by field."""


def field_errors(area: Array, numeric: Fields, exact: Fields, bottom: Array | float = 0.0) -> Norms:
    """Return the errors of depth "h" and, if both have them, of wind "v" and vorticity.

    numeric, exact: h [m] and perhaps u, v [m s-1] and vorticity [s-1], each (N,), at the same
    points. With bottom (N,) [m] the errors "h" are errors of the free surface, h + bottom.
    """
    pairs = {"h": (numeric["h"] + bottom, exact["h"] + bottom)}
    both = numeric.keys() & exact.keys()
    if {"u", "v"} <= both:
        pairs["v"] = np.array([numeric["u"], numeric["v"]]), np.array([exact["u"], exact["v"]])
    if "vorticity" in both:
        pairs["vorticity"] = (numeric["vorticity"], exact["vorticity"])
    return {name: norms(area, *pair) for name, pair in pairs.items()}


def by_name(errors: Norms) -> dict[str, float]:
    """Return the norms by the names l1_h, l2_h, linf_h, l1_v and so on."""
    return {f"{norm}_{name}": x for name, of in errors.items() for norm, x in of.items()}


def flow_integrals(
    mesh: Mesh, planet: Planet, u: Array, v: Array, h: Array, b: Array | float = 0.0,
    f: Array | float = 0.0, vorticity: Array | float = 0.0, divergence: Array | float = 0.0,
) -> dict[str, float]:  # fmt: skip
    """Return integrals and extremes of a state given at the nodes, all arrays (N,).

    u, v [m s-1], h, bottom b [m], Coriolis parameter f, vorticity and divergence [s-1]. Returns

        mass                 I(h) [m]
        energy               I(h |V|^2 / 2 + g ((h + b)^2 - b^2) / 2) [m3 s-2]
        potential_enstrophy  I((vorticity + f)^2 / (2 h)) [m-1 s-2]; NaN if any depth is not > 0
        MOMENTA              see `angular_momentum` [m3 s-1]
        total_vorticity, total_divergence   I(vorticity), I(divergence) [s-1]
        max_wind             largest wind speed [m s-1]
        min_depth            least depth [m]
        max_wave             largest gravity wave speed sqrt(g h) [m s-1]
        max_signal           largest |V| + sqrt(g h) [m s-1]
    """
    square = u**2 + v**2
    speed = np.sqrt(square)  # a fifth of the time of np.hypot
    wave = np.sqrt(planet.gravity * np.maximum(h, 0.0))
    enstrophy = (vorticity + f) ** 2 / (2.0 * h) if h.min() > 0.0 else np.nan * h
    energy = 0.5 * (h * square + planet.gravity * h * (h + 2.0 * b))
    return {
        "mass": area_mean(mesh.area, h), "energy": area_mean(mesh.area, energy),
        "potential_enstrophy": area_mean(mesh.area, enstrophy),
        **angular_momentum(mesh, u, v, h, f),
        "total_vorticity": area_mean(mesh.area, np.broadcast_to(vorticity, h.shape)),
        "total_divergence": area_mean(mesh.area, np.broadcast_to(divergence, h.shape)),
        "max_wind": float(speed.max()), "min_depth": float(h.min()), "max_wave": float(wave.max()),
        "max_signal": float((speed + wave).max()),
    }  # fmt: skip


def angular_momentum(
    mesh: Mesh, u: Array, v: Array, h: Array, f: Array | float
) -> dict[str, float]:
    """Return the absolute angular momentum I(h r × (V + Ω × r)) over the density [m3 s-1].

    u, v, h, f: as in `flow_integrals`. The components are along the axes of the rotating frame: x
    to 0°E, y to 90°E on the equator, z to the North Pole. Ω is the rotation whose Coriolis
    parameter is nearest to f in least squares. The component along Ω, or along z without rotation,
    is the axial one, which the continuous equations conserve over a bottom symmetric about the
    axis; the length of the remainder is the equatorial one. As the equations have no centrifugal
    force, they conserve it only over b = (|Ω| a sin θ)²/(2g) + const, θ the latitude from Ω.
    """
    a = mesh.radius
    east, north, axes = (np.ascontiguousarray(x.T) for x in (mesh.east, mesh.north, mesh.xyz))
    # einsum adds in the same order for any number of threads
    weighted = mesh.area * axes
    moments = np.einsum("in,n->i", weighted, 0.5 * np.broadcast_to(f, h.shape))
    rotation = np.linalg.solve(np.einsum("in,jn->ij", weighted, axes), moments)
    eastward = a * h * (u + a * np.einsum("i,in->n", rotation, north))
    northward = a * h * (v - a * np.einsum("i,in->n", rotation, east))
    total = [area_mean(mesh.area, x) for x in eastward * north - northward * east]
    speed = float(np.linalg.norm(rotation))
    # the quadrature error of an f-plane has no direction
    axis = rotation / speed if speed > 0.01 * np.abs(f).max() else (0.0, 0.0, 1.0)
    axial = float(sum(x * y for x, y in zip(total, axis, strict=True)))
    across = float(np.linalg.norm(np.subtract(total, np.multiply(axial, axis))))
    return dict(zip(MOMENTA, (*total, axial, across), strict=True))


def drifts(start: Mapping[str, float], now: Mapping[str, float]) -> dict[str, float]:
    """Return the relative changes (X - X0) / X0 of integrals; NaN if X0 is zero or NaN.

    Changes of the angular momentum are relative to the length of the vector.
    """
    scales = {**start, **dict.fromkeys(MOMENTA, math.hypot(*(start[name] for name in AXES)))}
    pairs = {name: (now[key] - start[key], scales[key]) for name, key in DRIFTS.items()}
    return {name: change / x if x else math.nan for name, (change, x) in pairs.items()}


def courant_numbers(mesh: Mesh, dt: float, now: Mapping[str, float]) -> dict[str, float]:
    """Return the Courant numbers of a step dt [s] on the smallest mean node spacing of the mesh.

    now: integrals; courant_gravity is that of the fastest signal, the wind plus a gravity wave.
    """
    rate = abs(dt) / mesh.spacing()[0]
    return {
        "courant_advective": rate * now["max_wind"],
        "courant_gravity": rate * now["max_signal"],
    }


def tracer_masses(mesh: Mesh, fields: Fields, names: Iterable[str]) -> dict[str, float]:
    """Return the area mean of hq [m] by tracer."""
    return {name: area_mean(mesh.area, fields[f"hq_{name}"]) for name in names}


def tracer_numbers(mesh: Mesh, fields: Fields, start: Mapping[str, float]) -> dict[str, float]:
    """Return mass_drift_q_NAME, min_q_NAME and max_q_NAME of each tracer.

    start: initial masses. The drift is relative, and NaN if the initial mass is zero.
    """
    numbers = {}
    for name, mass in tracer_masses(mesh, fields, start).items():
        first, q = start[name], fields[f"q_{name}"]
        numbers[f"mass_drift_q_{name}"] = (mass - first) / first if first else float("nan")
        numbers[f"min_q_{name}"], numbers[f"max_q_{name}"] = float(q.min()), float(q.max())
    return numbers
