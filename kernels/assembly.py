"""Direct stiffness summation (DSS) as a gather, and the terms that need no derivative.

Each unique node sums its contributors, the results of the elements that share it, in a fixed order
and without atomics, so results repeat bit for bit. Meshes number their nodes by the count of
contributors (one, two, more), so that a processor predicts the branches; a node with three of them
has a fourth that points to a zero. A pointwise term commutes with the mass-weighted average, so it
is added once per unique node instead of once per element node. Most arrays are separate arguments,
because Warp compiles its faster path for contiguous arrays on a CPU only for arguments. A thread
handles one node, or on a CPU as many consecutive nodes as fill a register.
"""

import functools
from typing import Any

import warp as wp

from swe_sphere.kernels.define import func, kernel, lanes, real, rows, vector
from swe_sphere.kernels.element import Finish
from swe_sphere.kernels.formulas import row
from swe_sphere.kernels.pointwise import Pointwise, pointwise_sum
from swe_sphere.kernels.simd.arithmetic import mul
from swe_sphere.kernels.simd.memory import Places, gather, load
from swe_sphere.kernels.simd.stages import stage, stage_store
from swe_sphere.kernels.terms import KernelTypes, geometry


@functools.cache
def assembly_kernels(unknowns: int, point: Pointwise) -> tuple[Any, Any]:
    """Return two kernels that store the tendency (unknowns*N,) of unique nodes.

    The first kernel, `assemble_pointwise`, assembles local tendencies (entries,), whose fields are
    `stride` apart, at the nodes from `first` on, and adds the pointwise terms. The second kernel
    has the arguments (N, structure, state, stage, result), for scenes without derivatives.
    """
    some, added, last = rows(unknowns), pointwise_sum(unknowns, point), unknowns - 1
    store_stage, structure, add = stage_store(unknowns), added.structure, added.add

    @kernel
    def assemble_pointwise(
        first: int, places: Places, inverse_area: vector, stride: int, size: int, local: vector,
        c: structure, x: vector, s: stage, out: vector,
    ):  # fmt: skip
        node = first + lanes * wp.tid()
        scale = load(inverse_area, node)
        r = some()
        r[0] = mul(scale, gather(local, places, node, 0))
        if wp.static(last > 0):
            r[1] = mul(scale, gather(local, places, node, stride))
            r[2] = mul(scale, gather(local, places, node, 2 * stride))
        store_stage(s, node, size, add(c, node, size, x, r), out)

    @kernel
    def pointwise_alone(size: int, c: structure, x: vector, s: stage, out: vector):
        node = lanes * wp.tid()
        store_stage(s, node, size, add(c, node, size, x, some()), out)

    return assemble_pointwise, pointwise_alone


store_stage_of_field = stage_store(1)


@kernel
def assemble_blocks(
    begin: int, places: Places, inverse_area: vector, stride: int, size: int, count: int,
    first: int, local: vector, s: stage, out: vector,
):  # fmt: skip
    """Assemble `count` local fields at nodes from `begin` on, into blocks (N,) of out[first:]."""
    node = begin + lanes * wp.tid()
    scale = load(inverse_area, node)
    for k in range(count):
        rate = row(mul(scale, gather(local, places, node, k * stride)))
        store_stage_of_field(s, first + k * size + node, 0, rate, out)


@functools.cache
def finish_rates(t: KernelTypes, fields: int) -> Finish:
    """Return the `Finish` that stores `fields` rates, plus pointwise terms if they are all."""
    assert t.point is not None
    add, store_stage, some, whole = t.point.add, stage_store(fields), rows(fields), t.terms.unknowns
    skew = t.terms.skew

    @func
    def finish(geo: geometry, x: vector, r: some, k: int, node: int, direct: vector):
        scale = load(geo.inverse_area, node)
        rate = some()
        for i in range(fields):
            rate[i] = mul(scale, r[i])
        if wp.static(fields == whole and skew):
            rate = add(geo.point, node, geo.size, geo.base, rate)
        elif wp.static(fields == whole):
            rate = add(geo.point, node, geo.size, x, rate)
        store_stage(geo.stage, node + k * geo.size, geo.size, rate, direct)

    return finish


@kernel
def drift(
    places: Places, inverse_area: vector, size: int, local: vector, tau: real, rate: vector,
    s: vector, carries: int, kept: real, path: vector,
):  # fmt: skip
    """Set h += tau (DSS of `local` / nodal area + rate) at N nodes, for depth h and wind V of s.

    The state s has at least 3N numbers. If `carries` is 1, set path = kept path + tau V (2N,) [m].
    """
    i = wp.tid()
    k = 2 * size + i
    s[k] += tau * (inverse_area[i] * gather(local, places, i, 0) + rate[k])
    if carries == 1:
        j = size + i
        path[i] = kept * path[i] + tau * s[i]
        path[j] = kept * path[j] + tau * s[j]


@kernel
def kick(
    places: Places, inverse_area: vector, stride: int, size: int, local: vector, gravity: real,
    tau: real, rate: vector, s: vector,
):  # fmt: skip
    """Set V += tau (rate - gravity DSS of `local` / nodal area) for the wind V of s at N nodes."""
    i = wp.tid()
    j = size + i
    scale = -gravity * inverse_area[i]
    s[i] += tau * (scale * gather(local, places, i, 0) + rate[i])
    s[j] += tau * (scale * gather(local, places, i, stride) + rate[j])
