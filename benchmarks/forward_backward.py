"""Derive the coefficients of the stepper forward-backward: about a minute.

    python benchmarks/forward_backward.py
    python benchmarks/forward_backward.py --strong      those for strong winds
    python benchmarks/forward_backward.py --seed 3

A wave exp(ikx) in a wind U obeys dh/dt = -i (U k) h - i (c k) u, du/dt = -i (U k) u - i (c k) h,
and vorticity dv/dt = -i (U k) v.  The search looks for the arguments of `level_weights` that allow
the longest steps k (c + U) dt, in the mean over winds up to U/c = 0.2, or over strong ones, under
these conditions: second order, a bound on the error of a wave in a radian, and no b below 1/5.
(AB_b damps what the wind or the Coriolis force turn by the small angle x a step by
(3/2 b - 1/4) x^4: the bound keeps a margin for fields that vary in space.)
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from swe_sphere.steppers.forward_backward import ForwardBackward

WINDS, STRONG = (0.0, 0.05, 0.1, 0.15, 0.2), (0.2, 0.25, 0.33)
"""Values of U/c over which the search averages: weak winds, strong winds."""
SHOWN = (*WINDS, *STRONG[1:])
STEPS = np.linspace(0.025, 1.85, 74)
LEAST = 0.2
BOUND = 3e-4
"""Bound on the error per radian at 0.1 radians a step, in the weakest and the strongest wind."""

Weights = tuple[tuple[float, float], tuple[float, ...]]
"""b of the winds and of the masses; weights of the new depth and the two or three before it."""


def weights(wind: float, mass: float, gamma: float) -> Weights:
    """Return the weights of second order with three depths; arguments as for `level_weights`."""
    return (wind, mass), (0.5 + gamma, 0.5 - 2.0 * gamma, gamma)


SETS: dict[str, Weights] = {
    "published: Shchepetkin & McWilliams 2005": (
        (0.281105, 0.281105),
        (0.614, 0.285, 0.088, 0.013),
    ),
    "AB3 and AM3": ((5 / 12, 5 / 12), (5 / 12, 8 / 12, -1 / 12)),
    "third order at rest: 11/60, 1/3, 3/20": weights(11 / 60, 1 / 3, 3 / 20),
    "shipped": weights(*ForwardBackward.waves),
    "shipped for strong winds": weights(*ForwardBackward.strong),
}


def step_matrix(
    chosen: Weights, c: NDArray[np.float64], u: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return the matrices of a step (..., 9, 9): three levels each of h and both wind components.

    c, u: phases k c dt of waves at rest and k U dt of the wind, in radians a step.
    """
    (wind, mass), depth = chosen
    flows, masses = (np.array([1.5 + b, -0.5 - 2.0 * b, b]) for b in (wind, mass))
    wave, drift = (1j * x[..., None] for x in np.broadcast_arrays(c, u))
    step = np.zeros((*wave.shape[:-1], 9, 9), complex)
    step[..., (1, 2, 4, 5, 7, 8), (0, 1, 3, 4, 6, 7)] = 1.0
    for row, carried in ((0, masses), (3, flows), (6, flows)):
        step[..., row, row] = 1.0
        step[..., row, row : row + 3] -= drift * carried
    step[..., 0, 3:6] -= wave * flows
    pushed = depth[0] * step[..., 0, :]
    pushed[..., : len(depth) - 1] += depth[1:]
    step[..., 3, :] -= wave * pushed
    return step


def limits(chosen: Weights, winds: tuple[float, ...]) -> NDArray[np.float64]:
    """Return for each wind the largest k (c + U) dt up to which no mode grows."""
    wind = np.array(winds)
    c = STEPS[:, None] / (1.0 + wind)
    stable = np.abs(np.linalg.eigvals(step_matrix(chosen, c, c * wind))).max(axis=-1) < 1.0 + 1e-7
    first_bad = np.argmin(np.concatenate([stable, np.zeros((1, wind.size), bool)]), axis=0)
    return np.concatenate([[0.0], STEPS])[first_bad]


def error(chosen: Weights, wind: float, radians: float = 0.1) -> float:
    """Return the larger relative error of both waves per radian; radians: of a step."""
    c = np.array(radians / (1.0 + wind))
    values = np.linalg.eigvals(step_matrix(chosen, c, c * wind))
    exact = np.exp(-1j * c * (wind + np.array([1.0, -1.0])))
    return float(np.abs(values[:, None] - exact).min(axis=0).max() / radians)


def cost(numbers: NDArray[np.float64], winds: tuple[float, ...]) -> float:
    """Return the objective that the search minimises."""
    chosen = weights(*numbers)
    worst = max(error(chosen, winds[0]), error(chosen, winds[-1]))
    return float(10.0 * max(0.0, worst / BOUND - 1.0) - limits(chosen, winds).mean())


def main(
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    strong: Annotated[bool, typer.Option("--strong", help="Search for strong winds.")] = False,
) -> None:
    """Search, and print the limits and errors of what was found beside those of other sets."""
    found = differential_evolution(
        cost, [(LEAST, 0.5), (LEAST, 0.6), (0.0, 0.3)], args=(STRONG if strong else WINDS,),
        seed=seed, popsize=12, maxiter=40, polish=False,
    ).x  # fmt: skip
    named = SETS | {f"found: {', '.join(f'{x:.4f}' for x in found)}": weights(*found)}
    typer.echo(f"limits k (c + U) dt at U/c = {SHOWN}; error in a radian of 0.1 and 0.3 a step")
    for name, chosen in named.items():
        errors = " ".join(f"{error(chosen, 0.1, part):.1e}" for part in (0.1, 0.3))
        typer.echo(f"{name:45} {limits(chosen, SHOWN).round(2)} {errors}")


if __name__ == "__main__":
    typer.run(main)
