"""Time integrators by name."""

from ..model.effects import unknown_name
from .base import Stepper
from .leapfrog import Leapfrog
from .runge_kutta import KG5, RK4, SSPRK3

__all__ = ["STEPPERS", "Stepper", "get_stepper"]

STEPPERS: dict[str, type[Stepper]] = {cls.name: cls for cls in (Leapfrog, RK4, SSPRK3, KG5)}
"""All steppers by name."""


def get_stepper(name: str) -> type[Stepper]:
    """The stepper of that name.

    Raises ConfigError, naming the nearest one, when there is none.
    """
    if name not in STEPPERS:
        raise unknown_name("stepper", name, STEPPERS)
    return STEPPERS[name]
