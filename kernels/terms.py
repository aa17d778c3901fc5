"""What a kernel is compiled for: the terms, and the arrays and types that these terms need.

A term that is not declared here adds no array, no load and no branch to the generated code.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import warp as wp

from swe_sphere.kernels.define import struct_of
from swe_sphere.kernels.metric import Metric, metric_of
from swe_sphere.kernels.pointwise import PointwiseSum
from swe_sphere.kernels.simd.memory import load_of
from swe_sphere.kernels.simd.register import Register, lanes_of
from swe_sphere.kernels.simd.stages import levels_struct, stage_struct


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
        """Number of fields: depth alone under a prescribed wind, else two winds and depth."""
        return 1 if self.wind else 3

    @property
    def dynamics(self) -> bool:
        """Return whether there is a term other than diffusion."""
        return self.gradient or (self.wind and not self.still)

    @property
    def diffuses(self) -> bool:
        """Return whether a weak Laplacian is computed."""
        return self.diffusion or self.biharmonic

    @property
    def gradient(self) -> bool:
        """Whether the gradient of a Bernoulli function drives the wind."""
        return self.advection or self.pressure

    @property
    def linear(self) -> bool:
        """Return whether the terms are linear, with coefficients from the state `base`."""
        return self.gradient and (self.tangent or self.poisson)


NO_TERMS = Terms()


@dataclass(frozen=True)
class KernelTypes:
    """Types and device functions of the kernels on element nodes."""

    np: int
    real: Any
    shape: str
    """Launch shape: "element" (a thread a group of elements) or "node" (one an element node)."""
    terms: Terms = NO_TERMS
    point: PointwiseSum | None = None
    """Pointwise terms that kernels over elements add at nodes inside elements: these nodes need no
    DSS and are finished there.  None where all results are left for DSS."""
    steps: bool = False
    """True where the nodes are stepped (`levels_struct`); else a stage leaves their rates."""
    whole: bool = True
    """True where products take whole registers, see `metric_of`."""

    @cached_property
    def register(self) -> Register:
        """Numbers that one thread handles side by side."""
        return Register(self.real, lanes_of(self.real) if self.shape == "element" else 1)

    @cached_property
    def value(self) -> Any:
        """Type of a field at a node, of all lanes."""
        return self.register.value

    @cached_property
    def index(self) -> Any:
        """Type of the number of a node, for all lanes."""
        return self.register.index

    @cached_property
    def vector(self) -> Any:
        """Array of numbers on unique nodes."""
        return wp.array(dtype=self.real)

    @cached_property
    def local(self) -> Any:
        """Array (groups, np*np, fields) on element nodes."""
        return wp.array3d(dtype=self.value)

    @cached_property
    def done(self) -> Any:
        """Type of the argument that takes what is finished without DSS."""
        return levels_struct(self.real) if self.steps else self.vector

    @cached_property
    def metric(self) -> Metric:
        """Vectors and derivatives in the reference coordinates of an element."""
        return metric_of(self.register, self.whole)

    @cached_property
    def load(self) -> Any:
        """Warp function (x, offset, node): the numbers of a field at a node."""
        return load_of(self.register)

    @cached_property
    def geometry(self) -> Any:
        """Warp structure with just the arrays and scalars that kernels of these types read.

        Arrays on element nodes have shape (group, np*np, ...), arrays on unique nodes
        (unknowns*N,).
        """
        terms, value, real, point = self.terms, self.value, self.real, self.point
        on_nodes, is_node, direct = self.vector, self.shape == "node", point is not None
        members: dict[str, Any] = {
            "nodes": wp.array2d(dtype=self.index),
            "basis": wp.array3d(dtype=value),
            "derivative": wp.array2d(dtype=real),
            "weight": wp.array2d(dtype=real),
            "size": wp.int32,
        }
        optional = {
            "gravity": (terms.pressure and not terms.poisson, real),
            "bottom": (terms.bottom and not (terms.tangent or terms.poisson), on_nodes),
            "wind": (terms.wind and not terms.still, on_nodes),
            "base": (terms.linear, on_nodes),
            "inverse_jacobian": (terms.diffuses, wp.array2d(dtype=value)),
            "nu": (terms.diffusion, real),
            "nu4": (terms.biharmonic, real),
            "laplacian": (terms.biharmonic, on_nodes),
            "fluxes": (terms.diffuses and is_node, wp.array3d(dtype=value)),
            "work": (not is_node, wp.uint64),
            "whole": (direct, wp.int32),
            "inverse_area": (direct, on_nodes),
            "stage": (direct and not self.steps, stage_struct(real)),
            "point": (direct, point and point.structure),
        }
        members |= {name: kind for name, (wanted, kind) in optional.items() if wanted}
        return struct_of("Geometry", members)
