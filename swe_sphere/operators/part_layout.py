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
from swe_sphere.parallel import Alone


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
        values: NDArray[Any] = vector.numpy()
        if not self.comm.shared:
            return values
        return self._join(values.reshape(-1, self.size)).reshape(*values.shape[:-1], -1)

    def matches(self, values: NDArray[Any], vector: wp.array) -> bool:
        """Whether fields (..., k N) of the whole mesh fit the vector (..., k n)."""
        sizes = values.size * self.size, vector.size * self.mesh.size
        return bool(values.shape[:-1] == vector.shape[:-1] and sizes[0] == sizes[1])

    def _join(self, values: NDArray[Any]) -> NDArray[Any]:
        numbers, fields = self._owners, len(values)
        counts = [fields * each.size for each in numbers]
        parts = self.comm.gather(values[:, self.part.owned], counts)
        joined = np.empty((fields, self.mesh.size), values.dtype)
        for number, part in zip(numbers, np.split(parts, np.cumsum(counts)[:-1]), strict=True):
            joined[:, number] = part.reshape(fields, -1)
        return joined

    @functools.cached_property
    def _owners(self) -> list[NDArray[Any]]:
        """The nodes that each rank counts."""
        return self.comm.tell_all(self.part.nodes[self.part.owned])
