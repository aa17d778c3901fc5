"""What a kernel is compiled for: the terms, and the arrays those terms need.

A term that is not named here leaves no array, no load and no branch in the generated code.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import warp as wp

from swe_sphere.kernels.formulas import algebra
from swe_sphere.kernels.stages import stage_struct

LANE_BYTES = 64


@dataclass(frozen=True)
class Terms:
    """The terms compiled into one kernel.

    `advection`, `pressure`: the vector-invariant momentum equation and the continuity equation,
    with the kinetic energy and relative vorticity, and the surface height, respectively.
    `bottom`: the surface height is depth plus bottom height.
    `wind`: the wind is prescribed and depth, which it carries, is the only unknown.
    `diffusion`: weak Laplacian of the state, times the coefficient `nu`.
    `biharmonic`: weak Laplacian of a given Laplacian (`laplacian` array), times minus `nu4`.
    `still`: with a prescribed wind, diffusion alone.
    `poisson`: the skew form, in which the vorticity of the state, with the Bernoulli function in
    the place of depth, turns the wind of `base`, which carries the depth of `base`.
    `tangent`: the exact derivative of all of these at the state `base`, applied to a direction.
    `momentum`: the momentum equation alone, with two fields as its result.
    """

    advection: bool = False
    pressure: bool = False
    bottom: bool = False
    wind: bool = False
    diffusion: bool = False
    biharmonic: bool = False
    tangent: bool = False
    still: bool = False
    poisson: bool = False
    momentum: bool = False

    @property
    def unknowns(self) -> int:
        """Fields a node carries: depth alone under a prescribed wind, else two winds and depth."""
        return 1 if self.wind else 3

    @property
    def dynamics(self) -> bool:
        """Whether there is anything but diffusion."""
        return self.gradient or (self.wind and not self.still)

    @property
    def diffuses(self) -> bool:
        """Whether any weak Laplacian is taken."""
        return self.diffusion or self.biharmonic

    @property
    def gradient(self) -> bool:
        """Whether the gradient of a Bernoulli function drives the wind."""
        return self.advection or self.pressure


NO_TERMS = Terms()


def lanes_of(real: type) -> int:
    """Elements handled side by side in one SIMD register for the number type `real`."""
    size: int = wp.types.type_size_in_bytes(real)
    return LANE_BYTES // size


def geometry_struct(t: SimpleNamespace, fluxes: bool, steps: bool) -> type:
    """Warp structure with just the arrays and scalars that kernels of these types read.

    fluxes, steps: whether those of diffusion are kept, and whether rates are left by a stage.
    Arrays on element nodes have shape (group, np*np, ...), arrays on unique nodes (unknowns*N,).
    """
    terms, value, real, direct, point = t.terms, t.value, t.real, t.direct, t.point
    on_nodes = wp.array(dtype=real)
    members: dict[str, object] = {
        "nodes": wp.array2d(dtype=t.index),
        "basis": wp.array3d(dtype=value),
        "derivative": wp.array2d(dtype=real),
        "weight": wp.array2d(dtype=real),
        "size": wp.int32,
    }
    optional = {
        "gravity": (terms.pressure and not terms.poisson, real),
        "bottom": (terms.bottom and not (terms.tangent or terms.poisson), on_nodes),
        "wind": (terms.wind and not terms.still, on_nodes),
        "base": ((terms.tangent or terms.poisson) and terms.gradient, on_nodes),
        "inverse_jacobian": (terms.diffuses, wp.array2d(dtype=value)),
        "nu": (terms.diffusion, real),
        "nu4": (terms.biharmonic, real),
        "laplacian": (terms.biharmonic, on_nodes),
        "fluxes": (terms.diffuses and fluxes, wp.array3d(dtype=value)),
        "work": (value is not real, wp.uint64),
        "whole": (direct, wp.int32),
        "inverse_area": (direct, on_nodes),
        "stage": (direct and steps, stage_struct(real)),
        "point": (point is not None, point and point.structure),
    }
    members |= {name: kind for name, (wanted, kind) in optional.items() if wanted}
    geometry: type = wp.struct(type("Geometry", (), {"__annotations__": members}))
    return geometry


def kernel_types(
    np_: int,
    real: type,
    shape: str,
    terms: Terms = NO_TERMS,
    direct: bool = False,
    done: type | None = None,
    whole: bool = True,
    point: SimpleNamespace | None = None,
    damped: bool = False,
) -> SimpleNamespace:
    """Types of kernels on element nodes.

    done: where `direct` kernels put what they finish, if not in a vector.
    whole: see `algebra`.  point: the `pointwise_sum` that they add.  damped: whether a loss is
    added to rates, see `levels_struct`.

    `shape` is "element" (a thread a group of elements) or "node".  The namespace has `terms`, `np`,
    `real`, `lanes`, `value`, `index`, the `geometry`, the arrays `vector` (of nodes) and `local`
    (groups, np*np, fields), the products `ops`, and the types `rows(k)` of k values side by side,
    a plain one for k = 1, and `struct(name, names)` of values with names.
    """
    lanes = lanes_of(real) if shape == "element" else 1
    value = wp.types.vector(lanes, real) if lanes > 1 else real
    index = wp.types.vector(lanes, wp.int32) if lanes > 1 else wp.int32

    def rows(count: int) -> type:
        if count == 1:
            return value
        kind = wp.types.matrix((count, lanes), real) if lanes > 1 else wp.types.vector(count, real)
        return cast(type, kind)

    def struct(name: str, names: Iterable[str]) -> type:
        made: type = wp.struct(type(name, (), {"__annotations__": dict.fromkeys(names, value)}))
        return made

    vector = wp.array(dtype=real)
    t = SimpleNamespace(
        terms=terms,
        np=np_,
        real=real,
        lanes=lanes,
        value=value,
        index=index,
        vector=vector,
        local=wp.array3d(dtype=value),
        direct=direct,
        point=point,
        damped=damped,
        done=done or vector,
        ops=algebra(value, index, real, lanes, whole),
        rows=rows,
        struct=struct,
    )
    t.geometry = geometry_struct(t, shape == "node", done is None)
    return t
