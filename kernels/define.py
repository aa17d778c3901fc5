"""How kernels and their structures are defined."""

import functools
from typing import Any

import warp as wp

kernel: Any = functools.partial(
    wp.kernel, module="unique", enable_backward=False, module_options={"max_unroll": 1}
)
"""Decorator of all kernels.  Kernels with loops compile for long if the loops are unrolled.
Compiler flags stay at their defaults: a process compiles Warp's own headers, for 3 s, for each set
of flags."""


def struct_of(name: str, members: dict[str, Any]) -> Any:
    """Return a Warp structure with these members and their types."""
    return wp.struct(type(name, (), {"__annotations__": members}))
