"""Warp kernels of the shallow-water model: the ground floor, which imports nothing else of ours."""

from swe_sphere.kernels.local import tendency_kernel
from swe_sphere.kernels.simd.register import lanes_of
from swe_sphere.kernels.terms import Terms
from swe_sphere.kernels.vectors import combine_kernel

__all__ = [
    "Terms",
    "combine_kernel",
    "lanes_of",
    "tendency_kernel",
]
