"""Spectral-element shallow-water model on the cubed sphere.

Kept empty on purpose, so that `import swe_sphere` costs nothing: import what you need from the
sub-packages, e.g. `from swe_sphere.testcases import get_scene`.
"""

import os

__all__ = ["__version__"]

__version__ = "0.1.0"
"""Version of the package, the same as in pyproject.toml."""

_beside = os.path.dirname(os.path.dirname(__file__))  # noqa: PTH120 - pathlib is slower to import
if os.path.isfile(os.path.join(_beside, "pyproject.toml")):  # noqa: PTH113, PTH118
    # Python started in the source tree finds this folder before the installed package; there
    # `kernels` and `testcases` stand beside it, not inside
    __path__.append(_beside)
