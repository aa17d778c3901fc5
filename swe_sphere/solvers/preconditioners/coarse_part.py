"""The coarse functions of a rank, those of its elements, and a ring of others around.

Ranks exchange the values in the ring after every sweep.
"""

from __future__ import annotations  # scipy.sparse is loaded where it is used

from typing import Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.coarse import assembled, transfer_kernels
from swe_sphere.kernels.simd.memory import CONTRIBUTORS, Contributors
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.lane_matrices import vector
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.operators.sparse import ElementSpace

Integers = NDArray[np.integer]
MOST = 2 * CONTRIBUTORS
"""Largest number of contributions to a function: six at a cube's corner."""


class CoarsePart:
    """Functions and elements of this rank; a single process has all.

    It transfers between fields and coefficients of these functions.
    """

    def __init__(
        self, operator: SchurOperator, spaces: list[ElementSpace], reach: scipy.sparse.csr_array
    ) -> None:
        """Find the functions of this rank; a row of `reach` (m, V) lists functions that couple."""
        mesh, launch = operator.mesh, operator.launch
        self._mesh, self._launch, self._here = mesh, launch, mesh.part.elements
        self._numbers = _numbers(spaces)
        self._mine = np.unique(self._numbers[self._here])
        self.functions = self._mine
        """(n,) those that it has, ascending."""
        self._away: dict[int, Integers] = {}
        self._owner = np.zeros(len(self._numbers), dtype=int)
        if mesh.comm.shared:
            rows = np.unique(reach.T.tocsr()[self._mine].indices)
            self.functions = np.unique(reach[rows].indices)
            for rank, elements in enumerate(mesh.comm.tell_all(self._here)):
                self._owner[elements] = rank
            needed = np.flatnonzero(self._is_mine()[self._numbers].any(axis=1))
            others = set(self._owner[needed].tolist()) - {mesh.comm.rank}
            self._away = {r: needed[self._owner[needed] == r] for r in sorted(others)}
        values = np.concatenate([space.values for space in spaces[:3]], axis=1)
        count, groups = self._numbers.shape[1], mesh.groups
        made = transfer_kernels(mesh.types(whole=False), count)
        self._restrict, self._prolong, (few, many) = made
        (self._assemble,) = launch.compile(mesh.real, assembled)
        launch.load(self._restrict, self._prolong)
        self._dims = (groups, count // few), (groups, mesh.points // many)
        self._values = mesh.upload(values.T)
        self._mass = mesh.on_elements(mesh.mesh.quadrature * mesh.mesh.jacobian[self._here])
        of_elements = self.here(self._numbers[self._here])
        self._of_elements = mesh.on_elements(of_elements, scalar=wp.int32)
        size = count * (groups * mesh.lanes + sum(map(len, self._away.values())))
        self._integrals, places = vector(mesh, size + 1), self._places()
        self._local = self._integrals.values[: groups * count].reshape((groups, count))
        wanted = mesh.comm.tell_all(self._away)
        sends = {r: places[e[mesh.comm.rank]] for r, e in enumerate(wanted) if mesh.comm.rank in e}
        receives = {r: places[elements] for r, elements in self._away.items()}
        mesh.share(self._integrals.flat, sends, receives)
        self._contributors = [
            wp.array(half, dtype=Contributors, device=mesh.device)
            for half in np.split(self._contributing(places, size), 2, axis=1)
        ]

    def restrict(self, b: Field, out: Field) -> None:
        """Set out to the integrals of b times each function [m2]."""
        launch = self._launch
        inputs = self._values, self._mass, b.values, self._local
        launch(self._restrict, self._dims[0], 0, *inputs, cuts=self._mesh.cuts)
        self._mesh.exchange(self._integrals)
        size = self._contributors[0].size
        launch(self._assemble, size, *self._contributors, self._integrals.flat, out.flat)

    def prolong(self, coefficients: Field, x: Field) -> None:
        """Add the functions times their coefficients to x."""
        self._launch(
            self._prolong, self._dims[1], 0, self._values, self._of_elements, coefficients.flat,
            x.values, cuts=self._mesh.cuts,
        )  # fmt: skip

    def rows(self, matrix: Any) -> scipy.sparse.csr_array:
        """Return the rows of this rank's functions."""
        return scipy.sparse.csr_array(matrix)[self.functions]

    def square(self, matrix: Any) -> scipy.sparse.csr_array:
        """Return rows and columns of this rank's functions, without entries in rows of the ring."""
        kept = scipy.sparse.diags_array(self._is_mine()[self.functions].astype(matrix.dtype))
        square: scipy.sparse.csr_array = (kept @ self.rows(matrix)[:, self.functions]).tocsr()
        square.eliminate_zeros()
        return square

    def here(self, functions: Integers) -> Integers:
        """Return their indices among the functions of this rank."""
        return np.searchsorted(self.functions, functions)

    def owned(self, functions: Integers) -> Integers:
        """Return those of `functions` (V',) whose first element belongs to this rank."""
        mine: Integers = functions[self._owner_of(functions) == self._mesh.comm.rank]
        return mine

    def _owner_of(self, functions: Integers) -> Integers:
        _, first = np.unique(self._numbers, return_index=True)
        owner: Integers = self._owner[first[functions] // self._numbers.shape[1]]
        return owner

    def ring(self) -> tuple[dict[int, Integers], dict[int, Integers]]:
        """Return indices of functions in the rings of other ranks, and of its own ring, by rank."""
        comm, ring = self._mesh.comm, np.setdiff1d(self.functions, self._mine)
        owner = self._owner_of(ring)
        wanted = {r: ring[owner == r] for r in np.unique(owner).tolist()}
        told = comm.tell_all(wanted)
        sends = {r: self.here(of[comm.rank]) for r, of in enumerate(told) if comm.rank in of}
        return sends, {r: self.here(functions) for r, functions in wanted.items()}

    def _places(self) -> Integers:
        """Return offsets (E, k) of integrals in (groups, k, lanes), other ranks' behind these."""
        lanes, k = self._mesh.lanes, self._numbers.shape[1]
        group, lane = np.divmod(np.arange(self._here.size), lanes)
        places = np.full(self._numbers.shape, -1)
        places[self._here] = (group[:, None] * k + np.arange(k)) * lanes + lane[:, None]
        away = np.concatenate([*self._away.values(), np.zeros(0, dtype=int)])
        behind = self._mesh.groups * k * lanes
        places[away] = behind + np.arange(away.size * k).reshape(-1, k)
        return places

    def _contributing(self, places: Integers, size: int) -> NDArray[np.int32]:
        """Return offsets (n, MOST) of the contributions to each function, in the mesh's order.

        A missing contribution is -1, as in the ring; the fourth of three points past all `size`.
        """
        element, slot = np.nonzero(self._is_mine()[self._numbers])
        row = self.here(self._numbers[element, slot])
        order = np.argsort(row, kind="stable")
        counts = np.bincount(row, minlength=self.functions.size)
        within = np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts)
        table = np.full((counts.size, MOST), -1, dtype=np.int32)
        table[row[order], within] = places[element, slot][order]
        odd = np.flatnonzero(counts % CONTRIBUTORS == 3)
        table[odd, counts[odd]] = size
        return table

    def _is_mine(self) -> NDArray[np.bool_]:
        is_mine = np.zeros(self._numbers.max() + 1, dtype=bool)
        is_mine[self._mine] = True
        return is_mine


def _numbers(spaces: list[ElementSpace]) -> Integers:
    """Return numbers (E, k) of the functions on each element, one space after the other."""
    starts = np.cumsum([0, *(int(space.numbers.max()) + 1 for space in spaces)])
    smooth, both, one, other = (
        np.where(space.numbers < 0, 0, space.numbers + start)
        for space, start in zip(spaces, starts[:-1], strict=True)
    )
    return np.concatenate([smooth, both, one + other], axis=1, dtype=np.int32)
