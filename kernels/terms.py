"""Terms that a kernel is compiled for, and the arrays and types that these terms need.

A term that is off adds no array, no load and no branch to the generated code.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from swe_sphere.kernels.define import Placeholder, Register, lanes_of, struct_of, value
from swe_sphere.kernels.pointwise import PointwiseSum
from swe_sphere.kernels.simd.arithmetic import line_sums
from swe_sphere.kernels.simd.memory import run_table
from swe_sphere.kernels.simd.stages import levels_struct, stage_struct


@dataclass(frozen=True)
class Terms:
    """The terms compiled into one kernel.

    * `advection`: kinetic energy and relative vorticity in the vector-invariant momentum equation.
    * `pressure`: the surface height in that equation. Either term adds the continuity equation.
    * `bottom`: the surface height is depth plus bottom height.
    * `passive`: a scalar is the only unknown; the prescribed wind carries it.
    * `diffusion`: weak Laplacian of wind and surface height, or of the scalar, times `nu`.
    * `biharmonic`: weak Laplacian of a given Laplacian (`laplacian` array), times minus `nu4`.
    * `no_transport`: with `passive`, the geometry has no wind, and the scalar is transported only
      if the kernel's own formula does so (`carrying_kernel`).
    * `skew`: the skew form. The vorticity of the state turns the wind of `base`, which carries
      the depth of `base`; the state stores the Bernoulli function in place of depth.
    * `tangent`: the exact derivative of all of these at the state `base`, applied to a direction.
    * `momentum`: the momentum equation alone, with two fields as its result.
    * `jumps`: the penalty on jumps at edges of elements, which has separate kernels.
    * `waves`: block elimination (`helmholtz.py`), which has separate kernels.
    """

    advection: bool = False
    pressure: bool = False
    bottom: bool = False
    passive: bool = False
    diffusion: bool = False
    biharmonic: bool = False
    tangent: bool = False
    no_transport: bool = False
    skew: bool = False
    momentum: bool = False
    jumps: bool = False
    waves: bool = False

    @property
    def unknowns(self) -> int:
        """Number of fields: depth alone under a prescribed wind, else two winds and depth."""
        return 1 if self.passive else 3

    @property
    def dynamics(self) -> bool:
        """True if there is a term other than diffusion."""
        return self.gradient or (self.passive and not self.no_transport)

    @property
    def diffuses(self) -> bool:
        """True if a weak Laplacian is computed."""
        return self.diffusion or self.biharmonic

    @property
    def gradient(self) -> bool:
        """True if the gradient of a Bernoulli function drives the wind."""
        return self.advection or self.pressure

    @property
    def linear(self) -> bool:
        """True if the terms are linear, with coefficients from the state `base`."""
        return self.gradient and (self.tangent or self.skew)


NO_TERMS = Terms()


class KernelTypes:
    """Number type, np, launch shape and terms for which kernels on element nodes are compiled."""

    def __init__(
        self, np_: int, real: Any, shape: str, terms: Terms = NO_TERMS,
        point: PointwiseSum | None = None, steps: bool = False, whole: bool = True,
        given: Any = None,
    ) -> None:  # fmt: skip
        """Derive the types from the launch shape, the number type and the terms.

        * shape: "element" (one thread per group of elements) or "node" (one per element node).
        * point: pointwise terms that kernels over elements add at nodes inside elements; these
          nodes need no DSS and are finished there. With None, all results await DSS.
        * steps: True if the nodes are stepped (`levels_struct`); otherwise a stage stores their
          rates.
        * whole: True if products use whole registers, see `Register`.
        * given: number type of the state vectors, if it differs from `real`.
        """
        self.np, self.real, self.shape, self.terms = np_, real, shape, terms
        self.point, self.steps, self.given = point, steps, given or real
        self.register = Register(real, lanes_of(real) if shape == "element" else 1, whole)
        """Register of the numbers that one thread handles side by side."""
        self.value = self.register.value
        """Type of a field at a node."""
        self.side = np_ if shape == "element" else 1
        """A thread handles `side` nodes in both directions, in kernels over `threads`."""
        self.geometry = self._geometry()
        """Warp structure of arrays and scalars that kernels of these types read.  Arrays on element
        nodes have shape (groups, np*np, ...), on unique nodes (N,), (2N,) or (unknowns*N,)."""

    def threads(self, groups: int) -> tuple[int, int, int]:
        """Return the threads of kernels over all nodes of these groups of elements."""
        return groups, self.np // self.side, self.np // self.side

    def _geometry(self) -> Any:
        terms, value, real, point = self.terms, self.value, self.real, self.point
        on_nodes, is_node, direct = wp.array(dtype=real), self.shape == "node", point is not None
        members: dict[str, Any] = {
            "nodes": wp.array2d(dtype=self.register.index),
            "basis": wp.array3d(dtype=value),
            "derivative": wp.array2d(dtype=real),
            "weight": wp.array2d(dtype=real),
            "size": wp.int32,
            "gravity": terms.pressure and not terms.skew and real,
            "bottom": terms.bottom and not (terms.tangent or terms.skew) and on_nodes,
            "wind": terms.passive and not terms.no_transport and on_nodes,
            "base": terms.linear and on_nodes,
            "inverse_jacobian": (terms.diffuses or terms.jumps) and wp.array2d(dtype=value),
            "strength": terms.jumps and wp.array2d(dtype=value),
            "values": terms.jumps and wp.array3d(dtype=value),
            "nu": terms.diffusion and real,
            "nu4": terms.biharmonic and real,
            "laplacian": terms.biharmonic and on_nodes,
            "fluxes": terms.diffuses and is_node and wp.array3d(dtype=value),
            "flux_matrix": terms.waves and wp.array3d(dtype=value),
            "runs": terms.waves and wp.array3d(dtype=run_table.find(self)),
            "others": terms.waves and wp.array(dtype=self.register.index),
            "per_area": terms.waves and wp.array2d(dtype=value),
            "per_diagonal": terms.waves and wp.array2d(dtype=value),
            "work": not is_node and wp.uint64,
            "block_groups": direct and wp.int32,
            "inverse_area": direct and on_nodes,
            "stage": direct and not self.steps and stage_struct(real),
            "point": direct and point and point.structure.find(self),
        }
        return struct_of("Geometry", members)


np_: Any = Placeholder(lambda t: t.np, of_elements=True)
side: Any = Placeholder(lambda t: t.side, of_elements=True)
geometry: Any = Placeholder(lambda t: t.geometry, of_elements=True)
"""These three names are the members of `KernelTypes` in kernels."""
lone: Any = Placeholder(lambda t: int(t.side == 1), of_elements=True)
"""1 if a thread handles one node; else 0, so that columns of an unrolled row are constants."""
state_vector: Any = Placeholder(lambda t: wp.array(dtype=t.given), of_elements=True)
"""Array type of a state vector."""
output: Any = Placeholder(
    lambda t: levels_struct(t.real) if t.steps else wp.array(dtype=t.real), of_elements=True
)
"""Type of the argument that receives results finished without DSS."""
along: Any = Placeholder(lambda t: line_sums(t.np)[0].find(t), of_elements=True)
across: Any = Placeholder(lambda t: line_sums(t.np)[1].find(t), of_elements=True)
"""Functions (derivative, field (np, np), i, j): derivatives of a field along each coordinate."""
local = wp.array3d(dtype=value)
"""Array type of fields on element nodes (groups, np*np, fields)."""


kernel_types = functools.cache(KernelTypes)
"""Return the `KernelTypes` of these arguments; equal arguments give the same object."""
