"""Direct stiffness summation (DSS) as a gather, and the terms that need no derivative.

Each unique node adds its contributors in a fixed order: no atomics, so results repeat bit for bit
on any device.  Meshes number their nodes by the count of contributors (one, two, more), so that the
branches cost nothing; a node of three has a fourth in a place that holds zero.  A pointwise term
commutes with the mass-weighted average, so it is added here, once a unique node instead of once an
element node.  Arrays are arguments of their own and not members of a structure: only then does Warp
compile a path for contiguous arrays, which is faster on a CPU.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel
from swe_sphere.kernels.element import Finish
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum
from swe_sphere.kernels.simd.arithmetic import product_of
from swe_sphere.kernels.simd.memory import Contributors, gather_of, run_of
from swe_sphere.kernels.simd.register import Register
from swe_sphere.kernels.simd.stages import leave_of, stage_struct
from swe_sphere.kernels.terms import KernelTypes


@dataclass(frozen=True)
class AssemblyKernels:
    """Kernels for the tendency of the unique nodes, over nodes or runs that fill a register."""

    assembly: wp.Kernel
    """From local tendencies (entries,): arguments as in its definition, with the first node to be
    written, the distance `stride` between two fields, N, and the result (unknowns*N,)."""
    alone: wp.Kernel
    """(N, structure, state, stage, result): no terms with derivatives, so nothing to assemble."""
    structure: Any
    """Warp structure of what the pointwise terms read, empty in a scene without such terms."""


@functools.cache
def pointwise_kernel(unknowns: int, real: Any, point: Pointwise, lanes: int = 1) -> AssemblyKernels:
    """Return the kernels with these pointwise terms, for runs of `lanes` nodes."""
    register, vector, last = Register(real, lanes), wp.array(dtype=real), unknowns - 1
    rows, added = register.rows(unknowns), pointwise_sum(unknowns, register, point)
    leave, stage = leave_of(register, unknowns), stage_struct(real)
    gather, load, mul = gather_of(register), run_of(register), product_of(register)
    structure, add, place = added.structure, added.add, wp.array(dtype=Contributors)

    @func
    def means(places: place, inverse_area: vector, stride: int, node: int, local: vector):
        scale = load(inverse_area, node)
        r = rows()
        r[0] = mul(scale, gather(local, places, node, 0))
        if wp.static(last > 0):
            r[1] = mul(scale, gather(local, places, node, stride))
            r[2] = mul(scale, gather(local, places, node, 2 * stride))
        return r

    @kernel
    def assemble_pointwise(
        first: int, places: place, inverse_area: vector, stride: int, size: int, local: vector,
        c: structure, x: vector, s: stage, out: vector,
    ):  # fmt: skip
        node = first + lanes * wp.tid()
        r = means(places, inverse_area, stride, node, local)
        leave(s, node, size, add(c, node, size, x, r), out)

    @kernel
    def pointwise_alone(size: int, c: structure, x: vector, s: stage, out: vector):
        node = lanes * wp.tid()
        leave(s, node, size, add(c, node, size, x, rows()), out)

    return AssemblyKernels(assemble_pointwise, pointwise_alone, structure)


def finish_rates(t: KernelTypes, fields: int) -> Finish:
    """Return the `Finish` that leaves rates of so many fields, with the pointwise terms added."""
    assert t.point is not None
    load, mul, add = run_of(t.register), t.metric.mul, t.point.add
    rows, leave, whole = t.register.rows(fields), leave_of(t.register, fields), t.terms.unknowns

    @func
    def finish(geo: t.geometry, x: t.vector, r: rows, k: int, node: int, done: t.vector):
        scale = load(geo.inverse_area, node)
        rate = rows()
        for i in range(fields):
            rate[i] = mul(scale, r[i])
        if wp.static(fields == whole and t.terms.poisson):
            rate = add(geo.point, node, geo.size, geo.base, rate)
        elif wp.static(fields == whole):
            rate = add(geo.point, node, geo.size, x, rate)
        leave(geo.stage, node + k * geo.size, geo.size, rate, done)

    return finish
