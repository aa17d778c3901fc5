"""Time integrators by name; each class registers itself."""

import importlib
import pkgutil
from pathlib import Path

from swe_sphere.settings.registry import first_line
from swe_sphere.steppers.stepper import RECOMMENDED, STEPPERS, Stepper, Trajectory

__all__ = ["RECOMMENDED", "STEPPERS", "Stepper", "Trajectory", "get_stepper", "list_steppers"]

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)


def get_stepper(which: str | Path | type[Stepper]) -> type[Stepper]:
    """Return the stepper of that name or alias, in that Python file, or the class itself.

    Raises ConfigError if there is none, or not exactly one in the file; see `Registry.find`.
    """
    return STEPPERS.find(which)


def list_steppers() -> dict[str, str]:
    """Return a line about each stepper, by name.

    Examples:
        >>> import swe_sphere
        >>> swe_sphere.list_steppers()["rk4"]
        'Classical Runge-Kutta: four stages, fourth order; stable up to ω Δt = 2.83 for waves.'
    """
    named = {name: first_line(cls) for name, cls in STEPPERS.items()}
    aliases = STEPPERS.aliases.items()
    return named | {name: f"The recommended scheme: {scheme}." for name, scheme in aliases}
