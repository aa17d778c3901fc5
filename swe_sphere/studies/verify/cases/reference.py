"""Flows without exact solution, against an independent spectral-transform model."""

from __future__ import annotations

from swe_sphere.equations.effects import Hyperviscosity, Viscosity
from swe_sphere.studies.verify.case import Case, Figure, Rung, Setting

__all__ = ["CASES"]

HOMME = "HOMME, test/sw_conservative: leapfrog, 90 s, ν₄ = 1.5e15 m⁴ s⁻¹, against NCAR T213"


CASES = (
    Case(
        "williamson5-day5",
        "free surface at day 5, np 4",
        Setting("williamson5", days=5.0),
        (
            Rung(
                8,
                (2.5e-04, 3.8e-04, 2.8e-03),
                (1.7e-02, 2.9e-02, 2.0e-01),
                limits={"l2_vorticity": 2.0e-01, "decorrelation": 1.6e-02},
                quick=True,
            ),
            Rung(
                16,
                (6.0e-05, 9.4e-05, 7.9e-04),
                (2.6e-03, 4.5e-03, 2.8e-02),
                limits={"l2_vorticity": 5.9e-02, "decorrelation": 1.5e-03},
                floors={"order": 1.8, "order_v": 2.5},
            ),
        ),
        against="williamson5_day5",
        note="the reference is good to 3e-5 in l2",
    ),
    Case(
        "williamson5",
        "free surface at day 15",
        Setting("williamson5", days=15.0, dt=600.0),
        (
            Rung(
                16,
                (1.2e-04, 1.6e-04, 1.3e-03),
                (7.8e-03, 1.0e-02, 9.0e-02),
                limits={"l2_vorticity": 9.7e-02, "decorrelation": 4.0e-03},
            ),
            Rung(
                8,
                (2.9e-05, 4.0e-05, 3.7e-04),
                (2.1e-03, 2.9e-03, 2.1e-02),
                limits={"l2_vorticity": 4.7e-02, "decorrelation": 9.2e-04},
                changes={"np": 8, "dt": 300.0},
            ),
        ),
        against="williamson5_day15",
        note="the reference is good to 3e-5 in l2",
    ),
    Case(
        "williamson5-homme",
        "free surface at day 15, ne 30, np 4, rk4 with steps of 120 s, ν₄ = 1.5e15 m⁴ s⁻¹",
        Setting(
            "williamson5",
            effects=(Hyperviscosity(1.5e15),),
            days=15.0,
            dt=120.0,
        ),
        (
            Rung(
                30,
                (7.1e-05, 1.0e-04, 7.6e-04),
                (4.5e-03, 6.5e-03, 2.8e-02),
                limits={"l2_vorticity": 4.1e-02, "decorrelation": 6.9e-04},
                figures=(
                    Figure("l1_h", 4.899e-4, HOMME),
                    Figure("l2_h", 6.936e-4, HOMME),
                    Figure("linf_h", 9.612e-3, HOMME),
                ),
            ),
        ),
        against="williamson5_day15",
        note="HOMME's figures are against another reference, whose own error is not known to us",
    ),
    Case(
        "williamson6-day7",
        "height at day 7",
        Setting("williamson6", days=7.0),
        (
            Rung(
                8,
                (1.7e-03, 2.5e-03, 1.8e-02),
                limits={"l2_vorticity": 2.8e-01, "decorrelation": 3.2e-02},
                quick=True,
            ),
            Rung(
                16,
                (1.4e-04, 2.1e-04, 3.1e-03),
                limits={"l2_vorticity": 1.7e-01, "decorrelation": 1.1e-02},
            ),
            Rung(
                8,
                (1.5e-04, 2.1e-04, 1.3e-03),
                limits={"l2_vorticity": 1.4e-01, "decorrelation": 8.1e-03},
                changes={"np": 8},
            ),
        ),
        against="williamson6_day7",
        note="the reference is good to 1.4e-5 in l2",
    ),
    Case(
        "williamson6",
        "height at day 14",
        Setting("williamson6", days=14.0, dt=360.0),
        (
            Rung(
                16,
                (2.2e-03, 2.9e-03, 1.8e-02),
                limits={"l2_vorticity": 5.2e-01, "decorrelation": 1.0e-01},
            ),
            Rung(
                8,
                (1.1e-03, 1.5e-03, 6.1e-03),
                limits={"l2_vorticity": 5.4e-01, "decorrelation": 1.1e-01},
                changes={"np": 8, "dt": 200.0},
            ),
        ),
        against="williamson6_day14",
        note="the reference is good to 4e-4 in l2",
    ),
    Case(
        "galewsky-day4",
        "unstable jet without viscosity at day 4, np 8",
        Setting("galewsky", np=8, days=4.0),
        (
            Rung(
                8,
                (6.1e-04, 1.7e-03, 1.3e-02),
                limits={"l2_vorticity": 4.1e-01, "decorrelation": 6.8e-02},
            ),
            Rung(
                12,
                (1.2e-05, 2.5e-05, 2.6e-04),
                limits={"l2_vorticity": 3.0e-02, "decorrelation": 3.8e-04},
                floors={"order": 10.2},
            ),
        ),
        against="galewsky_day4",
        note="the reference is good to 3e-6 in l2 of h, 1.2e-2 of vorticity",
    ),
    Case(
        "galewsky-viscous",
        "unstable jet with ν = 1e5 m² s⁻¹ at day 6",
        Setting("galewsky", effects=(Viscosity(1e5),), days=6.0),
        (
            Rung(
                8,
                (3.1e-03, 7.4e-03, 5.0e-02),
                (7.9e-01, 6.6e-01, 8.9e-01),
                limits={"l2_vorticity": 1.1e00, "decorrelation": 4.7e-01},
                changes={"np": 6},
            ),
            Rung(
                12,
                (6.1e-06, 1.6e-05, 1.4e-04),
                (2.2e-03, 1.9e-03, 4.5e-03),
                limits={"l2_vorticity": 1.1e-02, "decorrelation": 4.9e-05},
                changes={"np": 8},
            ),
        ),
        against="galewsky_viscous_day6",
    ),
)
