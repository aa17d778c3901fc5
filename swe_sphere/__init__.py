"""Spectral-element shallow-water model on the cubed sphere.

`Simulation` runs a scene, `sweep` compares steppers, `open_run` reads the file of a run; custom
scenes, effects, steppers and preconditioners derive from the classes here.  Every name is imported
when it is first used, so that `import swe_sphere` is fast.
"""

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swe_sphere.analysis.accessor import open_run
    from swe_sphere.equations.effects import (
        DYNAMICS,
        MASSES,
        Effect,
        Orography,
        PointwiseEffect,
        Rotation,
        Tracers,
    )
    from swe_sphere.equations.scene import Scene
    from swe_sphere.errors import ConfigError
    from swe_sphere.mesh import Mesh
    from swe_sphere.planet import EARTH, Planet
    from swe_sphere.simulation.diagnostics import diagnostic
    from swe_sphere.simulation.observers import Observer, every
    from swe_sphere.simulation.simulation import Simulation
    from swe_sphere.solvers.preconditioners import Preconditioner
    from swe_sphere.steppers import Stepper, get_stepper, list_steppers
    from swe_sphere.steppers.dirk import DiagonallyImplicit
    from swe_sphere.steppers.imex_runge_kutta import ImexRungeKutta
    from swe_sphere.steppers.runge_kutta import RungeKutta
    from swe_sphere.studies.cases import verify
    from swe_sphere.studies.sweep import sweep
    from swe_sphere.testcases import get_scene, list_scenes

__all__ = [
    "DYNAMICS", "EARTH", "MASSES", "ConfigError", "DiagonallyImplicit", "Effect", "ImexRungeKutta",
    "Mesh", "Observer", "Orography", "Planet", "PointwiseEffect", "Preconditioner", "Rotation",
    "RungeKutta", "Scene", "Simulation", "Stepper", "Tracers", "__version__", "diagnostic", "every",
    "get_scene", "get_stepper", "list_scenes", "list_steppers", "open_run", "sweep", "verify",
]  # fmt: skip

__version__ = "0.1.0"
"""Version of the package, the same as in pyproject.toml."""

_MODULES = {
    "analysis.accessor": ("open_run",),
    "equations.effects": (
        "DYNAMICS", "MASSES", "Effect", "Orography", "PointwiseEffect", "Rotation", "Tracers",
    ),
    "equations.scene": ("Scene",),
    "errors": ("ConfigError",),
    "mesh": ("Mesh",),
    "planet": ("EARTH", "Planet"),
    "simulation.diagnostics": ("diagnostic",),
    "simulation.observers": ("Observer", "every"),
    "simulation.simulation": ("Simulation",),
    "solvers.preconditioners": ("Preconditioner",),
    "steppers": ("Stepper", "get_stepper", "list_steppers"),
    "steppers.dirk": ("DiagonallyImplicit",),
    "steppers.imex_runge_kutta": ("ImexRungeKutta",),
    "steppers.runge_kutta": ("RungeKutta",),
    "studies.cases": ("verify",),
    "studies.sweep": ("sweep",),
    "testcases": ("get_scene", "list_scenes"),
}  # fmt: skip
"""Names by the module that defines them."""

_beside = os.path.dirname(os.path.dirname(__file__))  # noqa: PTH120 - pathlib is slower to import
if os.path.isfile(os.path.join(_beside, "pyproject.toml")):  # noqa: PTH113, PTH118
    # Python started in the source tree finds this folder before the installed package; there
    # `kernels` and `testcases` stand beside it, not inside
    __path__.append(_beside)


def __getattr__(name: str) -> object:
    place = next((module for module, names in _MODULES.items() if name in names), None)
    if place is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    found: object = getattr(import_module(f"{__name__}.{place}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
