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

from swe_sphere.kernels.access import entry_of, put_of

CONTRIBUTORS = 4
OPTIONS = {"max_unroll": 1}
"""Of all kernels with loops, which compile for long when they are unrolled.  Compiler flags are
left alone: each set of them costs a process 3 s for Warp's own headers."""
Contributors = wp.types.vector(CONTRIBUTORS, wp.int32)
"""Places of a node's first field in the local tendencies, -1 for a contributor it lacks."""


def gather_sum(real: type) -> wp.Function:
    """Warp function (local, places, offset): sum of the contributors of one field."""

    entry = entry_of(real)

    @no_type_check
    @wp.func
    def gather(local: wp.array(dtype=real), at: Contributors, offset: int):
        total = entry(local, at[0] + offset)
        if at[1] >= 0:
            total += entry(local, at[1] + offset)
            if at[2] >= 0:
                total += entry(local, at[2] + offset) + entry(local, at[3] + offset)
        return total

    return gather


@functools.cache
def assembly_kernel(unknowns: int, real: type, rotation: bool) -> wp.Kernel:
    """Kernel from local tendencies (entries,) to the tendency (unknowns*N,) of the unique nodes.

    Arguments: `places` (N,), `inverse_area` (N,), the distance `stride` between two fields in the
    local tendencies, the first node to be written, N, the local tendencies, with rotation the
    Coriolis parameter (N,) [s-1] and the state, and the result.
    """
    vector = wp.array(dtype=real)
    gather, place = gather_sum(real), entry_of(Contributors)
    entry, put = entry_of(real), put_of(real)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        first: int,
        size: int,
        local: vector,
        out: vector,
    ):
        node = first + wp.tid()
        at = place(places, node)
        scale = entry(inverse_area, node)
        put(out, node, scale * gather(local, at, 0))
        if wp.static(unknowns == 3):
            put(out, size + node, scale * gather(local, at, stride))
            put(out, 2 * size + node, scale * gather(local, at, 2 * stride))

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble_rotating(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        first: int,
        size: int,
        local: vector,
        coriolis: vector,
        x: vector,
        out: vector,
    ):
        node = first + wp.tid()
        at = place(places, node)
        scale = entry(inverse_area, node)
        f = entry(coriolis, node)
        u = scale * gather(local, at, 0) + f * entry(x, size + node)
        v = scale * gather(local, at, stride) - f * entry(x, node)
        h = scale * gather(local, at, 2 * stride)
        put(out, node, u)
        put(out, size + node, v)
        put(out, 2 * size + node, h)

    return assemble_rotating if rotation else assemble
