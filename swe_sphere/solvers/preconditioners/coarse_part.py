"""The coarse functions that a rank works on, those of its elements, and a ring of others around.

A sweep takes values in the ring from other ranks: they tell them after every sweep.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from swe_sphere.kernels.simd.memory import CONTRIBUTORS
from swe_sphere.operators.device_mesh import DeviceMesh

Integers = NDArray[np.integer]
MOST = 2 * CONTRIBUTORS
"""Elements that have a part in a function, with those that have two: six at a cube's corner."""


class CoarsePart:
    """Functions and elements of this rank; a process alone has all.

    numbers: (E, k) the functions on each element; reach: (m, V) matrix, each row of which has
    entries for functions that see each other in a sweep.
    """

    def __init__(self, mesh: DeviceMesh, numbers: Integers, reach: scipy.sparse.csr_array) -> None:
        self._mesh, self._numbers, self._here = mesh, numbers, mesh.part.elements
        self._mine = np.unique(numbers[self._here])
        self.functions = self._mine
        """(n,) those that it has, ascending."""
        self._away: dict[int, Integers] = {}
        self._owner = np.zeros(len(numbers), dtype=int)
        if mesh.comm.shared:
            rows = np.unique(reach.T.tocsr()[self._mine].indices)
            self.functions = np.unique(reach[rows].indices)
            for rank, elements in enumerate(mesh.comm.tell_all(self._here)):
                self._owner[elements] = rank
            needed = np.flatnonzero(self._is_mine()[numbers].any(axis=1))
            others = set(self._owner[needed].tolist()) - {mesh.comm.rank}
            self._away = {r: needed[self._owner[needed] == r] for r in sorted(others)}

    def rows(self, matrix: Any) -> scipy.sparse.csr_array:
        """Those of its functions."""
        return scipy.sparse.csr_array(matrix)[self.functions]

    def square(self, matrix: Any) -> scipy.sparse.csr_array:
        """Rows and columns of its functions, without entries in the rows of the ring."""
        kept = scipy.sparse.diags_array(self._is_mine()[self.functions].astype(matrix.dtype))
        square: scipy.sparse.csr_array = (kept @ self.rows(matrix)[:, self.functions]).tocsr()
        square.eliminate_zeros()
        return square

    def here(self, functions: Integers) -> Integers:
        """Their numbers among those that it has."""
        return np.searchsorted(self.functions, functions)

    def owned(self, functions: Integers) -> Integers:
        """Those of some functions (V',) of which this rank holds the first element."""
        mine: Integers = functions[self._owner_of(functions) == self._mesh.comm.rank]
        return mine

    def _owner_of(self, functions: Integers) -> Integers:
        _, first = np.unique(self._numbers, return_index=True)
        owner: Integers = self._owner[first[functions] // self._numbers.shape[1]]
        return owner

    def ring(self) -> tuple[dict[int, Integers], dict[int, Integers]]:
        """Places of its functions that others have in their rings, and of its ring, by rank."""
        comm, ring = self._mesh.comm, np.setdiff1d(self.functions, self._mine)
        owner = self._owner_of(ring)
        wanted = {r: ring[owner == r] for r in np.unique(owner).tolist()}
        told = comm.tell_all(wanted)
        sends = {r: self.here(of[comm.rank]) for r, of in enumerate(told) if comm.rank in of}
        return sends, {r: self.here(functions) for r, functions in wanted.items()}

    def traffic(self) -> tuple[dict[int, Integers], dict[int, Integers]]:
        """Places (n, k) of integrals over elements that go to each neighbour, and come from it."""
        comm, places = self._mesh.comm, self.places()
        wanted = comm.tell_all(self._away)
        sends = {r: places[each[comm.rank]] for r, each in enumerate(wanted) if comm.rank in each}
        return sends, {r: places[elements] for r, elements in self._away.items()}

    def places(self) -> Integers:
        """(E, k) of integrals: as (groups, k, lanes), and behind these the elements of others."""
        lanes, k = self._mesh.lanes, self._numbers.shape[1]
        group, lane = np.divmod(np.arange(self._here.size), lanes)
        places = np.full(self._numbers.shape, -1)
        places[self._here] = (group[:, None] * k + np.arange(k)) * lanes + lane[:, None]
        away = np.concatenate([*self._away.values(), np.zeros(0, dtype=int)])
        behind = self._mesh.groups * k * lanes
        places[away] = behind + np.arange(away.size * k).reshape(-1, k)
        return places

    @property
    def size(self) -> int:
        """Of room for these integrals."""
        elements = self._mesh.groups * self._mesh.lanes + sum(map(len, self._away.values()))
        return int(self._numbers.shape[1] * elements)

    def contributors(self) -> NDArray[np.int32]:
        """(n, MOST) places of what adds up to each function, in an order of the whole mesh.

        -1 for what is not there, and in the ring; the fourth of three stands behind all.
        """
        element, slot = np.nonzero(self._is_mine()[self._numbers])
        row = self.here(self._numbers[element, slot])
        order = np.argsort(row, kind="stable")
        counts = np.bincount(row, minlength=self.functions.size)
        within = np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts)
        table = np.full((counts.size, MOST), -1, dtype=np.int32)
        table[row[order], within] = self.places()[element, slot][order]
        odd = np.flatnonzero(counts % CONTRIBUTORS == 3)
        table[odd, counts[odd]] = self.size
        return table

    def _is_mine(self) -> NDArray[np.bool_]:
        is_mine = np.zeros(self._numbers.max() + 1, dtype=bool)
        is_mine[self._mine] = True
        return is_mine
