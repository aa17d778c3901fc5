"""Preconditioners by name, all with one small interface; each class registers itself."""

import importlib
import pkgutil
from pathlib import Path

from swe_sphere.equations.model import Model
from swe_sphere.solvers.preconditioners.preconditioner import COSTS, PRECONDITIONERS, Preconditioner

__all__ = ["PRECONDITIONERS", "Preconditioner", "make_preconditioner"]

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)


def make_preconditioner(
    which: str | Path | type[Preconditioner], model: Model
) -> Preconditioner | None:
    """Return the preconditioner of that name, file or class; None for "none".

    For a scene with prescribed wind, which has no gravity waves, the result is None. Raises
    ConfigError if there is none, or not exactly one in the file; see `Registry.find`.
    """
    kind = PRECONDITIONERS.find(which)
    if kind is PRECONDITIONERS["none"] or model.scene.wind is not None:
        return None
    made = kind(model)  # type: ignore[call-arg]
    made.counters = model.counters
    made.counters |= dict.fromkeys(COSTS, 0)
    if model.tracers is not None:
        made.ratio = model.tracers.mixing_ratio()
    return made
