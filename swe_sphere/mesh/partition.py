"""What each rank holds of a mesh, along a curve through the cube; nodes by nested dissection."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError
from swe_sphere.mesh.mesh import Mesh
from swe_sphere.mesh.numbering import BLOCK, Integers

PATH = ((0, 0), (1, 0), (2, 0), (5, 1), (3, 5), (4, 0))
"""Faces in the order in which the curve visits them, and how each is turned: 1 swaps the
coordinates, 2 and 4 then reverse the first and the second.  Each face begins where the last one
ended."""


def curve(ne: int) -> Integers:
    """Numbers (E,) of the elements along a Hilbert curve, one after the other.

    Where ne is no power of two, those of the next larger power, with gaps: then some steps of the
    curve are longer.
    """
    first, second = np.indices((ne, ne)).reshape(2, -1)
    side = 1 << (ne - 1).bit_length()
    pieces = []
    for face, turn in PATH:
        x, y = (second, first) if turn & 1 else (first, second)
        x, y = (ne - 1 - x if turn & 2 else x), (ne - 1 - y if turn & 4 else y)
        along = _hilbert(x * side // ne, y * side // ne, side)
        pieces.append(face * ne**2 + np.argsort(along))
    return np.concatenate(pieces)


def _hilbert(x: Integers, y: Integers, side: int) -> Integers:
    """Place on the Hilbert curve of cells of a square of that side, a power of two.

    The curve goes from one end of the first coordinate to the other one.
    """
    along = np.zeros_like(x)
    half = side // 2
    while half:
        right, up = (x & half) > 0, (y & half) > 0
        along += half**2 * ((3 * right) ^ up)
        x, y = x & (half - 1), y & (half - 1)
        turned = right & ~up
        x, y = np.where(turned, half - 1 - x, x), np.where(turned, half - 1 - y, y)
        x, y = np.where(up, x, y), np.where(up, y, x)
        half //= 2
    return along


CHUNKS = 512
"""About how many pieces of equally many elements a mesh is dealt out in, and sums are taken by; of
those with pieces of MOST elements there are more."""
MOST = 4 * BLOCK
"""Elements of a piece: so fine meshes, from ne 74 on, have ever more pieces, and ranks."""
LARGE = 64
"""A mesh of so many blocks of elements is dealt out in whole blocks: kernels are faster on them."""


@dataclass(frozen=True, eq=False)
class Part:
    """Elements and nodes of one rank, which counts both from zero.

    A node on the rim is held by every rank whose elements touch it.  Each of them sums up all its
    contributors in the order of the whole mesh, so that they keep the same bits.
    """

    elements: Integers
    """(e,) numbers in the mesh, along the curve: the chunks away from the rim, then those on it."""
    away: int
    """How many elements are in the former, which share no node with another rank."""
    nodes: Integers
    """(n,) numbers in the mesh: interior nodes, edges, vertices, each in the order of the elements;
    on large meshes in blocks of BLOCK elements as in the mesh itself."""
    node_of: NDArray[np.int32]
    """(e, np, np) place among `nodes` of each element node."""
    counts: NDArray[np.integer]
    """(n,) contributors of each node."""
    contributors: NDArray[np.integer]
    """Element nodes (element np^2 + point) of this part, node by node in the order of the mesh; one
    that another rank computes is -1 - its place among those received."""
    sends: dict[int, Integers]
    """Element nodes whose values go to each neighbour."""
    receives: dict[int, int]
    """How many come from each."""
    spans: Integers
    """(3, chunks, 2) where among interior nodes, edges and vertices those of each chunk begin and
    end, chunks along the curve; a node is of the chunk that comes to it first there."""

    @cached_property
    def owned(self) -> Integers:
        """Places of the nodes that are counted here and nowhere else."""
        return np.concatenate([np.arange(*span) for span in self.spans.reshape(-1, 2)])


def pieces(ne: int) -> tuple[int, int]:
    """How many pieces a mesh of 6 ne^2 elements is dealt out in, and of how many elements each."""
    elements = 6 * max(ne, 1) ** 2
    block = BLOCK if elements >= LARGE * BLOCK else 1
    each = min(block * -(-elements // (CHUNKS * block)), MOST)
    return -(-elements // each), each


def check_ranks(ne: int, ranks: int) -> None:
    """ConfigError where there are fewer pieces to deal out than ranks."""
    most, _ = pieces(ne)
    if ranks > most:
        raise ConfigError(
            f"a mesh of ne={ne} is shared by {most} ranks at the most, not {ranks}:"
            " take fewer ranks or a larger ne"
        )


def whole(mesh: Mesh) -> Part:
    """All of a mesh, in its own order."""
    return Part(
        np.arange(mesh.elements), mesh.elements, np.arange(mesh.size), mesh.nodes,
        np.diff(mesh.gather_offsets), mesh.gather_entries, {}, {}, np.zeros((3, 0, 2), int),
    )  # fmt: skip


def partition(mesh: Mesh, rank: int, size: int) -> Part:
    """The part of that rank, of `size`.

    Raises ConfigError where there are fewer pieces to deal out than ranks.
    """
    check_ranks(mesh.ne, size)
    return _Dealer(mesh, size).part(rank)


class _Dealer:
    """Who has what, for all ranks."""

    def __init__(self, mesh: Mesh, size: int) -> None:
        chunks, per_chunk = pieces(mesh.ne)
        block = BLOCK if per_chunk % BLOCK == 0 else 1
        self._mesh, self._points = mesh, mesh.np**2
        self._order = curve(mesh.ne)
        along = np.empty_like(self._order)
        along[self._order] = np.arange(mesh.elements)
        self._bounds = np.arange(size + 1) * chunks // size
        self._chunk = along // per_chunk
        self._rank = np.searchsorted(self._bounds, self._chunk, side="right") - 1
        offsets = mesh.gather_offsets[:-1]
        element, point = np.divmod(mesh.gather_entries.astype(np.int64), self._points)
        first = np.minimum.reduceat(along[element] * self._points + point, offsets)
        first_element, first_point = np.divmod(first, self._points)
        self._counts = np.diff(mesh.gather_offsets)
        self._kind = np.minimum(self._counts, 3) - 1
        self._owner = self._chunk[self._order[first_element]]
        number, lane = np.divmod(first_element, block)
        self._place = np.empty(mesh.size, dtype=np.int64)
        self._place[np.lexsort((lane, first_point, number, self._kind))] = np.arange(mesh.size)
        ranks = self._rank[element]
        lowest, highest = (f.reduceat(ranks, offsets) for f in (np.minimum, np.maximum))
        self._late = np.zeros(chunks, dtype=int)
        """Which chunks come last on their rank: those on the rim, and one that is no whole one."""
        self._late[self._chunk[(lowest != highest)[mesh.nodes].any(axis=(1, 2))]] = 1
        self._late[mesh.elements // per_chunk :] = 1

    def part(self, rank: int) -> Part:
        mesh = self._mesh
        elements = self._order[self._rank[self._order] == rank]
        late = self._late[self._chunk[elements]]
        elements = elements[np.argsort(late, kind="stable")]
        nodes = np.unique(mesh.nodes[elements])
        chunk = self._owner[nodes]
        turn = np.where(self._is_of(rank, chunk), self._late[chunk], 2)
        nodes = nodes[np.lexsort((self._place[nodes], turn, self._kind[nodes]))]
        number = np.full(mesh.size, -1, dtype=np.int32)
        number[nodes] = np.arange(nodes.size, dtype=np.int32)
        sends, receives, contributors = self._traffic(rank, elements, nodes)
        return Part(
            elements, int(np.sum(late == 0)), nodes, number[mesh.nodes[elements]],
            self._counts[nodes], contributors, sends, receives, self._spans(rank, nodes),
        )  # fmt: skip

    def _traffic(
        self, rank: int, elements: Integers, nodes: Integers
    ) -> tuple[dict[int, Integers], dict[int, int], Integers]:
        """What is sent and received, and the contributors of the nodes."""
        mesh, counts = self._mesh, self._counts[nodes]
        start = np.repeat(mesh.gather_offsets[nodes], counts)
        within = np.arange(start.size) - np.repeat(np.cumsum(counts) - counts, counts)
        entries = mesh.gather_entries[start + within].astype(np.int64)
        node = np.repeat(np.arange(nodes.size), counts)
        element, point = np.divmod(entries, self._points)
        owner = self._rank[element]
        number = np.full(mesh.elements, -1)
        number[elements] = np.arange(elements.size)
        contributors = number[element] * self._points + point
        away = np.flatnonzero(owner != rank)
        away = away[np.lexsort((entries[away], owner[away]))]
        contributors[away] = -1 - np.arange(away.size)
        neighbours, received = np.unique(owner[away], return_counts=True)
        sends = {}
        for other in neighbours:
            theirs = np.zeros(nodes.size, dtype=bool)
            theirs[node[owner == other]] = True
            going = np.flatnonzero(theirs[node] & (owner == rank))
            sends[int(other)] = contributors[going[np.argsort(entries[going])]]
        return sends, dict(zip(neighbours.tolist(), received.tolist(), strict=True)), contributors

    def _is_of(self, rank: int, chunk: Integers) -> NDArray[np.bool_]:
        first, behind = self._bounds[rank : rank + 2]
        found: NDArray[np.bool_] = (first <= chunk) & (chunk < behind)
        return found

    def _spans(self, rank: int, nodes: Integers) -> Integers:
        kind, chunk = self._kind[nodes], self._owner[nodes]
        first, behind = self._bounds[rank : rank + 2]
        own, count = np.flatnonzero(self._is_of(rank, chunk)), behind - first
        code, begins, lengths = np.unique(
            kind[own] * count + chunk[own] - first, return_index=True, return_counts=True
        )
        spans = np.zeros((3 * count, 2), dtype=np.int64)
        spans[code, 0] = own[begins]
        spans[code, 1] = own[begins] + lengths
        return spans.reshape(3, count, 2)


Int = NDArray[np.int64]


def dissection_order(mesh: Mesh) -> Int:
    """(N,) nodes: those inside each half of the sphere, then those between; halves alike.

    A factorisation of a matrix that couples nodes of one element alone then fills in N log N
    entries instead of N^1.5 (George 1973, SIAM J. Numer. Anal. 10, 345-363).
    """
    code = _halves(mesh)
    owners = code[mesh.gather_entries // mesh.np**2]
    first = np.minimum.reduceat(owners, mesh.gather_offsets[:-1])
    last = np.maximum.reduceat(owners, mesh.gather_offsets[:-1])
    _, height = np.frexp((first ^ last).astype(np.float64))  # of the last part they have in common
    end = ((first >> height) + 1) << height
    return np.lexsort((height, end))


def _halves(mesh: Mesh) -> Int:
    """(E,) numbers whose binary digits tell in which half of which half an element lies."""
    centres: Array = mesh.xyz[mesh.nodes].mean(axis=(1, 2))
    code = np.zeros(mesh.elements, dtype=np.int64)
    parts, digits = [np.arange(mesh.elements)], mesh.elements.bit_length()
    for digit in reversed(range(digits)):
        pairs = [_bisected(centres, part) for part in parts]
        for _, upper in pairs:
            code[upper] += 1 << digit
        parts = [half for pair in pairs for half in pair if half.size > 1]
    return code


def _bisected(centres: Array, part: Int) -> tuple[Int, Int]:
    """Two halves of some elements, cut across where they reach farthest."""
    apart = centres[part] - centres[part].mean(axis=0)
    _, _, axes = np.linalg.svd(apart, full_matrices=False)
    order = part[np.argsort(apart @ axes[0], kind="stable")]
    return order[: part.size // 2], order[part.size // 2 :]
