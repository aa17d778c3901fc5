"""Errors of standard scenes with and without dissipation, from which the defaults follow.

    python benchmarks/dissipation_defaults.py [--write docs/reference/effects.md]

williamson2 is run at alpha = 1 for 10 days, the others against the references that come with the
package; rk4 at its automatic step.  A dash: the run stopped.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from sections import stamp, stamp_text

from swe_sphere import Simulation
from swe_sphere.equations.effects import hyperviscosity_default
from swe_sphere.io.integrals import by_name
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.testcases import get_scene

START, END = "<!-- defaults -->", "<!-- end of defaults -->"
SCENES: dict[str, tuple[str, dict[str, float], int, str]] = {
    "williamson5, day 15": ("williamson5", {}, 15, "williamson5_day15"),
    "williamson6, day 7": ("williamson6", {}, 7, "williamson6_day7"),
    "galewsky, day 6": ("galewsky", {}, 6, "galewsky_day6"),
    "galewsky, viscous, day 6": (
        "galewsky", {"viscosity.nu": 1e5}, 6, "galewsky_viscous_day6",
    ),
}  # fmt: skip
MESHES = ((5, 4), (8, 4), (16, 4), (4, 8), (8, 8))
MULTIPLES = (1.0, 3.0, 30.0)
"""Hyperviscosities, in units of the default of the mesh; 30 is the coefficient of CAM-SE."""
HEAD = ("scene", "mesh", "none", "penalty", *(f"∇⁴ × {k:g}" for k in MULTIPLES))


def errors(label: str, ne: int, np_: int, effects: dict[str, float | str]) -> str:
    """Return l2 of the free surface (williamson2: of depth) and of vorticity (of the wind)."""
    if label == "williamson2, day 10":
        sim = Simulation(
            "williamson2", ne=ne, np=np_, stepper="rk4", parameters={"alpha": 1.0}, effects=effects
        )
        if sim.run(days=10).status != "completed":
            return "–"
        return f"{sim.diagnostics['l2_h']:.2e}, {sim.diagnostics['l2_v']:.2e}"
    scene, given, days, reference = SCENES[label]
    sim = Simulation(scene, ne=ne, np=np_, stepper="rk4", effects=given | effects)
    if sim.run(days=days).status != "completed":
        return "–"
    grid = OnGrid(Reference(SHIPPED / f"{reference}.nc"), sim.mesh)
    found = by_name(grid.errors(sim.snapshot.all_fields, "surface"))
    return f"{found['l2_h']:.2e}, {found['l2_vorticity']:.2e}"


def jet(ne: int, np_: int, effects: dict[str, float | str]) -> str:
    """Return the root mean square of h - h(0) [m] of the balanced jet after a day."""
    balanced = get_scene("galewsky", perturbed=False)
    sim = Simulation(balanced, ne=ne, np=np_, stepper="rk4", effects=effects)
    start = sim.state.h.values
    sim.run(days=1)
    change = sim.state.h.values - start
    return f"{np.sqrt(np.average(change**2, weights=sim.mesh.area)):.1f} m"


def rows() -> list[list[str]]:
    """Return the rows of the table."""
    found = []
    for label in ("williamson2, day 10", *SCENES, "balanced jet, day 1"):
        for ne, np_ in MESHES:
            default = hyperviscosity_default(ne, np_)
            strengths: list[dict[str, float | str]] = [{}, {"edge-penalty.c": "default"}]
            strengths += [{"hyperviscosity.nu": k * default} for k in MULTIPLES]
            cells = [
                jet(ne, np_, each) if "jet" in label else errors(label, ne, np_, each)
                for each in strengths
            ]
            found.append([label, f"ne{ne} np{np_}", *cells])
    return found


def main(
    write: Annotated[Path | None, typer.Option(help="Also replace the table of this page.")] = None,
) -> None:
    """Measure and print the table."""
    lines, table = rows(), Table(*HEAD)
    for line in lines:
        table.add_row(*line)
    Console(width=140).print(table)
    if write:
        text = write.read_text()
        before, after = text.split(START)[0], text.split(END)[1]
        both = [HEAD, tuple("---" for _ in HEAD), *lines]
        body = "\n".join("| " + " | ".join(line) + " |" for line in both)
        write.write_text(f"{before}{START}\n{body}\n\n{stamp_text(stamp())}\n{END}{after}")


if __name__ == "__main__":
    typer.run(main)
