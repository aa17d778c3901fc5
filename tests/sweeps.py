"""Datasets as sweeps make them, without running anything; and what is the same in two of them."""

from __future__ import annotations

import numpy as np
import xarray as xr

KINDS, FIELDS, NORMS = ("time", "total", "slow"), ("h", "v", "vorticity"), ("l1", "l2", "linf")
WORDS = (
    "scene", "stepper", "preconditioner", "precision", "device", "settings", "role", "status",
    "reason",
)  # fmt: skip
DEFAULTS = {
    "scene": "williamson5", "stepper": "rk4", "preconditioner": "", "precision": "float64",
    "device": "cpu", "settings": "", "role": "grid", "status": "completed", "reason": "",
    "ne": 16, "np": 4, "stretch": 1.0, "dt": 600.0, "steps": 2160, "days": 15.0,
    "days_planned": 15.0, "jobs": 1,
    "rhs_evaluations": 8640, "tangent_evaluations": 0, "preconditioner_applications": 0,
    "newton_iterations": 0, "krylov_iterations": 0, "rejected_steps": 0, "wall_seconds": 3.0,
    "cpu_seconds": 3.0, "spread": 0.02,
    "compile_seconds": 1.5, "setup_seconds": 0.2, "total_seconds": 5.0,
    "stable_dt": np.inf, "gravity_limit": 248.0, "advective_limit": 3100.0,
    "mass_drift": 1e-15, "energy_drift": -1e-7, "enstrophy_drift": 1e-5,
}  # fmt: skip


def make_sweep(*runs: dict, days: tuple[float, ...] = (15.0,), **attributes) -> xr.Dataset:
    """A dataset with these runs: what is not given is as in DEFAULTS.

    A run may give errors as {(kind, field): l2 at the last day} under "errors".
    """
    rows = [DEFAULTS | run for run in runs]
    error = np.full((len(rows), len(KINDS), len(FIELDS), len(NORMS), len(days)), np.nan)
    for i, row in enumerate(rows):
        for (kind, field), value in row.get("errors", {}).items():
            place = i, KINDS.index(kind), FIELDS.index(field)
            error[place] = value * np.array([0.7, 1.0, 8.0])[:, None] * np.ones(len(days))
    variables = {name: ("run", _column(name, rows)) for name in DEFAULTS}
    variables |= {"error": (("run", "kind", "field", "norm", "report_day"), error)}
    for clock in ("wall", "cpu"):
        times = np.array([[row[f"{clock}_seconds"]] for row in rows]).reshape(-1, 1)
        variables[clock] = (("run", "repeat"), times)
    coordinates = {"kind": list(KINDS), "field": list(FIELDS), "norm": list(NORMS),
                   "report_day": list(days)}  # fmt: skip
    return xr.Dataset(variables, coordinates, {"scene": "williamson5"} | attributes)


def _column(name: str, rows: list[dict]) -> np.ndarray:
    return np.array([row[name] for row in rows], dtype=object if name in WORDS else float)


STEPPERS = {
    "rk4": (4, 4, 1.0, 0.0, 0.05), "leapfrog": (1, 1, 1.0, 0.0, 1.2),
    "semi-implicit": (1, 5, 0.0, 1.9, 0.8), "ars343": (3, 20, 0.0, 6.9, 0.3),
    "bdf2": (2, 9, 0.0, 4.5, 0.4), "tr-bdf2": (2, 17, 0.0, 8.2, 0.15),
    "esdirk4": (4, 40, 0.0, 15.0, 0.02),
}  # fmt: skip
"""Order, right-hand sides a step, explicit or not, Krylov a step at 1 h, error at 1 h."""
LIMIT = {"rk4": 2.6, "leapfrog": 0.8, "semi-implicit": 9.0}


