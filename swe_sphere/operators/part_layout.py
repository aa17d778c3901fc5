"""Fields of the whole mesh, and those at the nodes of one rank."""

import functools
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import Part
from swe_sphere.operators.layout import Layout
from swe_sphere.ranks.parallel import Alone


class PartLayout(Layout):
    """How the nodes and elements of this rank's part of a mesh lie in memory."""

    def __init__(
        self, mesh: Mesh, part: Part, comm: Alone, device: str, real: Any, shape: str
    ) -> None:
        super().__init__(part.elements.size, device, real, shape)
        self.mesh, self.comm, self.part = mesh, comm, part
        self.size = part.nodes.size
        """Nodes of this rank."""

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
