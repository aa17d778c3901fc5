"""The constants of the methods that advice knows, by least squares from the runs of a map."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.studies.advice.method import Method, Setting, error_terms, price_terms

SANE = 0.3
"""A run with a larger error has blown up or is about to."""
FLOOR = 1e-6
"""Errors below say more on the converged run than on the step."""
FIXED, HOLD, WEAK = 1e3, 0.3, 0.03
"""How much exponents are held to what is expected of them, in runs."""


class Observation(NamedTuple):
    """A run that was made: its step [s], its cost [right-hand sides], its slow-flow error."""

    setting: Setting
    dt: float
    cost: float
    error: float


def fitted(
    stepper: str, order: int, explicit: bool, runs: Sequence[Observation],
    failures: Iterable[tuple[float, float]] = (),
) -> Method:  # fmt: skip
    """The method with constants by least squares in the logarithms.

    Exponents that few runs tell of are held to what is expected: the order of the scheme for p,
    0 for the others.  explicit: a step costs the same whatever the Courant numbers.
    failures: (G, A) of runs that failed.
    """
    sane = [run for run in runs if run.error < SANE]
    terms = np.array([price_terms(run.setting, run.dt) for run in sane])
    costs = np.log([run.cost * run.dt / run.setting.seconds for run in sane])
    courant = FIXED if explicit else HOLD
    price = _least_squares(terms, costs, [0.0] * 4, [0.0, courant, courant, HOLD])
    told = [run for run in sane if run.error > FLOOR] or sane
    laws = np.array([error_terms(run.setting, run.dt) for run in told])
    errors = np.log([run.error / (run.setting.change * run.setting.seconds) for run in told])
    accuracy = _least_squares(laws, errors, [0.0, order, 0.0, 0.0], [0.0, HOLD, WEAK, WEAK])
    scatter = float(np.sqrt(np.mean((laws @ accuracy - errors) ** 2)))
    reach = max(run.dt / run.setting.advective_limit for run in sane), max(run.dt for run in sane)
    return Method(stepper, _rounded(price), _rounded(accuracy), round(math.exp(scatter), 3),
                  _rounded(reach), _lowest(failures), len(sane))  # fmt: skip


def _lowest(pairs: Iterable[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Those than which no other is lower in both."""
    kept: list[tuple[float, float]] = []
    for g, a in sorted(pairs):
        if all(a < known for _, known in kept):
            kept.append((round(g, 3), round(a, 4)))
    return tuple(kept)


def _rounded(values: Iterable[float]) -> Any:
    return tuple(round(float(x), 4) for x in values)


def _least_squares(
    terms: Array, values: Array, expected: Sequence[float], held: Sequence[float]
) -> Array:
    """Coefficients, each held to what is expected by so many runs' weight."""
    matrix = np.vstack([terms, np.diag(np.sqrt(held))])
    right = np.concatenate([values, np.sqrt(held) * expected])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def as_text(methods: Sequence[Method]) -> str:
    """Methods as they are kept."""
    lines = ",\n".join(json.dumps(asdict(method)) for method in methods)
    return f"[\n{lines}\n]\n"
