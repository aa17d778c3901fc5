"""What is conserved: energy up to the error of the time steps."""

from __future__ import annotations

from swe_sphere.verify.case import Case, Rung, Setting

__all__ = ["CASES"]

CASES = (
    Case(
        "energy",
        "williamson6, ne 8, np 4, rk4, 1 day",
        Setting("williamson6", days=1.0),
        (
            Rung(600.0, limits={"energy_drift": 1.9e-09}),
            Rung(300.0, limits={"energy_drift": 8.6e-11}, floors={"order_energy": 4.2}),
            Rung(150.0, limits={"energy_drift": 2.8e-12}, floors={"order_energy": 4.7}),
            Rung(75.0, limits={"energy_drift": 8.7e-14}, floors={"order_energy": 4.8}),
        ),
        along="dt",
        note="rk4 damps an oscillation by |R(iz)| = 1 - z⁶/144 a step, so order 5 in a given time",
    ),
)
