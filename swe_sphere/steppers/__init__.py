"""Time integrators by name."""

from swe_sphere.equations.effects import unknown_name
from swe_sphere.steppers.average_vector_field import AverageVectorField
from swe_sphere.steppers.bdf2 import BDF2
from swe_sphere.steppers.dirk import (
    ESDIRK4,
    SDIRK3,
    TRBDF2,
    CrankNicolson,
    ImplicitEuler,
    ImplicitMidpoint,
)
from swe_sphere.steppers.gauss import GaussLegendre
from swe_sphere.steppers.imex_runge_kutta import ARK2, ARS343
from swe_sphere.steppers.leapfrog import Leapfrog
from swe_sphere.steppers.rosenbrock import RosenbrockW
from swe_sphere.steppers.runge_kutta import KG5, RK4, SSPRK3
from swe_sphere.steppers.semi_implicit import SemiImplicit
from swe_sphere.steppers.stepper import Stepper

__all__ = ["ALIASES", "RECOMMENDED", "STEPPERS", "Stepper", "get_stepper"]

RECOMMENDED = "tr-bdf2"
"""The fully implicit scheme that the measurements recommend."""

ALIASES = {"fully-implicit": RECOMMENDED}
"""Names that stand for a scheme."""

STEPPERS: dict[str, type[Stepper]] = {
    cls.name: cls
    for cls in (
        Leapfrog,
        RK4,
        SSPRK3,
        KG5,
        SemiImplicit,
        ARK2,
        ARS343,
        ImplicitEuler,
        CrankNicolson,
        ImplicitMidpoint,
        BDF2,
        TRBDF2,
        SDIRK3,
        ESDIRK4,
        GaussLegendre,
        AverageVectorField,
        RosenbrockW,
    )
}
"""All steppers by name."""


def get_stepper(name: str) -> type[Stepper]:
    """The stepper of that name or alias.

    Raises ConfigError, naming the nearest one, when there is none.
    """
    scheme = ALIASES.get(name, name)
    if scheme not in STEPPERS:
        raise unknown_name("stepper", name, (*STEPPERS, *ALIASES))
    return STEPPERS[scheme]
