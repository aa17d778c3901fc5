"""What a step of a method costs and errs by: power laws whose constants are fitted to sweeps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.studies.advice.setting import Setting

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


@dataclass(frozen=True)
class Method:
    """A stepper, with the constants of

        cost of a step = k (1 + G)^a (1 + A)^b (1 + D)^d    [right-hand sides]
        slow-flow error = C (change T) (turning Δt)^p (U/c)^s (1 + D)^r

    G, A: the step over the gravity and the advective limit (which Krylov counts go with); D: times
    the spectral radius of the dissipation; T: length of the run.
    """

    stepper: str
    price: tuple[float, float, float, float]
    """log k, a, b, d."""
    accuracy: tuple[float, float, float, float]
    """log C, p, s, r."""
    doubt: float
    """Factor by which errors scatter about the law, one standard deviation."""
    reach: tuple[float, float]
    """The largest advective Courant number A and the longest step [s] at which it was seen to
    work; what has a stability limit is not held to them."""
    failures: tuple[tuple[float, float], ...]
    """(G, A) of runs that blew up or could not be solved, the lowest ones."""
    runs: int = field(compare=False)
    """That the constants were fitted to."""

    def works(self, setting: Setting, dt: float) -> bool:
        """Whether no run failed whose step was no longer in either limit."""
        here = dt / setting.gravity_limit, dt / setting.advective_limit
        return not any(g <= here[0] and a <= here[1] for g, a in self.failures)

    def step_cost(self, setting: Setting, dt: float) -> float:
        """Cost of a step of dt [s] in right-hand sides."""
        return math.exp(float(np.dot(self.price, _price_terms(setting, dt))))

    def error(self, setting: Setting, dt: float) -> float:
        """Slow-flow error at the end of a run with steps of dt [s]."""
        if not setting.turning:
            return 0.0
        laws = np.dot(self.accuracy, _error_terms(setting, dt))
        return setting.change * setting.seconds * math.exp(float(laws))


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
    terms = np.array([_price_terms(run.setting, run.dt) for run in sane])
    costs = np.log([run.cost * run.dt / run.setting.seconds for run in sane])
    courant = FIXED if explicit else HOLD
    price = _least_squares(terms, costs, [0.0] * 4, [0.0, courant, courant, HOLD])
    told = [run for run in sane if run.error > FLOOR] or sane
    laws = np.array([_error_terms(run.setting, run.dt) for run in told])
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


def _price_terms(setting: Setting, dt: float) -> list[float]:
    rates = 1.0 / setting.gravity_limit, 1.0 / setting.advective_limit, setting.dissipation
    return [1.0, *(math.log1p(dt * rate) for rate in rates)]


def _error_terms(setting: Setting, dt: float) -> list[float]:
    factors = dt * setting.turning, setting.froude, 1.0 + dt * setting.dissipation
    return [1.0, *map(math.log, factors)]


def _least_squares(
    terms: Array, values: Array, expected: Sequence[float], held: Sequence[float]
) -> Array:
    """Coefficients, each held to what is expected by so many runs' weight."""
    matrix = np.vstack([terms, np.diag(np.sqrt(held))])
    right = np.concatenate([values, np.sqrt(held) * expected])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])
