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

from swe_sphere.kernels.access import entry_of, gather_run, run_of
from swe_sphere.kernels.registers import product_of
from swe_sphere.kernels.stages import leave_of, node_types, stage_struct

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
def assembly_kernel(unknowns: int, real: type, rotation: bool, lanes: int = 1) -> wp.Kernel:
    """Kernel from local tendencies (entries,) to the tendency (unknowns*N,) of the unique nodes.

    Over nodes, or on a CPU over runs of `lanes` nodes, which fill a register.  Arguments: `places`
    (N,), `inverse_area` (N,), the distance `stride` between two fields in the local tendencies, the
    first node to be written, N, the local tendencies, with rotation the Coriolis parameter (N,)
    [s-1] and the state, the `stage_struct` and the result.
    """
    place, vector, stage = wp.array(dtype=Contributors), wp.array(dtype=real), stage_struct(real)
    value, rows = node_types(real, lanes, unknowns)
    means, load = means_of(unknowns, real, lanes), run_of(value, real, lanes)
    leave, mul = leave_of(rows, real, lanes, unknowns), run_product(real, lanes)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble(
        places: place,
        inverse_area: vector,
        stride: int,
        first: int,
        size: int,
        local: vector,
        s: stage,
        out: vector,
    ):
        node = first + lanes * wp.tid()
        leave(s, node, size, means(places, inverse_area, stride, node, local), out)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble_rotating(
        places: place,
        inverse_area: vector,
        stride: int,
        first: int,
        size: int,
        local: vector,
        coriolis: vector,
        x: vector,
        s: stage,
        out: vector,
    ):
        node = first + lanes * wp.tid()
        r = means(places, inverse_area, stride, node, local)
        f = load(coriolis, node)
        r[0] = r[0] + mul(f, load(x, size + node))
        r[1] = r[1] - mul(f, load(x, node))
        leave(s, node, size, r, out)

    return assemble_rotating if rotation else assemble


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
