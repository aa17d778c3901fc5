"""Unsteady nonlinear flow with an exact solution."""

from __future__ import annotations

from swe_sphere.studies.verify.case import Case, Figure, Rung, Setting
from swe_sphere.studies.verify.scenes import driven

__all__ = ["CASES"]

TRIXI = "TrixiAtmo.jl, test suite: DGSEM of degree 3, the constant k2 = 0"

CASES = (
    Case(
        "lauter",
        "α = π/4, np 4, steps of 200 s and less",
        Setting("lauter", dt=200.0),
        (
            Rung(4, (6.4e-05, 8.0e-05, 3.0e-04), (2.6e-03, 3.3e-03, 2.6e-02)),
            Rung(
                8,
                (4.3e-06, 6.0e-06, 4.6e-05),
                (2.5e-04, 3.6e-04, 2.6e-03),
                floors={"order": 3.6, "order_v": 3.0},
                quick=True,
            ),
            Rung(
                15,
                (3.1e-07, 3.9e-07, 2.1e-06),
                (2.1e-05, 2.7e-05, 1.4e-04),
                floors={"order": 4.1, "order_v": 3.9},
            ),
        ),
    ),
    Case(
        "lauter-np",
        "α = π/4, ne 4, steps of 200 s",
        Setting("lauter", ne=4, dt=200.0),
        (
            Rung(4, (6.4e-05, 8.0e-05, 3.0e-04), (2.6e-03, 3.3e-03, 2.6e-02)),
            Rung(
                6,
                (3.9e-07, 5.1e-07, 4.0e-06),
                (2.7e-05, 3.6e-05, 3.8e-04),
                floors={"order": 9.7, "order_v": 8.6},
            ),
            Rung(
                8,
                (2.1e-09, 2.7e-09, 1.5e-08),
                (1.7e-07, 2.2e-07, 2.1e-06),
                floors={"order": 15.4, "order_v": 15.0},
            ),
        ),
        along="np",
    ),
    Case(
        "lauter-day",
        "α = π/4, ne 4, 1 day in steps of 300 s",
        Setting("lauter", ne=4, dt=300.0, days=1.0),
        (
            Rung(6, (2.8e-07, 3.9e-07, 2.9e-06), (1.9e-05, 2.4e-05, 1.8e-04), quick=True),
            Rung(
                8,
                (1.6e-09, 2.0e-09, 1.4e-08),
                (1.1e-07, 1.3e-07, 9.5e-07),
                floors={"order": 15.5, "order_v": 15.3},
                quick=True,
            ),
        ),
        along="np",
    ),
    Case(
        "lauter-node",
        "α = π/4, np 6, 1 day in steps of 300 s, a thread a node as on a GPU",
        Setting("lauter", np=6, dt=300.0, days=1.0, launch="node"),
        (Rung(4, (2.8e-07, 3.9e-07, 2.9e-06), (1.9e-05, 2.4e-05, 1.8e-04), quick=True),),
    ),
    Case(
        "lauter-ne8np8",
        "α = π/4, ne 8, np 8, steps of 100 s",
        Setting("lauter", np=8, dt=100.0),
        (Rung(8, (3.0e-11, 3.4e-11, 1.2e-10), (1.1e-09, 1.4e-09, 1.2e-08)),),
    ),
    Case(
        "williamson4",
        "a forced low that travels, np 4",
        Setting("williamson4"),
        (
            Rung(8, (3.7e-04, 6.1e-04, 6.5e-03), (1.3e-01, 1.3e-01, 3.5e-01)),
            Rung(
                15,
                (8.3e-05, 1.5e-04, 2.2e-03),
                (4.0e-02, 4.1e-02, 1.4e-01),
                floors={"order": 2.1, "order_v": 1.7},
            ),
        ),
        mass=None,
    ),
    Case(
        "williamson4-np",
        "a forced low that travels, ne 8",
        Setting("williamson4"),
        (
            Rung(4, (3.7e-04, 6.1e-04, 6.5e-03), (1.3e-01, 1.3e-01, 3.5e-01)),
            Rung(
                6,
                (1.9e-05, 3.3e-05, 4.6e-04),
                (1.2e-02, 1.3e-02, 5.0e-02),
                floors={"order": 5.6, "order_v": 4.4},
            ),
            Rung(
                8,
                (1.2e-06, 2.1e-06, 3.5e-05),
                (8.6e-04, 1.1e-03, 6.1e-03),
                floors={"order": 8.0, "order_v": 7.3},
            ),
        ),
        along="np",
        mass=None,
    ),
    Case(
        "williamson4-ne6np8",
        "a forced low that travels, ne 6, np 8",
        Setting("williamson4", np=8),
        (Rung(6, (1.5e-05, 3.1e-05, 4.8e-04), (8.7e-03, 9.7e-03, 3.4e-02)),),
        mass=None,
    ),
    Case(
        "williamson4-day",
        "a forced low that travels, ne 6, 1 day in steps of 600 s",
        Setting("williamson4", ne=6, days=1.0, dt=600.0),
        (
            Rung(4, (5.3e-04, 7.3e-04, 5.0e-03), (7.4e-02, 7.0e-02, 1.4e-01), quick=True),
            Rung(
                6,
                (3.1e-05, 5.3e-05, 7.2e-04),
                (1.2e-02, 1.5e-02, 7.9e-02),
                floors={"order": 4.9, "order_v": 2.8},
                quick=True,
            ),
        ),
        along="np",
        mass=None,
    ),
    Case(
        "driven",
        "all that holds the flow is forcing, ne 4, 1 day in steps of 600 s",
        Setting(driven, ne=4, days=1.0, dt=600.0),
        (
            Rung(4, (4.5e-05, 6.6e-05, 3.5e-04), (1.3e-03, 1.5e-03, 4.7e-03)),
            Rung(
                6,
                (2.6e-07, 3.3e-07, 2.6e-06),
                (5.1e-06, 6.5e-06, 6.9e-05),
                floors={"order": 10.2, "order_v": 10.4},
                quick=True,
            ),
            Rung(
                8,
                (1.2e-09, 1.5e-09, 9.8e-09),
                (3.2e-08, 4.0e-08, 3.0e-07),
                floors={"order": 15.8, "order_v": 15.0},
                quick=True,
            ),
        ),
        along="np",
        mass=None,
    ),
    Case(
        "lauter-trixi",
        "α = π/4, ne 5, np 4, 1 day",
        Setting("lauter", days=1.0, dt=200.0),
        (
            Rung(
                5,
                (2.4e-05, 3.6e-05, 2.0e-04),
                (1.3e-03, 1.8e-03, 8.1e-03),
                limits={"rms_h": 3.7e-01, "max_h": 2.7e00},
                figures=(Figure("rms_h", 0.255, TRIXI), Figure("max_h", 2.12, TRIXI)),
            ),
        ),
    ),
    Case(
        "matsuno",
        "equatorial Rossby wave, np 4, a period",
        Setting("matsuno", days=18.0),
        (
            Rung(8, (1.5e-08, 2.6e-08, 1.5e-07), (1.5e-01, 1.4e-01, 1.7e-01)),
            Rung(
                15,
                (3.9e-09, 6.4e-09, 2.2e-08),
                (4.4e-02, 3.6e-02, 2.6e-02),
                floors={"order": 2.0, "order_v": 1.9},
            ),
        ),
        note="the solution is exact up to terms of relative size 0.02, which is what is left in v",
    ),
    Case(
        "matsuno-gravity",
        "eastward inertia-gravity wave, np 4, 2 days",
        Setting("matsuno", {"wave": "eig"}, days=2.0),
        (
            Rung(8, (4.1e-09, 7.0e-09, 6.2e-08), (8.9e-02, 8.3e-02, 1.4e-01), quick=True),
            Rung(
                15,
                (2.5e-09, 4.2e-09, 1.7e-08),
                (4.1e-02, 3.4e-02, 4.6e-02),
                floors={"order": 0.6, "order_v": 1.2},
            ),
        ),
    ),
)
