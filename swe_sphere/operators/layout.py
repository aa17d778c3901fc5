"""How numbers at the elements and nodes of one rank lie in the memory of a device."""

import functools
import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.kernels import lanes_of
from swe_sphere.kernels.simd.register import REGISTER_BYTES
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import Part
from swe_sphere.ranks.communicator import Communicator


class Layout:
    """Memory layout of this rank's part of a mesh, for a number type and a launch shape.

    Arrays on elements hold `lanes` elements side by side, in whole registers; arrays at nodes hold
    one field after the other.
    """

    def __init__(
        self, mesh: Mesh, part: Part, comm: Communicator, device: str, real: Any, shape: str
    ) -> None:
        self.mesh, self.part, self.comm = mesh, part, comm
        self.device, self.real, self.shape = device, real, shape
        self.elements, self.size = part.elements.size, part.nodes.size
        """Number of elements and of nodes of this rank."""
        self.lanes = lanes_of(real) if shape == "element" else 1
        self.groups = -(-self.elements // self.lanes)
        self.numpy_real = np.dtype(wp.dtype_to_numpy(real))

    def flat(self, array: wp.array) -> wp.array:
        """An array of registers of the run's number type as numbers (n,)."""
        shape = (array.size * self.lanes,)
        return wp.array(ptr=array.ptr, shape=shape, dtype=self.real, device=self.device)

    def upload(self, values: Array) -> wp.array:
        """A numpy array on the device in the number type of the run."""
        return wp.array(
            np.ascontiguousarray(values, self.numpy_real), dtype=self.real, device=self.device
        )

    def write(self, values: NDArray[Any], to: wp.array) -> None:
        """Numbers (k,) from the host to the front of an array; on a CPU without Warp's detours."""
        if to.device.is_cpu:
            to.numpy()[: values.size] = values
        else:
            wp.copy(to, self.upload(values), count=values.size)

    def on_elements(
        self, values: NDArray[Any], tail: tuple[int, ...] = (), scalar: Any = None
    ) -> wp.array:
        """(E, k, *tail) or (E, np, np, *tail) of this rank's elements: (groups, k, *tail) of lanes.

        scalar: another number type than that of the run.
        """
        rows = values.reshape(self.elements, -1, math.prod(tail))
        lanes = self.in_lanes(rows)
        return self.registers(lanes.reshape(*lanes.shape[:2], *tail, self.lanes), scalar)

    def in_lanes(self, values: NDArray[Any]) -> NDArray[Any]:
        """(E, k, ...) as (groups, k, ..., lanes)."""
        short = self.groups * self.lanes - self.elements
        padded = np.concatenate([values, np.repeat(values[-1:], short, axis=0)])
        grouped = padded.reshape(self.groups, self.lanes, values.shape[1], -1)
        return np.ascontiguousarray(grouped.transpose(0, 2, 3, 1))

    def registers(self, values: NDArray[Any], scalar: Any = None) -> wp.array:
        """Numbers (..., lanes) on the device, lanes side by side; scalar: as for `on_elements`."""
        scalar = scalar or self.real
        dtype = wp.types.vector(self.lanes, scalar) if self.lanes > 1 else scalar
        array = self.aligned(values.shape[:-1], dtype)
        array.assign(values.astype(wp.dtype_to_numpy(scalar)).reshape(array.numpy().shape))
        return array

    def aligned(self, shape: tuple[int, ...], dtype: Any) -> wp.array:
        """Zeros that begin where a cache line does."""
        count = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
        whole = wp.zeros(count + REGISTER_BYTES, dtype=wp.uint8, device=self.device)
        begin = whole.ptr + -whole.ptr % REGISTER_BYTES
        array = wp.array(ptr=begin, shape=shape, dtype=dtype, device=self.device)
        array.kept = whole
        return array

    def scatter(self, values: Array) -> wp.array:
        """Fields (k N,) of the whole mesh on the nodes (k n,) of this rank."""
        return self.upload(self.restrict(values))

    def restrict(self, values: NDArray[Any]) -> NDArray[Any]:
        """Fields (..., k N) of the whole mesh at the nodes of this rank: (..., k n)."""
        if not self.comm.shared:
            return values
        fields = values.reshape(-1, self.mesh.size)[:, self.part.nodes]
        return fields.reshape(*values.shape[:-1], -1)

    def collect(self, vector: wp.array) -> NDArray[Any]:
        """Fields (..., k n) of all ranks on the host as those of the whole mesh (..., k N)."""
        return self.join(vector.numpy())

    def join(self, values: NDArray[Any]) -> NDArray[Any]:
        """Fields (..., k n) of all ranks as those of the whole mesh (..., k N).

        Field by field, so that messages take no more room than one of them.
        """
        if not self.comm.shared:
            return values
        fields = values.reshape(-1, self.size)
        joined = np.empty((len(fields), self.mesh.size), values.dtype)
        room = np.empty(self.mesh.size, values.dtype)
        counts, nodes = self._owners
        for field, mine in zip(joined, fields, strict=True):
            field[nodes] = self.comm.gather(mine[self.part.owned], counts, room)
        return joined.reshape(*values.shape[:-1], -1)

    def matches(self, values: NDArray[Any], vector: wp.array) -> bool:
        """Whether fields (..., k N) of the whole mesh fit the vector (..., k n)."""
        sizes = values.size * self.size, vector.size * self.mesh.size
        return bool(values.shape[:-1] == vector.shape[:-1] and sizes[0] == sizes[1])

    @functools.cached_property
    def _owners(self) -> tuple[list[int], NDArray[Any]]:
        """How many nodes each rank counts, and all of them, one rank after the other."""
        numbers = self.comm.tell_all(self.part.nodes[self.part.owned])
        return [each.size for each in numbers], np.concatenate(numbers)
