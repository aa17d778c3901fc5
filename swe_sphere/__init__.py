"""Spectral-element shallow-water model on the cubed sphere.

`Simulation` runs a scene, `sweep` compares steppers, `open_run` reads the file of a run; custom
scenes, effects, steppers and preconditioners derive from the classes here. Every name is imported
when it is first used, so that `import swe_sphere` is fast.
"""

import os

import lazy_loader

__version__ = "0.1.0"
"""Version of the package, the same as in pyproject.toml."""

_beside = os.path.dirname(os.path.dirname(__file__))  # noqa: PTH120 - pathlib is slower to import
if os.path.isfile(os.path.join(_beside, "pyproject.toml")):  # noqa: PTH113, PTH118
    # Python started in the source tree finds this folder before the installed package; there
    # `kernels` and `testcases` stand beside it, not inside
    __path__.append(_beside)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