def plausible_sweep(scene: str = "williamson5", meshes=((16, 4),), seed: int = 1) -> xr.Dataset:
    """A dataset as a sweep of seven steppers could make it, failures included."""
    rng = np.random.default_rng(seed)
    runs = []
    for ne, np_ in meshes:
        gravity = 248.0 * (16 * 3 / (ne * (np_ - 1))) * (1.0 if np_ == 4 else 0.8)
        for stepper in STEPPERS:
            steps = (0.2, 0.4, 0.8) if STEPPERS[stepper][2] else ()
            steps += (1.6, 2.4, 3.2) if stepper == "rk4" else ()
            steps += () if STEPPERS[stepper][2] else (3.0, 7.25, 14.5, 29.0, 58.0)
            runs += [_run(scene, stepper, ne, np_, gravity, gravity * step, rng) for step in steps]
    runs += [
        {**runs[0], "scene": scene, "stepper": "leapfrog", "dt": 1.0, "status": "timed-out",
         "role": "grid", "errors": {}, "reason": "stopped after 60 s of wall time at day 0.4",
         "cpu_seconds": np.nan},
        {**runs[0], "scene": scene, "stepper": "bdf2", "dt": 86400.0, "status": "solver-failed",
         "errors": {}, "reason": "Newton's method did not converge at t = 86400 s | 30 iterations"},
        {**runs[0], "scene": scene, "stepper": "rk4", "dt": 20.0, "role": "converged",
         "errors": {("time", "h"): 2.4e-7}},
        {**runs[0], "scene": scene, "stepper": "ars343", "dt": 1e6, "status": "refused",
         "errors": {}, "reason": "a step of 1e6 s is longer than the run", "cpu_seconds": np.nan},
    ]  # fmt: skip
    return make_sweep(
        *runs, title=f"{scene}: what accuracy costs", scene=scene, machine="a machine, 2 cores",
        cores=2, versions='{"python": "3.11.7", "warp": "1.19.0"}',
        created="2026-11-21T10:00:00",
        converged_dt=20.0, converged_check=2.4e-7, plan='{"ne": [16], "dt": "auto"}',
    )  # fmt: skip


def _run(scene, stepper, ne, np_, gravity, dt, rng) -> dict:
    order, work, explicit, krylov, size = STEPPERS[stepper]
    steps = round(15 * 86400 / dt)
    krylov *= np.sqrt(dt / 3600.0)
    rhs = 3.3e-4 * (ne * np_ / 64) ** 2
    cost = steps * (work if explicit else work + krylov * 3.5)
    wall = cost * rhs * rng.uniform(0.97, 1.03)
    fine = 1e-4 * (48 / (ne * (np_ - 1))) ** 3
    time = min(size * 2e-2 * (dt / 3600.0) ** order, 7.5e-4 * rng.uniform(0.95, 1.3))
    vorticity = 0.08 * size * (dt / 7200.0) ** order + 1e-5
    limit = LIMIT.get(stepper, np.inf) * gravity
    stable = dt <= limit
    first, second, _ = sorted(rng.uniform(0.98, 1.04, 3))
    return {
        "scene": scene, "stepper": stepper, "ne": ne, "np": np_, "dt": dt, "steps": steps,
        "preconditioner": "" if explicit else "helmholtz", "rhs_evaluations": steps * work,
        "krylov_iterations": round(krylov * steps),
        "newton_iterations": 0 if explicit or "semi" in stepper else round(1.7 * steps),
        "wall_seconds": 1.1 * wall, "cpu_seconds": wall if stable else wall * 0.1,
        "spread": second / first - 1.0, "stable_dt": limit, "gravity_limit": gravity,
        "advective_limit": gravity * 12.5,
        "status": "completed" if stable else "unstable",
        "reason": "" if stable else f"wind of {rng.uniform(1e3, 9e3):.0f} m/s at day 1.3",
        "energy_drift": -1e-6 * (dt / 3600.0) ** 0.6, "mass_drift": rng.uniform(-3e-15, 3e-15),
        "enstrophy_drift": 1e-5 * (dt / 3600.0), "role": "grid",
        "errors": {
            ("time", "h"): time, ("time", "v"): 12 * time, ("time", "vorticity"): 20 * time,
            ("total", "h"): np.hypot(fine, time), ("total", "v"): 12 * np.hypot(fine, time),
            ("total", "vorticity"): np.hypot(0.08, vorticity), ("slow", "vorticity"): vorticity,
        } if stable else {},
    }  # fmt: skip


TIMES = {
    "wall", "cpu", "wall_seconds", "cpu_seconds", "spread", "compile_seconds", "total_seconds",
    "setup_seconds",
}  # fmt: skip
"""What differs between two runs of the same settings."""


def assert_same_rows(one, other):
    """Equal but for what depends on the machine."""
    keep = [name for name in one.data_vars if name not in TIMES]
    xr.testing.assert_identical(one[keep].drop_attrs(), other[keep].drop_attrs())
