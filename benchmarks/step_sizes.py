"""Error in time at every step size, with the default tolerance and with exact solves.

python benchmarks/step_sizes.py [SCENE ...]       all by default: about half an hour
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import typer
from sections import Section, command

from swe_sphere.io.integrals import by_name, field_errors
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import STEPPERS

SCENES = {"lauter": "l2_h", "williamson6": "l2_h", "matsuno": "l2_v"}
"""Scenes, and the error that is shown; waves of matsuno are a billionth of the mean depth."""
STEPS = (3600.0, 1800.0, 900.0, 450.0, 240.0, 120.0, 60.0)
NE, NP, HOURS = 4, 6, 6.0
REFERENCE = 30.0
EXACT = 1e-10


def errors(scene: str) -> Section:
    """Return the errors of every stepper with a solver for a scene."""
    names = [name for name, kind in STEPPERS.items() if kind.family != "explicit"]
    reference = run(scene, "rk4", REFERENCE)[0]
    rows = [
        [f"`{name}`", *(cell(compare(scene, name, dt, reference)) for dt in STEPS)]
        for name in names
    ]
    return Section(
        f"{scene}, {SCENES[scene].replace('_', '(')})", "",
        ["stepper", *(f"{dt:g} s" for dt in STEPS)], rows,
    )  # fmt: skip


def run(scene: str, stepper: str, dt: float, **options: Any) -> tuple[dict[str, np.ndarray], float]:
    """Return the final fields, and Krylov iterations per step."""
    sim = Simulation(scene, ne=NE, np=NP, stepper=stepper, dt=dt, options=options)
    summary = sim.run(days=HOURS / 24.0, progress=False)
    return sim.snapshot.fields, summary["krylov_iterations"] / summary["steps"]


def compare(
    scene: str, stepper: str, dt: float, reference: dict[str, np.ndarray]
) -> dict[str, float]:
    """Return errors with default tolerance and with exact solves, and iterations."""
    mesh, measure = Mesh.build(NE, NP), SCENES[scene]
    usual, krylov = run(scene, stepper, dt)
    exact, _ = run(scene, stepper, dt, tolerance=EXACT)
    return {
        "error": by_name(field_errors(mesh.area, usual, reference))[measure],
        "exact": by_name(field_errors(mesh.area, exact, reference))[measure],
        "krylov": krylov,
    }


def cell(found: dict[str, float]) -> str:
    """Return as text: error, its ratio to that of exact solves, iterations."""
    ratio = found["error"] / found["exact"]
    return f"{found['error']:.1e} ({ratio:.2f}; {found['krylov']:.1f})"


main = command("step_sizes", {scene: partial(errors, scene) for scene in SCENES})

if __name__ == "__main__":
    typer.run(main)
