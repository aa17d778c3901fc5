"""Direct stiffness summation (DSS) as a gather, and the terms that need no derivative.

Each unique node adds its contributors in a fixed order: no atomics, so results repeat bit for bit
on any device.  Meshes number their nodes by the count of contributors (one, two, more), so that the
branches cost nothing; a node of three has a fourth in a place that holds zero.  A pointwise term
commutes with the mass-weighted average, so it is added here, once a unique node instead of once an
element node.  Arrays are arguments of their own and not members of a structure: only then does Warp
compile a path for contiguous arrays, which is faster on a CPU.
"""

import functools
from typing import Any, no_type_check

import warp as wp

from swe_sphere.kernels.access import gather_run, run_of
from swe_sphere.kernels.registers import product_of
from swe_sphere.kernels.stages import node_types

CONTRIBUTORS = 4
OPTIONS = {"max_unroll": 1}
"""Of all kernels with loops, which compile for long when they are unrolled.  Compiler flags are
left alone: each set of them costs a process 3 s for Warp's own headers."""
Contributors = wp.types.vector(CONTRIBUTORS, wp.int32)
"""Places of a node's first field in the local tendencies, -1 for a contributor it lacks."""


@functools.cache
def means_of(unknowns: int, real: type, lanes: int) -> Any:
    """Warp function (places, inverse_area, stride, node, local): DSS of a node, or of a run."""
    place, vector = wp.array(dtype=Contributors), wp.array(dtype=real)
    value, rows = node_types(real, lanes, unknowns)
    gather, load = gather_run(value, Contributors, real, lanes), run_of(value, real, lanes)
    mul = run_product(real, lanes)

    @no_type_check
    @wp.func
    def means(places: place, inverse_area: vector, stride: int, node: int, local: vector):
        scale = load(inverse_area, node)
        if wp.static(unknowns == 1):
            return mul(scale, gather(local, places, node, 0))
        else:
            r = rows()
            r[0] = mul(scale, gather(local, places, node, 0))
            r[1] = mul(scale, gather(local, places, node, stride))
            r[2] = mul(scale, gather(local, places, node, 2 * stride))
            return r

    return means


def run_product(real: type, lanes: int) -> Any:
    """Warp function (p, q): the product of two numbers, or of two runs."""
    return product_of(node_types(real, lanes)[0], real, lanes) if lanes > 1 else wp.mul
