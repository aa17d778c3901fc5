"""Cubed-sphere spectral-element meshes and interpolation from them."""

from .interpolate import Interpolator
from .mesh import Mesh, build_mesh

__all__ = ["Interpolator", "Mesh", "build_mesh"]
