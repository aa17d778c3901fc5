"""Viscosity, hyperviscosity, drag and relaxation: what decays."""

from __future__ import annotations

from swe_sphere.studies.verify.case import Case, Rung, Setting
from swe_sphere.studies.verify.scenes import decay, friction

__all__ = ["CASES"]

CASES = (
    Case(
        "viscosity",
        "ν = 2e6 m² s⁻¹, np 4, 10 days",
        Setting(decay, {"nu": 2e6}, days=10.0),
        (
            Rung(4, (1.2e-05, 1.5e-05, 3.2e-05), (4.0e-04, 4.8e-04, 1.5e-03)),
            Rung(
                8,
                (3.6e-07, 4.8e-07, 2.3e-06),
                (1.6e-05, 2.1e-05, 1.1e-04),
                floors={"order": 4.7, "order_v": 4.3},
            ),
            Rung(
                16,
                (1.2e-08, 1.7e-08, 1.9e-07),
                (5.3e-07, 8.5e-07, 7.1e-06),
                floors={"order": 4.7, "order_v": 4.4},
            ),
        ),
    ),
    Case(
        "viscosity-np",
        "ν = 2e6 m² s⁻¹, ne 4, 10 days",
        Setting(decay, {"nu": 2e6}, ne=4, days=10.0),
        (
            Rung(4, (1.2e-05, 1.5e-05, 3.2e-05), (4.0e-04, 4.8e-04, 1.5e-03)),
            Rung(
                6,
                (3.2e-08, 5.4e-08, 3.7e-07),
                (1.7e-06, 2.2e-06, 5.6e-06),
                floors={"order": 10.7, "order_v": 10.4},
                quick=True,
            ),
            Rung(
                8,
                (8.5e-11, 1.5e-10, 7.9e-10),
                (7.5e-09, 1.4e-08, 7.4e-08),
                floors={"order": 17.3, "order_v": 14.9},
            ),
        ),
        along="np",
    ),
    Case(
        "hyperviscosity-np",
        "ν₄ = 1e18 m⁴ s⁻¹, ne 4, 1 day",
        Setting(decay, {"nu4": 1e18}, ne=4, days=1.0),
        (
            Rung(4, (1.7e-05, 2.1e-05, 4.2e-05), (3.6e-04, 4.4e-04, 1.4e-03)),
            Rung(
                5,
                (1.1e-06, 1.5e-06, 5.5e-06),
                (2.3e-05, 2.7e-05, 6.2e-05),
                floors={"order": 8.9, "order_v": 9.6},
                quick=True,
            ),
            Rung(
                6,
                (5.3e-08, 8.8e-08, 5.6e-07),
                (1.7e-06, 2.2e-06, 5.6e-06),
                floors={"order": 12.4, "order_v": 11.1},
            ),
        ),
        along="np",
    ),
    Case(
        "viscosity-node",
        "both, np 5, 1 day, a thread a node as on a GPU",
        Setting(decay, {"nu": 2e6, "nu4": 1e18}, np=5, days=1.0, launch="node"),
        (Rung(4, (1.0e-06, 1.4e-06, 5.3e-06), (2.3e-05, 2.7e-05, 6.3e-05), quick=True),),
    ),
    Case(
        "hyperviscosity-default",
        "ne 15, np 4: the model's own coefficient is 1e16 m⁴ s⁻¹, 1 day",
        Setting(decay, {"nu4": 1e16, "default": True}, days=1.0),
        (Rung(15, (2.6e-08, 3.6e-08, 3.7e-07), (7.0e-07, 1.2e-06, 9.1e-06), quick=True),),
        note="the scaling of CAM-SE (ESCOMP/CAM, global_norms_mod): 1e15 (30/ne)^3.32 m⁴ s⁻¹",
    ),
    Case(
        "friction",
        "drag of 1e-5 s⁻¹ + 1e-6 m⁻¹ |v|, relaxation in 2 days, ne 2, np 4, 1 day",
        Setting(friction, {"linear": 1e-5, "quadratic": 1e-6, "time": 172800.0}, ne=2, days=1.0),
        (
            Rung(3600.0, (7.9e-11, 9.6e-11, 1.9e-10), (9.6e-06, 1.3e-05, 2.9e-05), quick=True),
            Rung(
                1800.0,
                (4.9e-12, 5.9e-12, 1.2e-11),
                (6.8e-07, 8.8e-07, 2.4e-06),
                floors={"order": 3.8, "order_v": 3.6},
                quick=True,
            ),
            Rung(
                900.0,
                (3.1e-13, 3.7e-13, 7.1e-13),
                (4.3e-08, 5.7e-08, 1.6e-07),
                floors={"order": 3.8, "order_v": 3.8},
            ),
        ),
        along="dt",
        mass=None,
    ),
)
