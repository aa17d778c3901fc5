"""Error against solver tolerance for the implicit steppers on `lauter`; prints a table.

python benchmarks/tolerance.py
"""

from __future__ import annotations

import warp as wp
from rich.console import Console
from rich.table import Table

from swe_sphere.mesh import build_mesh
from swe_sphere.model import Model
from swe_sphere.output.norms import errors
from swe_sphere.planet import DAY
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

STEPPERS = ("bdf2", "tr-bdf2", "sdirk3", "rosenbrock-w", "esdirk4", "gauss-legendre")
TOLERANCES = (1e-2, 1e-3, 1e-4)
DT, DAYS = 3600.0, 1.0


def main() -> None:
    """Run all and print l2(h) and Krylov iterations a step."""
    wp.config.log_level = wp.LOG_WARNING
    scene, mesh = get_scene("lauter"), build_mesh(8, 4)
    exact = dict(zip("uvh", scene.exact(mesh.lon, mesh.lat, DAYS * DAY), strict=True))
    title = f"lauter, ne8 np4, Δt = {DT:.0f} s, {DAYS:g} day: l2(h), Krylov iterations a step"
    table = Table("stepper", *(f"{tolerance:.0e}" for tolerance in TOLERANCES), title=title)
    for name in STEPPERS:
        cells = []
        for tolerance in TOLERANCES:
            stepper = get_stepper(name)(Model(mesh, scene), DT, tolerance=tolerance)
            stepper.start(stepper.model.initial_state())
            for _ in range(round(DAYS * DAY / DT)):
                stepper.step()
            fields = stepper.model.fields(stepper.state)
            krylov = stepper.counters["krylov_iterations"] / stepper.steps
            cells.append(f"{errors(mesh, fields, exact)['l2_h']:.1e}, {krylov:.1f}")
        table.add_row(name, *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
