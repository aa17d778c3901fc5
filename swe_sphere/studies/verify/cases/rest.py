"""Water at rest over mountains: nothing may move."""

from __future__ import annotations

from swe_sphere.studies.verify.case import Case, Rung, Setting

__all__ = ["CASES"]

CASES = (
    Case(
        "lake-at-rest",
        "cone, np 4, 5 days",
        Setting("lake-at-rest", {"cone": True}),
        (
            Rung(6, limits={"max_speed": 1e-10}, changes={"days": 1.0}, quick=True),
            Rung(16, limits={"max_speed": 1e-10}),
        ),
    ),
    Case(
        "lake-at-rest-smooth",
        "smooth mountain on a planet that does not rotate, np 8, 5 days",
        Setting("lake-at-rest", {"cone": False, "rotating": False}, np=8),
        (Rung(8, limits={"max_speed": 1e-10}),),
    ),
    Case(
        "lake-at-rest-float32",
        "cone, np 4, 5 days in single precision",
        Setting("lake-at-rest", {"cone": True}, precision="float32"),
        (
            Rung(6, limits={"max_speed": 1e-3}),
            Rung(16, limits={"max_speed": 1e-3}),
        ),
        mass=1e-6,
        note="bottoms are measured from the mean surface: rounding makes no slope",
    ),
)
