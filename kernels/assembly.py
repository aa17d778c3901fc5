"""Direct stiffness summation (DSS) as a gather, and the terms that need no derivative.

Each unique node adds its contributors in a fixed order: no atomics, so results repeat bit for bit
on any device.  Meshes number their nodes by the count of contributors (one, two, more), so that the
branches cost nothing; a node of three has a fourth in a place that holds zero.  A pointwise term
commutes with the mass-weighted average, so it is added here, once a unique node instead of once an
element node.  Arrays are arguments of their own and not members of a structure: only then does Warp
compile a path for contiguous arrays, which is faster on a CPU.
"""

import functools
from typing import no_type_check

import warp as wp

CONTRIBUTORS = 4
OPTIONS = {"max_unroll": 1}
"""Of all kernels with loops, which compile for long when they are unrolled.  Compiler flags are
left alone: each set of them costs a process 3 s for Warp's own headers."""
Contributors = wp.types.vector(CONTRIBUTORS, wp.int32)
"""Places of a node's first field in the local tendencies, -1 for a contributor it lacks."""


def gather_sum(real: type) -> wp.Function:
    """Warp function (local, places, offset): sum of the contributors of one field."""

    @no_type_check
    @wp.func
    def gather(local: wp.array(dtype=real), at: Contributors, offset: int):
        total = local[at[0] + offset]
        if at[1] >= 0:
            total += local[at[1] + offset]
            if at[2] >= 0:
                total += local[at[2] + offset] + local[at[3] + offset]
        return total

    return gather


@functools.cache
def assembly_kernel(unknowns: int, real: type, rotation: bool) -> wp.Kernel:
    """Kernel from local tendencies (entries,) to the tendency (unknowns*N,) of the unique nodes.

    Arguments: `places` (N,), `inverse_area` (N,), the distance `stride` between two fields in the
    local tendencies, N, the local tendencies, with rotation the Coriolis parameter (N,) [s-1] and
    the state, and the result.
    """
    vector = wp.array(dtype=real)
    gather = gather_sum(real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        local: vector,
        out: vector,
    ):
        node = wp.tid()
        at = places[node]
        scale = inverse_area[node]
        out[node] = scale * gather(local, at, 0)
        if wp.static(unknowns == 3):
            out[size + node] = scale * gather(local, at, stride)
            out[2 * size + node] = scale * gather(local, at, 2 * stride)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble_rotating(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        local: vector,
        coriolis: vector,
        x: vector,
        out: vector,
    ):
        node = wp.tid()
        at = places[node]
        scale = inverse_area[node]
        f = coriolis[node]
        out[node] = scale * gather(local, at, 0) + f * x[size + node]
        out[size + node] = scale * gather(local, at, stride) - f * x[node]
        out[2 * size + node] = scale * gather(local, at, 2 * stride)

    return assemble_rotating if rotation else assemble
