"""Mesh arrays in the order in which the kernels read them."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels import lanes_of
from swe_sphere.kernels.assembly import CONTRIBUTORS, Contributors
from swe_sphere.mesh import Mesh

REALS = {"float64": wp.float64, "float32": wp.float32}


class DeviceMesh:
    """Element data of a mesh on a device, `lanes` elements side by side.

    Arrays on element nodes have shape (groups, np*np, ..., lanes); the last group is filled up with
    copies of the last element, which DSS never reads.  Metric terms are computed in float64 and
    only then rounded to `real`: a geometry in float32 would grow a spurious wave (Nakano et al.
    2018, doi:10.1175/MWR-D-17-0257.1).
    """

    def __init__(self, mesh: Mesh, device: str, real: Any, shape: str) -> None:
        self.mesh, self.device, self.real, self.shape = mesh, device, real, shape
        self.lanes = lanes_of(real) if shape == "element" else 1
        self.groups = -(-mesh.elements // self.lanes)
        self.points = mesh.np**2
        self.numpy_real = np.dtype(wp.dtype_to_numpy(real))

    @property
    def dim(self) -> int | tuple[int, int]:
        """Threads of a launch over the element nodes."""
        return self.groups if self.shape == "element" else (self.groups, self.points)

    @functools.cached_property
    def nodes(self) -> wp.array:
        """Unique node numbers of the element nodes."""
        return self._element_array(self.mesh.nodes[..., None], wp.int32, ())

    @functools.cached_property
    def basis(self) -> wp.array:
        """The four entries of dx/dxi_i . e_k [m] at the element nodes."""
        return self._element_array(self.mesh.basis, self.real, (4,))

    @functools.cached_property
    def inverse_jacobian(self) -> wp.array:
        """One over the area element [m-2]."""
        return self._element_array(1.0 / self.mesh.jacobian[..., None], self.real, ())

    @functools.cached_property
    def derivative(self) -> wp.array:
        """Derivative matrix of the GLL nodes."""
        return self.upload(self.mesh.derivative)

    @functools.cached_property
    def weight(self) -> wp.array:
        """Products of GLL weights (np, np)."""
        return self.upload(np.outer(self.mesh.gll_weights, self.mesh.gll_weights))

    @functools.cached_property
    def inverse_area(self) -> wp.array:
        """One over the nodal area (N,) [m-2]."""
        return self.upload(1.0 / self.mesh.area)

    @functools.cache  # noqa: B019 - lives as long as the mesh, with two or three entries
    def places(self, unknowns: int) -> wp.array:
        """(N,) where the contributors of each node stand in local tendencies of that many fields.

        A node lacks those that are -1; the fourth of three stands in the empty last group.
        """
        mesh = self.mesh
        element, point = np.divmod(mesh.gather_entries, self.points)
        group, lane = np.divmod(element, self.lanes)
        position = (group * self.points + point) * (unknowns * self.lanes) + lane
        empty = self.groups * self.points * unknowns * self.lanes
        places = np.full((mesh.size, CONTRIBUTORS), -1, dtype=np.int32)
        count = np.diff(mesh.gather_offsets)
        places[count == 3, 3] = empty
        node = np.repeat(np.arange(mesh.size), count)
        places[node, np.arange(node.size) - mesh.gather_offsets[node]] = position
        return wp.array(places, dtype=Contributors, device=self.device)

    def geometry(self, kind: Any, given: Mapping[str, Any] | None = None) -> Any:
        """A structure of that kind: members by name from those given, else from the mesh."""
        known = {"size": self.mesh.size} | dict(given or {})
        filled = kind()
        for name in kind.vars:
            setattr(filled, name, known[name] if name in known else getattr(self, name))
        return filled

    def local(self, unknowns: int, value: Any) -> tuple[wp.array, wp.array]:
        """Room for local tendencies, (groups + 1, np*np, unknowns) of `value`, and a flat view.

        No element writes to the last group, which stays zero.
        """
        shape = (self.groups + 1, self.points, unknowns)
        local = wp.zeros(shape, dtype=value, device=self.device)
        count = math.prod(shape) * self.lanes
        flat = wp.array(ptr=local.ptr, shape=(count,), dtype=self.real, device=self.device)
        return local, flat

    def upload(self, values: Array) -> wp.array:
        """A numpy array on the device in the number type of the run."""
        return wp.array(
            np.ascontiguousarray(values, self.numpy_real), dtype=self.real, device=self.device
        )

    def _element_array(self, values: NDArray[Any], scalar: Any, tail: tuple[int, ...]) -> wp.array:
        """(E, np, np, ...) regrouped to (groups, np*np, *tail) of lanes."""
        parts = values.reshape(self.mesh.elements, self.points, -1)
        short = self.groups * self.lanes - self.mesh.elements
        padded = np.concatenate([parts, np.repeat(parts[-1:], short, axis=0)])
        lanes_last = padded.reshape(self.groups, self.lanes, self.points, -1).transpose(0, 2, 3, 1)
        shape = (self.groups, self.points, *tail)
        numpy_type = np.dtype(wp.dtype_to_numpy(scalar))
        if self.lanes == 1:
            data, dtype = lanes_last.reshape(shape), scalar
        else:
            data, dtype = (
                lanes_last.reshape(*shape, self.lanes),
                wp.types.vector(self.lanes, scalar),
            )
        return wp.array(
            np.ascontiguousarray(data, numpy_type), dtype=dtype, shape=shape, device=self.device
        )
