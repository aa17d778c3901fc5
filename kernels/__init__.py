"""Warp kernels of the shallow-water model: the ground floor, which imports nothing else of ours."""

from swe_sphere.kernels.assembly import assembly_kernel
from swe_sphere.kernels.element import element_kernel
from swe_sphere.kernels.node import node_kernel
from swe_sphere.kernels.terms import Terms, lanes_of
from swe_sphere.kernels.vectors import combine_kernel

__all__ = [
    "Terms",
    "assembly_kernel",
    "combine_kernel",
    "element_kernel",
    "lanes_of",
    "node_kernel",
]
