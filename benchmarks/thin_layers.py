"""Semi-implicit steps where the wind is faster than the gravity waves (docs/results/steps.md).

    python benchmarks/thin_layers.py [--days 30]

The script prints the amplification of one wave per step in a constant wind, and the error of the
wind in the thin layers of the stability tests at automatic steps, with the edge penalty.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from swe_sphere import Simulation
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.leapfrog import Leapfrog
from swe_sphere.steppers.stability import tableau
from swe_sphere.studies.cases.scenes import thin_flow

STEPPERS_SHOWN = ("semi-implicit", "ark2", "ars343")
FROUDE = (0.25, 0.36, 0.4, 0.5, 0.71, 1.23, 1.6, 2.5, 3.9, 12.3)
"""Wind over wave speed; 1.23, 3.9 and 12.3 are those of layers of 100, 10 and 1 m, and
0.71 of 300 m."""
DEPTHS = (1.0, 10.0, 1500.0)
"""Ratios of the reference depth of the scheme to the depth of the fluid."""
LAYERS = (1.0, 10.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0, 800.0, 1000.0, 1200.0)
"""Depths of the fluid in runs [m]."""


def growth(name: str, wind: float, froude: float, deeper: float) -> float:
    """Return the largest amplification of a step minus 1; wind: U k dt, deeper: one of `DEPTHS`."""
    wave, unit = wind / froude, np.eye(2)
    full = 1j * np.array([[wind, wave], [wave, wind]])
    linear = 1j * np.array([[0.0, wave], [wave * deeper, 0.0]])
    if name == "semi-implicit":
        half, share = 0.5 * Leapfrog.default_strength, Leapfrog.default_share
        inverse = np.linalg.inv(unit - linear)
        past, present = np.eye(2, 4), np.eye(2, 4, k=2)
        future = inverse @ np.hstack([unit + linear, 2.0 * (full - linear)])
        moved = half * (past - 2.0 * present + future)
        step = np.vstack([present + share * moved, future - (1.0 - share) * moved])
    else:
        cls: Any = STEPPERS[name]
        b, stages = np.array(cls.b), [unit]
        explicit, implicit = tableau(cls.explicit, b.size), tableau(cls.implicit, b.size)
        for i in range(1, b.size):
            known = unit + sum(
                explicit[i, j] * (full - linear) @ stage + implicit[i, j] * linear @ stage
                for j, stage in enumerate(stages)
            )
            stages.append(np.linalg.solve(unit - implicit[i, i] * linear, known))
        step = unit + sum(weight * full @ stage for weight, stage in zip(b, stages, strict=True))
    return float(np.abs(np.linalg.eigvals(step)).max() - 1.0)


def main(
    days: Annotated[float, typer.Option(help="Length of the runs; 0: none.")] = 30.0,
) -> None:
    """Print growth in a step and errors of runs."""
    console, winds = Console(width=140), np.linspace(0.01, 1.9, 190)
    for name in STEPPERS_SHOWN:
        for froude in FROUDE:
            for deeper in DEPTHS:
                found = np.array([growth(name, wind, froude, deeper) for wind in winds])
                above = [f"{winds[found > x][:1]} for {x:g}" for x in (1e-4, 1e-2, 1e-1)]
                console.print(f"{name}, Froude {froude}, H = {deeper:g} h: from", *above)
                console.print(f"    largest {found.max():.1e}")
    for depth, alpha in [(depth, 1.0) for depth in LAYERS] + [(1.0, 0.0)]:
        for name in STEPPERS_SHOWN if days else ():
            scene, damped = thin_flow(depth, alpha), {"edge-penalty.c": 0.01}
            sim = Simulation(scene, ne=4, np=6, stepper=name, effects=damped)
            done = sim.run(days=days)
            error = f"{done['l2_v']:.1e}" if done.status == "completed" else done.status
            console.print(f"{depth:g} m, alpha {alpha:g}, {name}, {sim.plan.dt:.0f} s: {error}")


if __name__ == "__main__":
    typer.run(main)
