"""Spectral-element shallow-water model on the cubed sphere.

`Simulation` runs a scene, `sweep` compares steppers, `open_run` reads the file of a run; custom
scenes, effects, steppers and preconditioners derive from the classes here. Every name is imported
when it is first used, so that `import swe_sphere` is fast.
"""

import os

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
    "simulation.config": ("Output",),
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
"""Names by the module that defines them; the types of the names are in __init__.pyi."""

__all__ = sorted(["__version__", *(name for names in _MODULES.values() for name in names)])

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
