"""DSS together with the terms that act at a point and need an array or coefficient of their own.

A scene with forcing, drag or relaxation gets this kernel in the place of the plain ones of
`assembly.py`, with a structure that holds what its own terms read and nothing else.
"""

import functools
from dataclasses import dataclass, replace
from types import SimpleNamespace

import warp as wp

from .assembly import OPTIONS, Contributors, gather_sum


@dataclass(frozen=True)
class Pointwise:
    """The terms of one node's state alone, compiled into one assembly kernel.

    `rotation`: -f k x V.  `forcing`: a given tendency of every unknown, independent of the state.
    """

    rotation: bool = False
    forcing: bool = False

    @property
    def plain(self) -> bool:
        """Whether a kernel of `assembly.py` has all the terms."""
        return replace(self, rotation=False) == Pointwise()


def pointwise_struct(point: Pointwise, real: type) -> type:
    """Warp structure with just what the terms read, arrays over nodes (N,) or unknowns*N."""
    vector = wp.array(dtype=real)
    optional = {
        "coriolis": (point.rotation, vector),
        "forcing": (point.forcing, vector),
    }
    members = {name: kind for name, (wanted, kind) in optional.items() if wanted}
    return wp.struct(type("Pointwise", (), {"__annotations__": members}))


@functools.cache
def pointwise_kernel(unknowns: int, real: type, point: Pointwise) -> SimpleNamespace:
    """Kernel from local tendencies to the tendency of the unique nodes, and its `structure`.

    Arguments as in `assembly_kernel`, with the structure and the state before the result, whatever
    the terms.
    """
    last, vector = unknowns - 1, wp.array(dtype=real)
    gather, structure = gather_sum(real), pointwise_struct(point, real)

    @wp.func
    def pointwise_depth(c: structure, at: int):
        r = real(0.0)
        if wp.static(point.forcing):
            r += c.forcing[at]
        return r

    @wp.func
    def pointwise_wind(c: structure, at: int):
        r = real(0.0)
        if wp.static(point.forcing):
            r += c.forcing[at]
        return r

    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def assemble_pointwise(
        places: wp.array(dtype=Contributors),
        inverse_area: vector,
        stride: int,
        size: int,
        local: vector,
        c: structure,
        x: vector,
        out: vector,
    ):
        i = wp.tid()
        at = places[i]
        scale = inverse_area[i]
        k = last * size + i
        out[k] = scale * gather(local, at, last * stride) + pointwise_depth(c, k)
        if wp.static(unknowns == 3):
            j = size + i
            du = scale * gather(local, at, 0) + pointwise_wind(c, i)
            dv = scale * gather(local, at, stride) + pointwise_wind(c, j)
            if wp.static(point.rotation):
                du += c.coriolis[i] * x[j]
                dv -= c.coriolis[i] * x[i]
            out[i] = du
            out[j] = dv

    return SimpleNamespace(kernel=assemble_pointwise, structure=structure)
