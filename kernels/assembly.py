"""Direct stiffness summation (DSS) as a gather, and the terms that need no derivative.

Each unique node adds its contributors in a fixed order: no atomics, so results repeat bit for bit
on any device.  A pointwise term commutes with the mass-weighted average, so it is added here, once
a unique node instead of once an element node.
"""

from types import SimpleNamespace

import warp as wp


def assembly_kernel(unknowns: int, real: type, rotation: bool) -> SimpleNamespace:
    """Kernel (struct, local (entries,), state, out): tendency of each unique node.

    The structure holds `offsets` (N+1,), `entries` (positions of the contributors' first field in
    the local tendencies), `stride` (distance between two fields there), `inverse_area` (N,) and,
    with rotation, the Coriolis parameter `coriolis` (N,) [s-1].
    """
    members: dict[str, object] = {
        "offsets": wp.array(dtype=wp.int32),
        "entries": wp.array(dtype=wp.int32),
        "stride": wp.int32,
        "size": wp.int32,
        "inverse_area": wp.array(dtype=real),
    }
    if rotation:
        members["coriolis"] = wp.array(dtype=real)
    nodal = wp.struct(type("Nodal", (), {"__annotations__": members}))
    vector = wp.array(dtype=real)

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def assemble(nod: nodal, local: vector, x: vector, out: vector):
        node = wp.tid()
        start = nod.offsets[node]
        end = nod.offsets[node + 1]
        scale = nod.inverse_area[node]
        if wp.static(unknowns == 1):
            h = real(0.0)
            for k in range(start, end):
                h += local[nod.entries[k]]
            out[node] = scale * h
        else:
            u = real(0.0)
            v = real(0.0)
            h = real(0.0)
            for k in range(start, end):
                at = nod.entries[k]
                u += local[at]
                v += local[at + nod.stride]
                h += local[at + 2 * nod.stride]
            u *= scale
            v *= scale
            if wp.static(rotation):
                u += nod.coriolis[node] * x[nod.size + node]
                v -= nod.coriolis[node] * x[node]
            out[node] = u
            out[nod.size + node] = v
            out[2 * nod.size + node] = scale * h

    return SimpleNamespace(kernel=assemble, structure=nodal)
