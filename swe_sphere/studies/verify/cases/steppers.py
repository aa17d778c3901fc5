"""Time error of every stepper, on a mesh so coarse that a converged run costs nothing.

The error of a scheme is a number like any other: a coefficient, a filter or a start that is wrong
by a little changes it, also where the order stays.
"""

from __future__ import annotations

from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.imex_stepper import SplitStepper
from swe_sphere.steppers.implicit import ImplicitStepper
from swe_sphere.studies.verify.case import CONVERGED, Case, Rung, Setting

__all__ = ["CASES"]

STEPS = (900.0, 450.0)
"""Time steps [s]."""

ERRORS: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "leapfrog": ((3.182509e-05, 5.538334e-04), (1.104617e-05, 2.096963e-04)),
    "rk4": ((2.941341e-07, 2.534993e-06), (1.867172e-08, 1.596877e-07)),
    "ssprk3": ((2.025637e-06, 2.439406e-05), (2.618428e-07, 3.111915e-06)),
    "kg5": ((3.951576e-07, 4.755524e-06), (5.184853e-08, 6.174662e-07)),
    "semi-implicit": ((3.986228e-05, 1.060878e-03), (9.255843e-06, 3.349328e-04)),
    "ark2": ((8.218760e-06, 1.424297e-04), (2.087072e-06, 3.482898e-05)),
    "ars343": ((1.496418e-06, 1.643251e-05), (1.957739e-07, 2.168509e-06)),
    "implicit-euler": ((8.885829e-04, 1.803285e-02), (4.480336e-04, 9.085122e-03)),
    "crank-nicolson": ((1.255289e-05, 2.138884e-04), (3.177528e-06, 5.379502e-05)),
    "implicit-midpoint": ((1.253396e-05, 2.140043e-04), (3.172815e-06, 5.382505e-05)),
    "bdf2": ((4.102155e-05, 7.407046e-04), (1.169645e-05, 2.008829e-04)),
    "tr-bdf2": ((6.141510e-06, 1.041040e-04), (1.545931e-06, 2.612298e-05)),
    "sdirk3": ((1.263671e-06, 1.318886e-05), (1.673660e-07, 1.817338e-06)),
    "esdirk4": ((2.951590e-08, 2.630594e-07), (1.859828e-09, 1.658377e-08)),
    "gauss-legendre": ((4.778152e-08, 4.285903e-07), (3.042596e-09, 2.722186e-08)),
    "average-vector-field": ((1.259850e-05, 2.160948e-04), (3.188864e-06, 5.434619e-05)),
    "rosenbrock-w": ((1.264198e-06, 1.320438e-05), (1.673914e-07, 1.818855e-06)),
}
"""l2 of height and wind at these steps after 3 hours."""


def _case(name: str) -> Case:
    solves = issubclass(STEPPERS[name], (ImplicitStepper, SplitStepper))
    tight = {"tolerance": 1e-11} if solves else {}
    setting = Setting("lauter", ne=3, days=0.125, stepper=name, options=tight)
    rungs = tuple(
        Rung(dt, values={"l2_h": height, "l2_v": wind}, quick=True)
        for dt, (height, wind) in zip(STEPS, ERRORS[name], strict=True)
    )
    title = f"{name}, order {STEPPERS[name].order}"
    # small errors feel what the solver leaves, which depends on the order of sums
    band = 2e-3 if solves and STEPPERS[name].order == 4 else 3e-4
    return Case(f"stepper-{name}", title, setting, rungs, "dt", against=CONVERGED, tolerance=band)


CASES = tuple(_case(name) for name in STEPPERS)
