"""The jet of Galewsky et al. without its perturbation: what grows is the imprint of the mesh."""

from __future__ import annotations

from swe_sphere.studies.verify.case import Case, Rung, Setting

__all__ = ["CASES"]

CASES = (
    Case(
        "galewsky-balanced",
        "np 4, 4 days",
        Setting("galewsky", {"perturbed": False}, days=4.0),
        (
            Rung(
                15,
                (2.5e-03, 5.8e-03, 3.9e-02),
                (1.1e00, 7.0e-01, 8.4e-01),
                limits={"max_v": 5.3e01},
            ),
            Rung(
                30,
                (2.7e-04, 6.2e-04, 4.1e-03),
                (1.3e-01, 8.6e-02, 1.7e-01),
                limits={"max_v": 1.3e01},
                floors={"order": 3.0, "order_v": 2.8},
            ),
        ),
    ),
    Case(
        "galewsky-balanced-np8",
        "np 8, 4 days",
        Setting("galewsky", {"perturbed": False}, np=8, days=4.0),
        (
            Rung(
                8,
                (5.6e-04, 1.7e-03, 1.3e-02),
                (3.2e-01, 2.2e-01, 2.5e-01),
                limits={"max_v": 1.9e01},
            ),
            Rung(
                12,
                (7.5e-06, 2.1e-05, 1.6e-04),
                (4.3e-03, 2.8e-03, 3.3e-03),
                limits={"max_v": 2.4e-01},
                floors={"order": 10.6, "order_v": 10.5},
            ),
        ),
        note="the prescribed perturbation dominates where this wind is below 1 m/s",
    ),
)
