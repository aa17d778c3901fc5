"""DSS together with the terms that act at a point and need an array or coefficient of their own.

A scene with forcing, drag or relaxation gets these kernels in the place of the plain ones of
`assembly.py`, with a structure that holds what its own terms read and nothing else.
"""

import functools
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from swe_sphere.kernels.assembly import OPTIONS, Contributors, gather_sum


@dataclass(frozen=True)
class Pointwise:
    """The terms of one node's state alone, compiled into one assembly kernel.

    `rotation`: -f k x V.  `forcing`: a given tendency of every unknown, independent of the state.
    `linear_drag`: -r V.  `quadratic_drag`: -c |V| V.  `relaxation`: (h_eq - h) rate.
    `tangent`: the exact derivative of all of these at the state `base`, applied to a direction.
    """

    rotation: bool = False
    forcing: bool = False
    linear_drag: bool = False
    quadratic_drag: bool = False
    relaxation: bool = False
    tangent: bool = False

    @property
    def plain(self) -> bool:
        """Whether a kernel of `assembly.py` has all the terms."""
        return replace(self, rotation=False, tangent=False) == Pointwise()

    @property
    def drag(self) -> bool:
        """Whether the wind is slowed down."""
        return self.linear_drag or self.quadratic_drag

    @property
    def speed(self) -> bool:
        """Whether a tangent has to know the wind it is taken at."""
        return self.quadratic_drag and self.tangent


def pointwise_struct(point: Pointwise, real: type) -> type:
    """Warp structure with just what the terms read, arrays over nodes (N,) or unknowns*N."""
    vector = wp.array(dtype=real)
    optional = {
        "coriolis": (point.rotation, vector),
        "forcing": (point.forcing, vector),
        "linear_drag": (point.linear_drag, real),
        "quadratic_drag": (point.quadratic_drag, real),
        "base": (point.speed, vector),
        "relaxation_rate": (point.relaxation, real),
        "equilibrium": (point.relaxation and not point.tangent, vector),
    }
    members = {name: kind for name, (wanted, kind) in optional.items() if wanted}
    structure: type = wp.struct(type("Pointwise", (), {"__annotations__": members}))
    return structure


@functools.cache
def pointwise_kernel(unknowns: int, real: type, point: Pointwise) -> SimpleNamespace:
    """Kernels for the tendency of the unique nodes with these terms, and their `structure`.

    `assembly`: from local tendencies; arguments as in `assembly_kernel`, with the structure and the
    state before the result, whatever the terms.  `alone` (N, structure, state, result): where there
    are no terms with derivatives and so nothing to assemble.
    """
    last, vector = unknowns - 1, wp.array(dtype=real)
    structure, gather = pointwise_struct(point, real), gather_sum(real)
    of_wind, of_depth = _wind_terms(structure, real, point), _depth_terms(structure, real, point)

    @no_type_check
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
        out[k] = scale * gather(local, at, last * stride) + of_depth(c, i, k, x)
        if wp.static(unknowns == 3):
            j = size + i
            wind = of_wind(c, i, j, x)
            out[i] = scale * gather(local, at, 0) + wind[0]
            out[j] = scale * gather(local, at, stride) + wind[1]

    @no_type_check
    @wp.kernel(module="unique", enable_backward=False, module_options=OPTIONS)
    def pointwise_alone(size: int, c: structure, x: vector, out: vector):
        i = wp.tid()
        k = last * size + i
        out[k] = of_depth(c, i, k, x)
        if wp.static(unknowns == 3):
            j = size + i
            wind = of_wind(c, i, j, x)
            out[i] = wind[0]
            out[j] = wind[1]

    return SimpleNamespace(assembly=assemble_pointwise, alone=pointwise_alone, structure=structure)


def _depth_terms(structure: type, real: type, point: Pointwise) -> wp.Function:
    """Rate of change of the depth x[k] at node i."""

    @no_type_check
    @wp.func
    def of_depth(c: structure, i: int, k: int, x: wp.array(dtype=real)):
        r = real(0.0)
        if wp.static(point.forcing):
            r += c.forcing[k]
        if wp.static(point.relaxation and point.tangent):
            r -= c.relaxation_rate * x[k]
        elif wp.static(point.relaxation):
            r += c.relaxation_rate * (c.equilibrium[i] - x[k])
        return r

    return of_depth


def _wind_terms(structure: type, real: type, point: Pointwise) -> wp.Function:
    """Rate of change of the wind (x[i], x[j]) at node i."""
    pair = wp.types.vector(2, real)

    @no_type_check
    @wp.func
    def of_wind(c: structure, i: int, j: int, x: wp.array(dtype=real)):
        r = pair()
        if wp.static(point.forcing):
            r += pair(c.forcing[i], c.forcing[j])
        if wp.static(point.rotation or point.drag):
            wind = pair(x[i], x[j])
        if wp.static(point.rotation):
            f = c.coriolis[i]
            r += pair(f * wind[1], -f * wind[0])
        if wp.static(point.linear_drag):
            r -= c.linear_drag * wind
        if wp.static(point.speed):
            base = pair(c.base[i], c.base[j])
            speed = wp.length(base)
            # still air has no direction, and no tangent either
            along = wp.dot(base, wind) / wp.max(speed, real(1.0e-30))
            r -= c.quadratic_drag * (speed * wind + along * base)
        elif wp.static(point.quadratic_drag):
            r -= c.quadratic_drag * wp.length(wind) * wind
        return r

    return of_wind
