"""Time error of every stepper, on a mesh so coarse that a converged run costs nothing.

The error of a scheme is a number like any other: a coefficient, a filter or a start that is wrong
by a little changes it, also where the order stays.
"""

from __future__ import annotations

from swe_sphere.steppers import STEPPERS, Stepper
from swe_sphere.studies.verify.case import CONVERGED, Case, Rung, Setting

__all__ = ["CASES"]



def _case(kind: type[Stepper]) -> Case:
    solves = kind.family != "explicit"
    tight = {"tolerance": 1e-11} if solves else {}
    setting = Setting("lauter", ne=3, days=0.125, stepper=kind.name, options=tight)
    rungs = tuple(
        Rung(dt, values={"l2_h": height, "l2_v": wind}, quick=True)
        for dt, height, wind in kind.expected_error
    )
    title = f"{kind.name}, order {kind.order}"
    # small errors feel what the solver leaves, which depends on the order of sums
    band = 2e-3 if solves and kind.order == 4 else 3e-4
    return Case(
        f"stepper-{kind.name}", title, setting, rungs, "dt", against=CONVERGED, tolerance=band
    )


CASES = tuple(_case(kind) for kind in STEPPERS.values() if kind.expected_error)
