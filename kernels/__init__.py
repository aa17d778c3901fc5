"""Warp kernels of the shallow-water model: the ground floor, which imports nothing else of ours."""

from .assembly import assembly_kernel
from .element import element_kernel
from .node import node_kernel
from .terms import Terms, lanes_of
from .vectors import combine_kernel

__all__ = [
    "Terms",
    "assembly_kernel",
    "combine_kernel",
    "element_kernel",
    "lanes_of",
    "node_kernel",
]
