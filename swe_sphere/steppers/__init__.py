"""Time integrators by name; each registers itself where it is defined."""

import importlib
import pkgutil
from pathlib import Path

from swe_sphere.steppers.stepper import RECOMMENDED, STEPPERS, Stepper

__all__ = ["RECOMMENDED", "STEPPERS", "Stepper", "get_stepper"]

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)


def get_stepper(which: str | Path | type[Stepper]) -> type[Stepper]:
    """The stepper of that name or alias, the one in that Python file, or the class itself.

    Raises ConfigError where there is none, or not one in the file; see `Registry.find`.
    """
    return STEPPERS.find(which)
