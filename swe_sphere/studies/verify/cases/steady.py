"""Steady flow in geostrophic balance: all terms but orography, and no time error."""

from __future__ import annotations

import math

from swe_sphere.studies.verify.case import Case, Figure, Rung, Setting

__all__ = ["CASES"]

TRIXI = "TrixiAtmo.jl, test suite: DGSEM of degree 3"
FV3 = "FV3 at C48, Zenodo 8327578: {} grid, hord 8"

CASES = (
    Case(
        "williamson2",
        "α = 0, np 4",
        Setting("williamson2"),
        (
            Rung(4, (1.9e-04, 2.4e-04, 1.2e-03), (1.5e-03, 1.8e-03, 5.1e-03)),
            Rung(
                8,
                (8.6e-06, 1.1e-05, 5.3e-05),
                (1.1e-04, 1.3e-04, 4.4e-04),
                floors={"order": 4.2, "order_v": 3.6},
            ),
            Rung(
                15,
                (5.3e-07, 7.2e-07, 4.5e-06),
                (9.4e-06, 1.1e-05, 3.9e-05),
                floors={"order": 4.1, "order_v": 3.6},
            ),
            Rung(
                30,
                (4.2e-08, 5.4e-08, 3.4e-07),
                (4.1e-07, 4.8e-07, 1.9e-06),
                floors={"order": 3.5, "order_v": 4.3},
            ),
        ),
    ),
    Case(
        "williamson2-tilted",
        "α = π/4, np 4: flow over the corners of the cube",
        Setting("williamson2", {"alpha": math.pi / 4}),
        (
            Rung(4, (2.0e-04, 3.8e-04, 2.9e-03), (2.7e-03, 3.6e-03, 1.3e-02), quick=True),
            Rung(
                8,
                (8.9e-06, 1.3e-05, 9.8e-05),
                (1.4e-04, 1.7e-04, 1.4e-03),
                floors={"order": 4.7, "order_v": 4.3},
                quick=True,
            ),
            Rung(
                15,
                (7.9e-07, 1.2e-06, 7.4e-06),
                (9.8e-06, 1.2e-05, 7.7e-05),
                floors={"order": 3.6, "order_v": 4.0},
            ),
            Rung(
                30,
                (3.2e-08, 4.5e-08, 3.6e-07),
                (3.7e-07, 4.6e-07, 4.7e-06),
                floors={"order": 4.5, "order_v": 4.5},
            ),
        ),
    ),
    Case(
        "williamson2-np",
        "α = 0, ne 8",
        Setting("williamson2"),
        (
            Rung(4, (8.6e-06, 1.1e-05, 5.3e-05), (1.1e-04, 1.3e-04, 4.4e-04)),
            Rung(
                6,
                (5.7e-09, 7.9e-09, 5.6e-08),
                (1.1e-07, 1.3e-07, 6.5e-07),
                floors={"order": 14.0, "order_v": 13.3},
            ),
            Rung(
                8,
                (1.4e-11, 1.7e-11, 7.9e-11),
                (1.5e-10, 1.9e-10, 1.6e-09),
                floors={"order": 18.1, "order_v": 19.1},
            ),
        ),
        along="np",
    ),
    Case(
        "williamson2-tilted-np",
        "α = π/4, ne 4",
        Setting("williamson2", {"alpha": math.pi / 4}, ne=4),
        (
            Rung(4, (2.0e-04, 3.8e-04, 2.9e-03), (2.7e-03, 3.6e-03, 1.3e-02)),
            Rung(
                6,
                (7.7e-07, 1.2e-06, 7.7e-06),
                (1.1e-05, 1.5e-05, 7.9e-05),
                floors={"order": 11.1, "order_v": 10.6},
                quick=True,
            ),
            Rung(
                8,
                (3.6e-09, 5.2e-09, 5.2e-08),
                (4.6e-08, 6.0e-08, 6.4e-07),
                floors={"order": 15.9, "order_v": 16.1},
                quick=True,
            ),
            Rung(
                10,
                (1.7e-11, 2.1e-11, 2.3e-10),
                (2.3e-10, 2.8e-10, 4.5e-09),
                floors={"order": 21.7, "order_v": 21.2},
            ),
        ),
        along="np",
    ),
    Case(
        "williamson2-tilted-ne8np8",
        "α = π/4, ne 8, np 8",
        Setting("williamson2", {"alpha": math.pi / 4}, np=8),
        (Rung(8, (1.9e-11, 2.6e-11, 2.9e-10), (2.8e-10, 3.5e-10, 6.4e-09)),),
    ),
    Case(
        "williamson2-polar",
        "α = π/2 - 0.05, np 4: flow over the poles",
        Setting("williamson2", {"alpha": math.pi / 2 - 0.05}),
        (
            Rung(8, (9.0e-06, 1.2e-05, 5.6e-05), (1.1e-04, 1.3e-04, 5.3e-04)),
            Rung(
                15,
                (5.8e-07, 8.0e-07, 5.8e-06),
                (1.1e-05, 1.3e-05, 5.1e-05),
                floors={"order": 4.1, "order_v": 3.5},
            ),
        ),
    ),
    Case(
        "williamson2-stretched",
        "α = π/4, np 6, mesh refined twice at 40°N 115°E and turned",
        Setting(
            "williamson2",
            {"alpha": math.pi / 4},
            np=6,
            days=1.0,
            mesh={"stretch": 2.0, "centre": (2.0, 0.7), "spin": 0.3},
        ),
        (
            Rung(4, (2.3e-05, 3.4e-05, 2.3e-04), (2.3e-04, 2.9e-04, 2.1e-03), quick=True),
            Rung(
                8,
                (2.1e-07, 3.6e-07, 4.0e-06),
                (2.6e-06, 4.0e-06, 3.1e-05),
                floors={"order": 6.4, "order_v": 6.0},
            ),
        ),
    ),
    Case(
        "williamson3",
        "α = π/3, np 4: a jet of compact support",
        Setting("williamson3", {"alpha": math.pi / 3}),
        (
            Rung(8, (4.0e-04, 8.5e-04, 1.1e-02), (3.4e-02, 3.2e-02, 1.6e-01), quick=True),
            Rung(
                15,
                (1.4e-05, 2.5e-05, 2.8e-04),
                (1.4e-03, 1.3e-03, 6.7e-03),
                floors={"order": 5.4, "order_v": 4.9},
            ),
            Rung(
                30,
                (5.8e-07, 1.1e-06, 1.1e-05),
                (4.7e-05, 3.7e-05, 1.6e-04),
                floors={"order": 4.4, "order_v": 4.9},
            ),
        ),
    ),
    Case(
        "williamson3-np",
        "α = π/3, ne 8",
        Setting("williamson3", {"alpha": math.pi / 3}),
        (
            Rung(4, (4.0e-04, 8.5e-04, 1.1e-02), (3.4e-02, 3.2e-02, 1.6e-01)),
            Rung(
                6,
                (3.7e-06, 7.0e-06, 8.8e-05),
                (3.7e-04, 3.1e-04, 1.5e-03),
                floors={"order": 9.2, "order_v": 8.9},
            ),
            Rung(
                8,
                (3.9e-08, 6.4e-08, 1.1e-06),
                (3.4e-06, 2.5e-06, 1.5e-05),
                floors={"order": 13.8, "order_v": 14.1},
            ),
        ),
        along="np",
    ),
    Case(
        "williamson3-straight",
        "α = 0, ne 8",
        Setting("williamson3"),
        (
            Rung(4, (1.8e-04, 2.6e-04, 1.7e-03), (1.2e-02, 8.2e-03, 2.2e-02)),
            Rung(
                8,
                (6.3e-08, 1.1e-07, 1.3e-06),
                (4.5e-06, 3.1e-06, 8.9e-06),
                floors={"order": 9.0, "order_v": 9.1},
            ),
        ),
        along="np",
    ),
    Case(
        "williamson2-trixi",
        "α = 0, ne 5, np 4, 1 day",
        Setting("williamson2", days=1.0),
        (
            Rung(
                5,
                (4.7e-05, 7.5e-05, 3.3e-04),
                (8.0e-04, 9.3e-04, 2.4e-03),
                limits={"rms_h": 1.9e-01, "max_h": 9.8e-01},
                figures=(Figure("rms_h", 0.278, TRIXI), Figure("max_h", 1.82, TRIXI)),
            ),
        ),
    ),
    Case(
        "williamson2-fv3",
        "α = 0, ne 16, np 4: the spacing of C48",
        Setting("williamson2"),
        (
            Rung(
                16,
                (5.2e-07, 6.7e-07, 3.7e-06),
                (5.9e-06, 7.0e-06, 2.8e-05),
                limits={"max_v": 5.9e-04},
                figures=(
                    Figure("max_v", 0.029, FV3.format("duo")),
                    Figure("max_v", 0.24, FV3.format("plain")),
                ),
            ),
        ),
    ),
)
