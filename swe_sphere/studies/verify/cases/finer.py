"""Flows with neither exact solution nor reference, against a run of our own on a finer mesh.

That the answers converge to something is less than that they converge to the truth; the terms
that act here are those of the other families.
"""

from __future__ import annotations

from dataclasses import replace

from swe_sphere.equations.effects import Hyperviscosity
from swe_sphere.studies.verify.case import Case, Rung, Setting

__all__ = ["CASES"]


def _smooth(scene: str, days: float, *rungs: Rung) -> Case:
    """A scene with np 4 against ne 12, np 8."""
    setting = Setting(scene, days=days)
    title = f"{days:g} days, np 4, against ne 12, np 8"
    return Case(scene, title, setting, rungs, against=replace(setting, ne=12, np=8))


def _rough(scene: str, *rungs: Rung, note: str = "") -> Case:
    """A scene after a day with ν₄ = 1e15 m⁴ s⁻¹ on all meshes, np 4, against ne 20."""
    setting = Setting(scene, effects=(Hyperviscosity(1e15),), days=1.0)
    title = "1 day, np 4, ν₄ = 1e15 m⁴ s⁻¹, against ne 20"
    return Case(scene, title, setting, rungs, against=replace(setting, ne=20), note=note)


CASES = (
    _smooth(
        "mcdonald-bates",
        5.0,
        Rung(8, (2.8e-05, 3.9e-05, 2.1e-04), (3.0e-03, 3.5e-03, 9.5e-03)),
        Rung(
            15,
            (1.4e-06, 2.0e-06, 1.4e-05),
            (1.7e-04, 2.1e-04, 7.3e-04),
            floors={"order": 4.5, "order_v": 4.3},
        ),
    ),
    _smooth(
        "splash",
        1.0,
        Rung(8, (6.3e-03, 1.1e-02, 5.7e-02), (4.8e-01, 4.4e-01, 5.8e-01)),
        Rung(
            15,
            (4.8e-03, 8.0e-03, 4.5e-02),
            (3.6e-01, 3.3e-01, 4.3e-01),
            floors={"order": 0.3, "order_v": 0.3},
        ),
    ),
    _smooth(
        "gravity-bumps",
        1.0,
        Rung(8, (1.5e-03, 2.0e-03, 8.6e-03), (2.1e-01, 2.2e-01, 3.3e-01)),
        Rung(
            15,
            (7.2e-04, 9.7e-04, 4.2e-03),
            (1.0e-01, 1.1e-01, 2.0e-01),
            floors={"order": 0.9, "order_v": 0.9},
        ),
    ),
    _smooth(
        "dam-break",
        0.25,
        Rung(8, (9.2e-03, 2.6e-02, 1.6e-01), (1.8e-01, 2.0e-01, 5.8e-01)),
        Rung(
            15,
            (5.5e-03, 1.8e-02, 1.2e-01),
            (1.3e-01, 1.6e-01, 4.8e-01),
            floors={"order": 0.5, "order_v": 0.2},
        ),
    ),
    _rough(
        "modons",
        Rung(5, (2.0e-03, 4.0e-03, 3.3e-02), (5.3e-01, 5.7e-01, 6.9e-01)),
        Rung(
            10,
            (1.7e-03, 3.4e-03, 3.2e-02),
            (3.4e-01, 2.9e-01, 4.2e-01),
            floors={"order": 0.0, "order_v": 0.8},
        ),
    ),
    _rough(
        "turbulence",
        Rung(5, (4.6e-03, 6.3e-03, 5.3e-02), (4.4e-01, 4.8e-01, 1.3e00)),
        Rung(
            10,
            (8.6e-04, 1.3e-03, 1.1e-02),
            (9.6e-02, 1.2e-01, 3.0e-01),
            floors={"order": 2.2, "order_v": 1.9},
        ),
    ),
    _rough(
        "williamson7",
        Rung(5, (2.1e-03, 2.8e-03, 2.0e-02), (2.4e-01, 2.4e-01, 3.7e-01)),
        Rung(
            10,
            (4.0e-04, 5.2e-04, 3.4e-03),
            (5.9e-02, 6.2e-02, 1.4e-01),
            floors={"order": 2.2, "order_v": 1.8},
        ),
        note="the state is synthetic: the analyses of the paper are not public",
    ),
)
