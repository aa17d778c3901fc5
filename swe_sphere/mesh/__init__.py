"""Cubed-sphere spectral-element meshes and interpolation from them."""

from swe_sphere.mesh.interpolate import Interpolator
from swe_sphere.mesh.mesh import Mesh, build_mesh

__all__ = ["Interpolator", "Mesh", "build_mesh"]
