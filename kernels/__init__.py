"""Warp kernels of the shallow-water model; this folder imports no other folder of the package."""

from swe_sphere.kernels.define import Register, lanes_of, specialise
from swe_sphere.kernels.local import tendency_kernels
from swe_sphere.kernels.terms import Terms

__all__ = ["Register", "Terms", "lanes_of", "specialise", "tendency_kernels"]
