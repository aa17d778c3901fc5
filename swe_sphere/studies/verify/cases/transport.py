"""Depth carried by a prescribed wind."""

from __future__ import annotations

import math

from swe_sphere.equations.effects import Tracers
from swe_sphere.studies.verify.case import Case, Figure, Rung, Setting

__all__ = ["CASES"]

HOMME = "HOMME, test/sw_conservative, swtc1ref: leapfrog, 360 s"
HOMME_SSP = "the same with RK-SSP3"

CASES = (
    Case(
        "williamson1-smooth",
        "Gaussian bell, α = π/4, np 4, once around in 12 days",
        Setting("williamson1", {"alpha": math.pi / 4, "gaussian": True}, days=12.0, dt=600.0),
        (
            Rung(4, (3.1e-01, 1.4e-01, 1.2e-01)),
            Rung(8, (1.1e-02, 4.6e-03, 5.8e-03), floors={"order": 4.6}),
            Rung(15, (6.0e-04, 3.2e-04, 1.3e-03), floors={"order": 4.1}),
            Rung(30, (4.3e-05, 2.8e-05, 1.7e-04), floors={"order": 3.3}),
        ),
    ),
    Case(
        "williamson1-smooth-np",
        "Gaussian bell, α = π/4, ne 4, 12 days",
        Setting("williamson1", {"alpha": math.pi / 4, "gaussian": True}, ne=4, days=12.0, dt=600.0),
        (
            Rung(4, (3.1e-01, 1.4e-01, 1.2e-01)),
            Rung(6, (7.1e-03, 3.2e-03, 6.9e-03), floors={"order": 7.1}, quick=True),
            Rung(8, (8.8e-05, 4.2e-05, 9.2e-05), floors={"order": 12.7}, quick=True),
            Rung(10, (8.0e-07, 3.6e-07, 8.8e-07), floors={"order": 18.7}),
        ),
        along="np",
    ),
    Case(
        "williamson1-node",
        "Gaussian bell, α = π/4, np 6, 3 days, a thread a node as on a GPU",
        Setting(
            "williamson1",
            {"alpha": math.pi / 4, "gaussian": True},
            np=6,
            days=3.0,
            dt=600.0,
            launch="node",
        ),
        (Rung(4, (3.0e-03, 1.6e-03, 6.5e-03), quick=True),),
    ),
    Case(
        "williamson1-tilted",
        "cosine bell, α = π/4, np 4, 12 days",
        Setting("williamson1", {"alpha": math.pi / 4}, days=12.0, dt=600.0),
        (
            Rung(8, (2.1e00, 3.4e-01, 1.7e-01)),
            Rung(15, (2.8e-01, 4.7e-02, 2.5e-02), floors={"order": 3.0}),
            Rung(30, (4.8e-02, 8.6e-03, 5.3e-03), floors={"order": 2.2}),
        ),
    ),
    Case(
        "williamson1",
        "cosine bell, ne 11, np 4, 12 days, leapfrog with steps of 360 s",
        Setting("williamson1", days=12.0, dt=360.0, stepper="leapfrog"),
        (
            Rung(
                11,
                (3.9e-01, 1.2e-01, 5.4e-02),
                quick=True,
                figures=(
                    Figure("l1_h", 0.3080, HOMME),
                    Figure("l2_h", 0.09563, HOMME),
                    Figure("linf_h", 0.04883, HOMME),
                ),
            ),
        ),
    ),
    Case(
        "williamson1-ssprk3",
        "cosine bell, ne 11, np 4, 12 days, ssprk3 with steps of 360 s",
        Setting("williamson1", days=12.0, dt=360.0, stepper="ssprk3"),
        (
            Rung(
                11,
                (4.0e-01, 1.2e-01, 5.8e-02),
                figures=(
                    Figure("l1_h", 0.3251, HOMME_SSP),
                    Figure("l2_h", 0.09889, HOMME_SSP),
                    Figure("linf_h", 0.04721, HOMME_SSP),
                ),
            ),
        ),
    ),
    Case(
        "moving-vortices",
        "α = π/4, np 4, 12 days",
        Setting("moving-vortices", days=12.0, dt=1200.0),
        (
            Rung(8, (2.9e-02, 4.1e-02, 1.9e-01)),
            Rung(15, (1.5e-02, 2.0e-02, 1.3e-01), floors={"order": 1.0}),
        ),
    ),
    Case(
        "moving-vortices-np",
        "α = π/4, ne 6, 12 days",
        Setting("moving-vortices", ne=6, days=12.0, dt=1200.0),
        (
            Rung(4, (4.1e-02, 5.6e-02, 2.2e-01)),
            Rung(6, (2.1e-02, 3.2e-02, 1.9e-01), floors={"order": 0.9}),
            Rung(8, (5.1e-03, 7.5e-03, 4.3e-02), floors={"order": 4.1}),
        ),
        along="np",
    ),
    Case(
        "moving-vortices-day",
        "α = π/4, ne 6, np 6, 1 day",
        Setting("moving-vortices", np=6, days=1.0, dt=1800.0),
        (Rung(6, (4.3e-05, 7.5e-05, 5.9e-04), quick=True),),
    ),
    Case(
        "deformational",
        "case 4, np 4, 12 days",
        Setting("deformational", days=12.0, dt=900.0),
        (
            Rung(
                8,
                (5.6e-04, 8.0e-04, 6.5e-03),
                limits={
                    "l2_q_gaussian_hills": 5.9e-01,
                    "l2_q_cosine_bells": 7.2e-01,
                    "l2_q_correlated": 1.3e-01,
                    "l2_q_slotted_cylinders": 1.2e00,
                    "beyond_bounds": 3.5e00,
                    "tracer_mass_drift": 1e-13,
                },
            ),
            Rung(
                15,
                (5.9e-05, 9.0e-05, 2.1e-03),
                limits={
                    "l2_q_gaussian_hills": 2.5e-01,
                    "l2_q_cosine_bells": 4.1e-01,
                    "l2_q_correlated": 7.2e-02,
                    "l2_q_slotted_cylinders": 7.8e-01,
                    "beyond_bounds": 2.8e00,
                    "tracer_mass_drift": 1e-13,
                },
                floors={"order_q": 1.2},
            ),
        ),
    ),
    Case(
        "deformational-np",
        "case 4, ne 4, 12 days",
        Setting("deformational", ne=4, days=12.0, dt=1800.0),
        (
            Rung(
                4,
                (6.5e-03, 9.1e-03, 6.3e-02),
                limits={
                    "l2_q_gaussian_hills": 1.0e00,
                    "l2_q_cosine_bells": 1.2e00,
                    "l2_q_correlated": 1.8e-01,
                    "l2_q_slotted_cylinders": 1.5e00,
                    "beyond_bounds": 3.0e00,
                    "tracer_mass_drift": 1e-13,
                },
            ),
            Rung(
                6,
                (7.5e-05, 1.1e-04, 1.8e-03),
                limits={
                    "l2_q_gaussian_hills": 6.0e-01,
                    "l2_q_cosine_bells": 9.6e-01,
                    "l2_q_correlated": 1.7e-01,
                    "l2_q_slotted_cylinders": 1.3e00,
                    "beyond_bounds": 5.2e00,
                    "tracer_mass_drift": 1e-13,
                },
                floors={"order_q": 0.8},
                quick=True,
            ),
            Rung(
                8,
                (4.2e-07, 6.2e-07, 9.7e-06),
                limits={
                    "l2_q_gaussian_hills": 2.5e-01,
                    "l2_q_cosine_bells": 6.4e-01,
                    "l2_q_correlated": 1.3e-01,
                    "l2_q_slotted_cylinders": 1.3e00,
                    "beyond_bounds": 7.3e00,
                    "tracer_mass_drift": 1e-13,
                },
                floors={"order_q": 2.4},
            ),
        ),
        along="np",
    ),
    Case(
        "deformational-limiter",
        "case 4, np 4, 12 days, with the limiter",
        Setting("deformational", effects=(Tracers(limiter=True),), days=12.0, dt=900.0),
        (
            Rung(
                8,
                (5.6e-04, 8.0e-04, 6.5e-03),
                limits={
                    "l2_q_gaussian_hills": 2.0e-01,
                    "l2_q_cosine_bells": 4.2e-01,
                    "l2_q_correlated": 7.2e-02,
                    "l2_q_slotted_cylinders": 5.7e-01,
                    "beyond_bounds": 1e-12,
                    "tracer_mass_drift": 1e-13,
                },
            ),
            Rung(
                15,
                (5.9e-05, 9.0e-05, 2.1e-03),
                limits={
                    "l2_q_gaussian_hills": 6.2e-02,
                    "l2_q_cosine_bells": 1.7e-01,
                    "l2_q_correlated": 3.5e-02,
                    "l2_q_slotted_cylinders": 4.3e-01,
                    "beyond_bounds": 1e-12,
                    "tracer_mass_drift": 1e-13,
                },
                floors={"order_q": 1.6},
            ),
        ),
    ),
    Case(
        "deformational-limiter-day",
        "case 4, np 4, 1 day, with the limiter",
        Setting("deformational", effects=(Tracers(limiter=True),), days=1.0, dt=1800.0),
        (
            Rung(
                6,
                (3.4e-04, 4.8e-04, 3.9e-03),
                limits={"beyond_bounds": 1e-12, "tracer_mass_drift": 1e-13},
                quick=True,
            ),
        ),
    ),
    Case(
        "deformational-divergent",
        "case 3, np 4, 12 days",
        Setting("deformational", {"case": 3}, days=12.0, dt=900.0),
        (
            Rung(
                8,
                (1.9e-12, 5.2e-12, 7.6e-11),
                limits={
                    "l2_q_gaussian_hills": 7.0e-11,
                    "l2_q_cosine_bells": 3.5e-09,
                    "l2_q_correlated": 6.9e-11,
                    "l2_q_slotted_cylinders": 1.7e-07,
                    "beyond_bounds": 1.6e-06,
                    "tracer_mass_drift": 1e-13,
                },
            ),
            Rung(
                15,
                (6.0e-12, 2.1e-11, 5.7e-10),
                limits={
                    "l2_q_gaussian_hills": 2.5e-10,
                    "l2_q_cosine_bells": 3.6e-08,
                    "l2_q_correlated": 1.1e-09,
                    "l2_q_slotted_cylinders": 9.0e-06,
                    "beyond_bounds": 7.4e-05,
                    "tracer_mass_drift": 1e-13,
                },
                floors={"order_q": -2.2},
            ),
        ),
    ),
)
