"""Cubed-sphere spectral-element meshes and interpolation from them."""

from swe_sphere.mesh.interpolate import Interpolator
from swe_sphere.mesh.mesh import Mesh

__all__ = ["Interpolator", "Mesh"]
