"""Time integrators by name."""

from ..model.effects import unknown_name
from .average_vector_field import AverageVectorField
from .base import Stepper
from .bdf2 import BDF2
from .dirk import ESDIRK4, SDIRK3, TRBDF2, CrankNicolson, ImplicitEuler, ImplicitMidpoint
from .gauss import GaussLegendre
from .imex import ARK2, ARS343
from .leapfrog import Leapfrog
from .rosenbrock import RosenbrockW
from .runge_kutta import KG5, RK4, SSPRK3
from .semi_implicit import SemiImplicit

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
