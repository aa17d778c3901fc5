"""How kernels, device functions and their structures are defined."""

import functools
from typing import TYPE_CHECKING, Any

import warp as wp

__all__ = ["func", "kernel", "struct_of"]

if TYPE_CHECKING:  # annotations of what Warp compiles are Warp types
    from typing import no_type_check as func
    from typing import no_type_check as kernel
else:
    func = wp.func
    kernel = functools.partial(
        wp.kernel, module="unique", enable_backward=False, module_options={"max_unroll": 1}
    )
    """Decorator of all kernels.  Kernels with loops compile for long if the loops are unrolled.
    Compiler flags stay at their defaults: for each set of flags a process compiles Warp's own
    headers, which takes 3 s."""


def struct_of(name: str, members: dict[str, Any]) -> Any:
    """Return a Warp structure with these members and their types."""
    return wp.struct(type(name, (), {"__annotations__": members}))
