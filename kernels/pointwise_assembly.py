"""DSS together with the terms that act at a point: rotation, forcing, effects without derivatives.

Of a scene without any of them, the structure is empty and only the sum is compiled.
"""

import functools
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS, Contributors, means_of
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum
from swe_sphere.kernels.stages import leave_of, node_types, stage_struct


@functools.cache
def pointwise_kernel(
    unknowns: int, real: type, point: Pointwise, lanes: int = 1
) -> SimpleNamespace:
    """Kernels for the tendency of the unique nodes with these terms, and their `structure`.

    Over nodes, or on a CPU over runs of `lanes` nodes, which fill a register.  `assembly`: from
    local tendencies (entries,), with `places` (N,), `inverse_area` (N,), the distance `stride`
    between two fields in them, the first node to be written, N, the local tendencies, the
    structure, the state, the `stage_struct` and the result (unknowns*N,).  `alone` (N, structure,
    state, stage, result): where there are no terms with derivatives and so nothing to assemble.
    """
    vector, (_, rows) = wp.array(dtype=real), node_types(real, lanes, unknowns)
    means, added = means_of(unknowns, real, lanes), pointwise_sum(unknowns, real, point, lanes)
    leave, stage = leave_of(rows, real, lanes, unknowns), stage_struct(real)
    structure, add = added.structure, added.add

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble_pointwise(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        first: int,
        size: int,
        local: vector,
        c: structure,
        x: vector,
        s: stage,
        out: vector,
    ):
        node = first + lanes * wp.tid()
        r = means(places, inverse_area, stride, node, local)
        leave(s, node, size, add(c, node, size, x, r), out)

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def pointwise_alone(size: int, c: structure, x: vector, s: stage, out: vector):
        node = lanes * wp.tid()
        if wp.static(rows is real):  # noqa: SIM108 - a static choice takes an if
            r = real(0.0)
        else:
            r = rows()
        leave(s, node, size, add(c, node, size, x, r), out)

    return SimpleNamespace(assembly=assemble_pointwise, alone=pointwise_alone, structure=structure)
