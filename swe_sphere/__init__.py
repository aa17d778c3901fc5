"""Spectral-element shallow-water model on the cubed sphere.

`Simulation` runs a scene; `sweep` compares steppers; `open_run` reads what a run wrote.  What
stands here is imported when it is first asked for, so that `import swe_sphere` costs nothing.
"""

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swe_sphere.analysis.accessor import open_run
    from swe_sphere.equations.scene import Scene
    from swe_sphere.mesh import Mesh
    from swe_sphere.simulation.simulation import Simulation
    from swe_sphere.steppers import list_steppers
    from swe_sphere.studies.cases import verify
    from swe_sphere.studies.sweep import sweep
    from swe_sphere.testcases import list_scenes

__all__ = [
    "Mesh", "Scene", "Simulation", "__version__", "list_scenes", "list_steppers", "open_run",
    "sweep", "verify",
]  # fmt: skip

__version__ = "0.1.0"
"""Version of the package, the same as in pyproject.toml."""

_PLACES = {
    "Mesh": "mesh",
    "Scene": "equations.scene",
    "Simulation": "simulation.simulation",
    "list_scenes": "testcases",
    "list_steppers": "steppers",
    "open_run": "analysis.accessor",
    "sweep": "studies.sweep",
    "verify": "studies.cases",
}

_beside = os.path.dirname(os.path.dirname(__file__))  # noqa: PTH120 - pathlib is slower to import
if os.path.isfile(os.path.join(_beside, "pyproject.toml")):  # noqa: PTH113, PTH118
    # Python started in the source tree finds this folder before the installed package; there
    # `kernels` and `testcases` stand beside it, not inside
    __path__.append(_beside)


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    found: object = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
