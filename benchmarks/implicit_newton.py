"""Sections on Newton's method: forcing terms, and the initial guesses of stages."""

from __future__ import annotations

from collections.abc import Callable
from unittest.mock import patch

from sections import Section

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.planet import DAY
from swe_sphere.solvers.newton import forcing_term
from swe_sphere.steppers import dirk, get_stepper
from swe_sphere.testcases import get_scene

Forcing = Callable[[float, float, float | None], float]
RUNS = {
    "williamson5": (("bdf2", 3600.0), ("tr-bdf2", 7200.0), ("tr-bdf2", 14400.0),
                    ("tr-bdf2", 86400.0), ("sdirk3", 7200.0), ("esdirk4", 10800.0)),
    "williamson6": (("tr-bdf2", 3600.0), ("esdirk4", 3600.0)),
    "galewsky": (("bdf2", 3600.0), ("tr-bdf2", 3600.0), ("tr-bdf2", 21600.0), ("esdirk4", 3600.0)),
    "lauter": (("tr-bdf2", 1800.0), ("esdirk4", 3600.0)),
}  # fmt: skip
DAYS = 4.0
FORCING_RUNS = {
    "williamson5": (("bdf2", 3600.0), ("bdf2", 14400.0), ("tr-bdf2", 3600.0), ("tr-bdf2", 14400.0),
                    ("esdirk4", 10800.0)),
    "galewsky": (("bdf2", 3600.0), ("bdf2", 14400.0), ("tr-bdf2", 3600.0), ("tr-bdf2", 14400.0),
                 ("sdirk3", 7200.0), ("esdirk4", 3600.0)),
    "williamson6": (("tr-bdf2", 3600.0),),
}  # fmt: skip
CHOICES = ((0.1, 0.0), (1e-15, 0.0), (0.02, 0.0), (0.02, 0.5), (0.02, 0.75), (0.02, 1.0))
"""First forcing term, and fraction of the change of slope that the guesses of stages include."""


def newton() -> Section:
    """Newton and Krylov iterations a step by first forcing term and guess."""
    rows = []
    for scene, runs in RUNS.items():
        model = Model(Mesh.build(12, 4), get_scene(scene))
        for name, dt in runs:
            counts = [_counts(model, name, dt, *choice) for choice in CHOICES]
            rows.append([scene, name, f"{dt:.0f}", *counts])
            print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        f"ne12 np4, {DAYS:.0f} days: Newton / Krylov iterations a step by forcing term and guess",
        "The first number of a column is the forcing term, the factor by which each linear solve "
        "of a stage reduces its residual. No solve reduces it by more than twice what the target "
        "requires; the columns of 1e-15 show solves that go to this limit. The second is the "
        "fraction of the change of slope of the preceding stage that the guess of a stage "
        "includes (bdf2 extrapolates its states and has none). The "
        f"package uses {dirk.ESDIRK4.followed:g} for sdirk3 and esdirk4 and "
        f"{dirk.TRBDF2.followed:g} for tr-bdf2, whose iterations this fraction increased in longer "
        "runs.",
        ["scene", "stepper", "Δt [s]", *(f"{first:g}, {part:g}" for first, part in CHOICES)],
        rows,
    )


def fixed(eta: float) -> Forcing:
    """Return a constant forcing term that never asks for less than half the required residual."""
    return lambda norm, target, _: max(eta, 0.5 * target / norm)


def forcing() -> Section:
    """Newton and Krylov iterations a step by forcing terms."""
    rows = []
    for scene, runs in FORCING_RUNS.items():
        model = Model(Mesh.build(6, 4), get_scene(scene))
        for name, dt in runs:
            kinds = (fixed(0.02), forcing_term)
            counts = [_stepped(model, name, dt, kind, 1.0) for kind in kinds]
            rows.append([scene, name, f"{dt:.0f}", *counts])
            print(*rows[-1], sep=" | ", flush=True)  # noqa: T201 - a run takes a while
    return Section(
        "ne6 np4, 1 day: Newton / Krylov iterations a step by forcing terms",
        "The forcing term is fixed at 0.02, or follows the error of the linear model in the "
        "preceding step.",
        ["scene", "stepper", "Δt [s]", "0.02", "following"],
        rows,
    )


def _counts(model: Model, name: str, dt: float, first: float, followed: float) -> str:
    with patch.object(get_stepper(name), "followed", followed, create=True):
        return _stepped(model, name, dt, fixed(first), DAYS)


def _stepped(model: Model, name: str, dt: float, kind: Forcing, days: float) -> str:
    stepper = get_stepper(name)(model, dt)
    stepper.solver.newton.forcing = kind
    stepper.start(model.initial_state())
    for _ in range(round(days * DAY / dt)):
        stepper.step()
    a_step = {key: count / stepper.steps for key, count in stepper.counters.items()}
    return f"{a_step['newton_iterations']:.1f} / {a_step['krylov_iterations']:.1f}"
