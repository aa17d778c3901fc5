"""Error in time at every step size, beside that of exact solves; writes docs/results/step_sizes.md.

    python benchmarks/step_sizes.py                     all steppers, all scenes: about half an hour
    python benchmarks/step_sizes.py --steppers bdf2,ark2 --scenes lauter

Runs that were made before are kept in
benchmarks/results/step_sizes.json; delete it to make all again.
"""

from __future__ import annotations

import json
from typing import Annotated, Any

import numpy as np
import typer
import warp as wp
from rich.console import Console
from sections import DATA, PAGES

from swe_sphere.files.fingerprints import machine
from swe_sphere.io.integrals import by_name, field_errors
from swe_sphere.mesh import Mesh
from swe_sphere.simulation.simulation import Simulation
from swe_sphere.steppers import STEPPERS

STORE = DATA / "step_sizes.json"
SCENES = {"lauter": "l2_h", "williamson6": "l2_h", "matsuno": "l2_v"}
"""And the error that is shown: matsuno's depths are waves of a billionth of the mean depth."""
STEPS = (3600.0, 1800.0, 900.0, 450.0, 240.0, 120.0, 60.0)
NE, NP, HOURS = 4, 6, 6.0
REFERENCE = 30.0
EXACT = 1e-10

HEAD = f"""# Steps of any size

With default tolerances the errors of implicit, semi-implicit and exponential steps are at most 1.13
times those of exact solves, from Δt = 3600 s down to 60 s: [the solver
tolerance](../explanation/time_integration.md#solver-tolerance-of-implicit-steppers)
follows the truncation error.

Made by `python benchmarks/step_sizes.py`: {HOURS:g} h on ne{NE} np{NP}, float64. Each cell gives
the time error (relative to rk4 with Δt = {REFERENCE:g} s on the same mesh) with default tolerances.
In brackets are its ratio to the error of exact solves (tolerance {EXACT:g}) and the Krylov
iterations a step. Where exact solves reach the round-off of the state (errors below about 1e-13, or
1e-7 in matsuno, whose waves are that small relative to the state), the ratio has no meaning. Long
steps do not resolve the gravity waves at the beginning of williamson6, so that exact solves do not
show the order of the schemes there either.

"""


def main(
    steppers: Annotated[str, typer.Option(help="Names with commas between; all by default.")] = "",
    scenes: Annotated[str, typer.Option(help="Names with commas between.")] = ",".join(SCENES),
) -> None:
    """Make the runs that are missing, print and write the tables."""
    wp.config.log_level = wp.LOG_WARNING
    implicit = [name for name, kind in STEPPERS.items() if kind.family != "explicit"]
    known: dict[str, Any] = json.loads(STORE.read_text()) if STORE.exists() else {}
    for scene in scenes.split(","):
        reference = None
        for stepper in steppers.split(",") if steppers else implicit:
            for dt in STEPS:
                key = f"{scene} {stepper} {dt:g}"
                if key in known:
                    continue
                if reference is None:
                    reference = run(scene, "rk4", REFERENCE)[0]
                known[key] = compare(scene, stepper, dt, reference)
                STORE.write_text(json.dumps(known, indent=1) + "\n")
                Console().print(key, cell(known[key]))
    page = [HEAD, *(table(scene, known) for scene in SCENES), f"{machine()}.", ""]
    (PAGES / "step_sizes.md").write_text("\n".join(page))


def run(scene: str, stepper: str, dt: float, **options: Any) -> tuple[dict[str, np.ndarray], float]:
    """The fields at the end, and Krylov iterations a step."""
    sim = Simulation(scene, ne=NE, np=NP, stepper=stepper, dt=dt, options=options)
    summary = sim.run(days=HOURS / 24.0, progress=False)
    return sim.snapshot.fields, summary["krylov_iterations"] / summary["steps"]


def compare(
    scene: str, stepper: str, dt: float, reference: dict[str, np.ndarray]
) -> dict[str, float]:
    """Errors with the default tolerance and with exact solves, and iterations with the former."""
    mesh, measure = Mesh.build(NE, NP), SCENES[scene]
    usual, krylov = run(scene, stepper, dt)
    exact, _ = run(scene, stepper, dt, tolerance=EXACT)
    return {
        "error": by_name(field_errors(mesh.area, usual, reference))[measure],
        "exact": by_name(field_errors(mesh.area, exact, reference))[measure],
        "krylov": krylov,
    }


def table(scene: str, known: dict[str, dict[str, float]]) -> str:
    """A table of a scene, a row a stepper."""
    lines = [f"## {scene}, {SCENES[scene].replace('_', '(')})", ""]
    lines.append("| stepper | " + " | ".join(f"{dt:g} s" for dt in STEPS) + " |")
    lines.append("|---" * (len(STEPS) + 1) + "|")
    for stepper in STEPPERS:
        found = [known.get(f"{scene} {stepper} {dt:g}") for dt in STEPS]
        if any(found):
            lines.append(f"| `{stepper}` | " + " | ".join(cell(one) for one in found) + " |")
    return "\n".join(lines) + "\n"


def cell(found: dict[str, float] | None) -> str:
    """Error, its ratio to that of exact solves, iterations."""
    if found is None:
        return ""
    ratio = found["error"] / found["exact"]
    return f"{found['error']:.1e} ({ratio:.2f}; {found['krylov']:.1f})"


if __name__ == "__main__":
    typer.run(main)
