"""Time integrators by name; each registers itself where it is defined."""

import importlib
import pkgutil

from swe_sphere.steppers.stepper import RECOMMENDED, STEPPERS, Stepper

__all__ = ["RECOMMENDED", "STEPPERS", "Stepper", "get_stepper"]

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)


def get_stepper(name: str) -> type[Stepper]:
    """The stepper of that name or alias.

    Raises ConfigError, naming the nearest one, when there is none.
    """
    return STEPPERS.find(name)
