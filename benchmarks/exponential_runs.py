"""Sections on exponential steppers: what accuracy costs, and how long their steps may be."""

import numpy as np
from implicit_common import DAYS, Run, run
from implicit_runs import SHIPPED
from sections import Section

from swe_sphere.errors import RunFailed
from swe_sphere.io.integrals import norms
from swe_sphere.io.reference_solution import OnGrid, Reference
from swe_sphere.mesh import Mesh
from swe_sphere.operators.diagnose import vorticity
from swe_sphere.planet import DAY
from swe_sphere.simulation.simulation import Simulation

ROUNDS = 2
STEPS = {
    "epi2": (3600.0, 10800.0),
    "epi3": (10800.0,),
    "epi4": (3600.0, 10800.0, 14400.0),
    "epi5": (10800.0,),
}
COURANT = (0.25, 0.5, 1.0, 2.0)


def exponential() -> Section:
    """Errors and cost of exponential steppers over 15 days of williamson5."""
    mesh = Mesh.build(16, 4)
    begun = Simulation("williamson5", mesh=mesh, stepper="rk4")
    begun.begin()
    asked = [("rk4", begun.plan.dt)] + [(name, dt) for name, steps in STEPS.items() for dt in steps]
    found: dict[tuple[str, float], list[Run]] = {key: [] for key in asked}
    for _ in range(ROUNDS):
        for (name, dt), runs in found.items():
            runs.append(run("williamson5", mesh, name, dt, DAYS))
    rk4 = np.array([one.sim.cpu_seconds for one in found[asked[0]]])
    rows = [_outcome(name, dt, runs, rk4) for (name, dt), runs in found.items()]
    return Section(
        "Exponential steppers, williamson5, 15 days, ne16 np4: what accuracy costs",
        "rk4 runs at 0.85 of its limit. Right-hand-side equivalents are CPU time over that of one "
        f"right-hand side. CPU / rk4 is the least, and the median, of {ROUNDS} interleaved runs.",
        ["stepper", "Δt [s]", "l2", "l2 vorticity", "right-hand sides", "tangent products",
         "Krylov vectors a step", "right-hand-side equivalents", "CPU [s]", "CPU / rk4"],
        rows,
    )  # fmt: skip


def _outcome(name: str, dt: float, runs: list[Run], rk4: np.ndarray) -> list[str]:
    sim = runs[0].sim
    fields, file = sim.snapshot.all_fields, SHIPPED / "williamson5_day15.nc"
    depth, vorticity = (
        OnGrid(Reference(file), sim.mesh).errors(fields, "surface")[field]["l2"]
        for field in ("h", "vorticity")
    )
    seconds = np.array([one.sim.cpu_seconds for one in runs])
    equivalents = min(one.sim.cpu_seconds / one.rhs_seconds for one in runs)
    counts, krylov = sim.model.counters, sim.stepper.counters.get("krylov_iterations", 0)
    return [
        name, f"{dt:.0f}", f"{depth:.2e}", f"{vorticity:.2e}", str(counts["rhs_evaluations"]),
        str(counts["tangent_evaluations"]), f"{krylov / sim.steps:.1f}", f"{equivalents:.0f}",
        f"{seconds.min():.1f}", f"{seconds.min() / rk4.min():.2f} ({np.median(seconds / rk4):.2f})",
    ]  # fmt: skip


def exponential_steps() -> Section:
    """Errors of exponential steppers by the Courant number, up to the loss of stability."""
    rows = []
    for scene, ne, days in (("williamson6", 12, 10.0), ("galewsky", 16, 6.0)):
        mesh = Mesh.build(ne, 4)
        begun = Simulation(scene, mesh=mesh, stepper="rk4")
        begun.begin()
        fields = begun.initial_fields
        one = mesh.spacing()[0] / float(np.hypot(fields["u"], fields["v"]).max())
        exact = _vorticity(run(scene, mesh, "rk4", 0.5 * begun.plan.dt, days))
        for name in STEPS:
            errors = [_error(scene, mesh, name, one * c, days, exact) for c in COURANT]
            rows.append([f"{scene}, ne{ne} np4, day {days:g}", name, *errors])
    return Section(
        "Exponential steppers: error in time of the vorticity, by the advective Courant number",
        "The Courant number is that of the fastest initial wind and the finest spacing. Errors "
        "are l2 of the difference from rk4 with half its step on the same mesh, whose smallest "
        "motions are not resolved.",
        ["scene", "stepper", *(f"{c:g}" for c in COURANT)],
        rows,
    )


def _error(scene: str, mesh: Mesh, name: str, dt: float, days: float, exact: np.ndarray) -> str:
    dt = days * DAY / np.ceil(days * DAY / dt)
    try:
        found = _vorticity(run(scene, mesh, name, dt, days))
        return f"{norms(mesh.area, found, exact)['l2']:.1e}"
    except RunFailed:
        return "failed"


def _vorticity(made: Run) -> np.ndarray:
    fields = made.sim.snapshot.fields
    return vorticity(made.sim.mesh, fields["u"], fields["v"])
