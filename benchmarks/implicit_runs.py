"""Sections on whole runs with implicit steppers: time to solution, and drift of the energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from implicit_common import DAYS, MOUNTAIN, Run, run
from sections import PAGES, Section

from swe_sphere.equations.model import Model
from swe_sphere.equations.spectrum import SpectralRadii
from swe_sphere.errors import RunFailed
from swe_sphere.io.integrals import norms
from swe_sphere.io.reference_solution import SHIPPED, OnGrid, Reference
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.sphere import position
from swe_sphere.planet import DAY
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

DRIFT_STEPS = (1800.0, 3600.0, 7200.0)
SCHEMES = (
    "implicit-midpoint", "gauss-legendre", "average-vector-field", "crank-nicolson", "bdf2",
    "tr-bdf2", "sdirk3", "esdirk4", "implicit-euler",
)  # fmt: skip


def race() -> Section:
    """Errors and time of 15 days of williamson5 on a uniform and on a stretched mesh."""
    uniform = [("semi-implicit", 1575.0), ("ars343", 3600.0)]
    uniform += [("bdf2", 3600.0), ("bdf2", 5400.0), ("bdf2", 7200.0), ("bdf2", 14400.0)]
    uniform += [("tr-bdf2", 7200.0), ("tr-bdf2", 14400.0), ("tr-bdf2", 21600.0)]
    refined = [("semi-implicit", 547.0), ("bdf2", 1800.0), ("bdf2", 2700.0), ("bdf2", 3600.0)]
    refined += [("tr-bdf2", 3600.0), ("tr-bdf2", 7200.0)]
    rows = _race_on("ne16 np4", Mesh.build(16, 4), uniform)
    stretched = Mesh.build(16, 4, stretch=4.0, centre=MOUNTAIN)
    rows += _race_on("ne16 np4, stretched 4", stretched, refined)
    return Section(
        "williamson5, 15 days: what accuracy costs in time",
        "The run with the least CPU time of three, made in turns. Explicit steppers run at 0.85 of "
        "their stability limit, `semi-implicit` at its automatic steps. The gravity limit is that "
        "of leapfrog without filter, 1/ρ. The column \"near the mountain\" covers 30° around it. "
        "Right-hand-side equivalents are CPU time over that of one right-hand side, measured "
        "before and after the run.",
        ["mesh", "stepper", "Δt [s]", "Δt / gravity limit", "l2", "l2 near the mountain",
         "l2 vorticity", "Newton / Krylov a step", "wall [s]", "CPU [s]", "CPU / rk4",
         "right-hand-side equivalents"],
        rows,
    )  # fmt: skip


def _race_on(label: str, mesh: Mesh, implicit: list[tuple[str, float]]) -> list[list[str]]:
    model = Model(mesh, get_scene("williamson5"))
    radii = SpectralRadii(model.spectral_radii(model.initial_state()).wave)
    explicit = [(name, 0.85 * get_stepper(name).stable_dt(radii)) for name in ("rk4", "leapfrog")]
    cases = [(name, DAYS * DAY / np.ceil(DAYS * DAY / dt)) for name, dt in explicit + implicit]
    rounds = [[_attempt(mesh, name, dt) for name, dt in cases] for _ in range(ROUNDS)]
    rows, rk4 = [], 0.0
    for (name, dt), *results in zip(cases, *rounds, strict=True):
        head = [label, name, f"{dt:.0f}", f"{dt * radii.wave:.1f}"]
        done = [each for each in results if isinstance(each, Run)]
        if not done:
            rows.append([*head, f"{results[0]} failed", *[""] * 8])
            continue
        result = min(done, key=lambda each: each.sim.cpu_seconds)
        rk4 = rk4 or result.sim.cpu_seconds
        rows.append([*head, *_outcome(result, rk4)])
    return rows


ROUNDS = 3
"""Number of runs of each case; the least CPU time counts."""


def _attempt(mesh: Mesh, name: str, dt: float) -> Run | str:
    """Return a run of williamson5, or why it failed."""
    try:
        return run("williamson5", mesh, name, dt, DAYS)
    except RunFailed as failure:
        return str(failure).split(":")[0]


def _outcome(result: Run, rk4: float) -> list[str]:
    """Return cells with errors and cost of a run of williamson5; rk4: CPU time of rk4 [s]."""
    sim, file = result.sim, SHIPPED / "williamson5_day15.nc"
    fields = sim.snapshot.all_fields
    depth, vorticity = (
        OnGrid(Reference(file), sim.mesh).errors(fields, "surface")[field]["l2"]
        for field in ("h", "vorticity")
    )
    return [
        f"{depth:.2e}", f"{_near(sim.mesh, fields):.2e}", f"{vorticity:.2e}", result.counts,
        f"{sim.wall_seconds:.1f}", f"{sim.cpu_seconds:.1f}",
        f"{sim.cpu_seconds / rk4:.2f}", f"{sim.cpu_seconds / result.rhs_seconds:.0f}",
    ]  # fmt: skip


def drift() -> Section:
    """Relative change of energy of each scheme by time step."""
    mesh = Mesh.build(8, 4)
    runs = {
        name: [run("williamson5", mesh, name, dt, DAYS, tolerance=1e-6) for dt in DRIFT_STEPS]
        for name in SCHEMES
    }
    drifts = {name: results[1].energy_drift for name, results in runs.items()}
    drift_figure(drifts, PAGES / "energy_drift.svg")
    return Section(
        "williamson5, ne8 np4, 15 days: relative change of energy by Δt",
        "Solver tolerance 1e-6. Schemes without damping conserve energy to the solver tolerance or "
        "to their order; the others dissipate the gravity waves of the initial state. The figure "
        f"shows the runs at {DRIFT_STEPS[1]:.0f} s by day.",
        ["stepper", *(f"{dt:.0f} s" for dt in DRIFT_STEPS)],
        [[name, *(f"{r.energy_drift[-1]:+.1e}" for r in made)] for name, made in runs.items()],
    )


def drift_figure(drifts: dict[str, list[float]], out: Path) -> None:
    """Draw the relative change of energy by day, one line per scheme, into `out`."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["svg.hashsalt"] = "swe_sphere"
    figure = Figure(figsize=(8.0, 4.8), layout="constrained")
    axes = figure.subplots()
    for (name, values), marker in zip(drifts.items(), "ov^<>sDPX", strict=True):
        days = np.arange(1, len(values) + 1)
        axes.semilogy(days, np.abs(values), marker=marker, markersize=4, label=name)
    axes.set(xlabel="day", ylabel="|E(t) - E(0)| / E(0)", title="williamson5, ne8 np4, Δt = 1 h")
    axes.grid(visible=True, alpha=0.3)
    figure.legend(loc="outside right center", frameon=False)
    figure.savefig(out, metadata={"Date": None})


def _near(mesh: Mesh, fields: dict[str, np.ndarray]) -> float:
    """Return the l2 error of the surface height within 30 degrees of the mountain."""
    reference = Reference(SHIPPED / "williamson5_day15.nc")
    centre = position(*np.radians(MOUNTAIN))
    area = mesh.area * (mesh.xyz @ centre > np.cos(np.radians(30.0)))
    exact = reference.at("surface", mesh.lon, mesh.lat)
    return norms(area, fields["h"] + fields["b"], exact)["l2"]
