"""Spectral-element shallow-water model on the cubed sphere.

Kept empty on purpose, so that `import swe_sphere` costs nothing: import what you need from the
sub-packages, e.g. `from swe_sphere.testcases import get_scene`.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"
"""Version of the package, the same as in pyproject.toml."""
