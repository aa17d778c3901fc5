"""Partition of a mesh between ranks in belts of rings; nested dissection of its nodes."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Integers, inverse_permutation
from swe_sphere.errors import ConfigError
from swe_sphere.mesh.cubed_sphere import BLOCK, FACES
from swe_sphere.mesh.mesh import Mesh


def rings(ne: int) -> Integers:
    """Return the numbers (E,) of the elements in rings, each of which touches only two others.

    Rings are squares about the centre of face 5, belts around faces 0 to 3, and squares about the
    centre of face 4; each begins at the same longitude and runs eastward.
    """
    face, *along = np.indices((6, ne, ne)).reshape(3, -1)
    first, second = (2 * a - (ne - 1) for a in along)  # twice the coordinates are integers
    normal, one, two = FACES[face].transpose(1, 2, 0)
    x, y, z = ne * normal + first * one + second * two
    radius = np.maximum(abs(x), abs(y))
    ring = np.select([face == 4, face == 5], [3 * ne - radius, radius - 3 * ne], z)
    return np.lexsort((np.arctan2(y, x), ring))


CHUNKS = 512
"""Largest number of chunks of a mesh below ne 74; ranks own chunks and sum them one by one."""
LARGEST_CHUNK = 4 * BLOCK
"""Largest number of elements of a chunk: meshes from ne 74 on have more than CHUNKS chunks."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Elements and nodes of one rank, both numbered from zero on the rank.

    A node on the rim, where elements of several ranks meet, belongs to the parts of all these
    ranks. Each of these ranks sums all contributors in the mesh's order, and so gets the same bits.
    """

    element_numbers: Integers
    """(e,) numbers in the mesh, chunk by chunk: full chunks away from the rim, the nearest ones
    first, then the others."""
    interior_elements: int
    """Number of elements in full chunks that share no node with other ranks, in whole blocks of
    BLOCK elements; without MPI of all."""
    node_numbers: Integers
    """(n,) numbers in the mesh: nodes inside elements, on edges, at vertices, each in the order of
    the elements, nodes of other ranks last; on large meshes in blocks of BLOCK elements."""
    nodes: NDArray[np.int32]
    """(e, np, np) position in `node_numbers` of each element node."""
    counts: NDArray[np.integer]
    """(n,) number of contributors of each node."""
    contributors: NDArray[np.integer]
    """Element nodes (element np^2 + point) of this part, node by node in the order of the mesh; an
    element node of another rank is -1 - its position among the received values."""
    sends: dict[int, Integers]
    """Element nodes whose values go to each neighbour."""
    receives: dict[int, int]
    """Number of values that come from each neighbour."""
    interior_nodes: Integers
    """(3,) number of nodes of each kind that full chunks away from the rim own, numbered before the
    others; without MPI all nodes. 0 in parts that fit into the caches."""
    spans: Integers
    """(3, chunks, 2) begin and end of the nodes that each chunk owns inside elements, on edges
    and at vertices; chunks in the order of the rings. Without MPI all nodes, none if `is_mesh`."""

    is_mesh: bool = False
    """True if the part is the whole mesh in the order of the mesh."""

    @cached_property
    def owned(self) -> Integers:
        """Positions (m,) of the nodes that this rank owns, chunk by chunk within each kind."""
        return np.concatenate([np.arange(*span) for span in self.spans.reshape(-1, 2)])


def chunking(ne: int) -> tuple[int, int]:
    """Return the number of chunks of a mesh of 6 ne^2 elements, and of elements of a chunk."""
    elements = 6 * max(ne, 1) ** 2
    block = BLOCK if elements >= 64 * BLOCK else 1  # kernels are faster on whole blocks
    each = min(block * -(-elements // (CHUNKS * block)), LARGEST_CHUNK)
    return -(-elements // each), each


def check_ranks(ne: int, ranks: int) -> None:
    """Raise ConfigError if a mesh has fewer chunks than there are ranks."""
    most, _ = chunking(ne)
    if ranks > most:
        raise ConfigError(
            f"a mesh of ne={ne} can be shared by at most {most} ranks, got {ranks}:"
            " take fewer ranks or a larger ne"
        )


RINGED = 6 * 20**2 * 4**2
"""Number of element nodes from which a part of a mesh is computed in strips, and a whole mesh
in rings: the caches hold smaller ones."""


def single_part(mesh: Mesh, shape: str) -> MeshPart:
    """Return the part of a single process: the whole mesh, with its elements in rings if large.

    shape: launch shape of the kernels; with one thread per node the order is that of the mesh.
    """
    if shape == "element" and mesh.nodes.size >= RINGED:
        part = Partition(mesh, 1, chunked=False).part(0)
        nodes, whole = np.bincount(np.minimum(part.counts, 3))[1:], np.array([[[0, mesh.size]]])
        return replace(part, interior_elements=mesh.elements, interior_nodes=nodes, spans=whole)
    return MeshPart(
        np.arange(mesh.elements), mesh.elements, np.arange(mesh.size), mesh.nodes,
        np.diff(mesh.gather_offsets), mesh.gather_entries, {}, {}, np.zeros(3, int),
        np.zeros((3, 0, 2), int), is_mesh=True,
    )  # fmt: skip


class Partition:
    """Assigns the elements and nodes of a mesh to `size` ranks, chunk by chunk along its rings.

    A rank has a belt of rings, so that all its elements on the rim are at one or both ends. A chunk
    owns the nodes that no earlier chunk touches. chunked: False for a whole mesh without chunks.
    """

    def __init__(self, mesh: Mesh, size: int, chunked: bool = True) -> None:
        """Find the rank of every element; raise ConfigError if chunks are fewer than ranks."""
        check_ranks(mesh.ne, size)
        chunks, per_chunk = chunking(mesh.ne) if chunked else (1, mesh.elements)
        self._mesh, self._points = mesh, mesh.np**2
        self._order = rings(mesh.ne)
        along = inverse_permutation(self._order)
        self._bounds = np.arange(size + 1) * chunks // size
        """(size + 1,) first chunk of each rank."""
        self._rank_of_chunk = np.repeat(np.arange(size), np.diff(self._bounds))
        short = chunks // 2  # between two ranks, if their number is even
        sizes = np.full(chunks, per_chunk)
        sizes[short] -= chunks * per_chunk - mesh.elements
        chunk = np.repeat(np.arange(chunks), sizes)[along]
        within = along - (np.cumsum(sizes) - sizes)[chunk]
        self._rank = self._rank_of_chunk[chunk]
        """(E,) rank of each element."""
        offsets = mesh.gather_offsets[:-1]
        element, point = np.divmod(mesh.gather_entries.astype(np.int64), self._points)
        first = np.minimum.reduceat(along[element] * self._points + point, offsets)
        first_element, first_point = np.divmod(first, self._points)
        first_element = self._order[first_element]
        self._owner = chunk[first_element]
        """(N,) chunk of each node."""
        self._counts = np.diff(mesh.gather_offsets)
        self._kind = np.minimum(self._counts, 3) - 1
        """(N,) 0 inside an element, 1 on an edge, 2 at a vertex."""
        in_blocks = not chunked or per_chunk % BLOCK == 0
        block, lane = np.divmod(within[first_element], BLOCK if in_blocks else 1)
        ranks = self._rank[element]
        lowest, highest = (f.reduceat(ranks, offsets) for f in (np.minimum, np.maximum))
        on_rim = (lowest != highest)[mesh.nodes].any(axis=(1, 2))
        self._late = sizes < per_chunk
        """(chunks,) True for chunks that come last on their rank: on the rim, or not full."""
        self._late[chunk[on_rim]] = True
        position = inverse_permutation(self._chunk_order(sizes))
        self._place = inverse_permutation(
            np.lexsort((lane, first_point, block, position[self._owner], self._kind))
        )
        """(N,) place of each node in an order like that of the mesh, but chunk by chunk."""
        self._chunk = chunk
        self._order = np.lexsort((within, position[chunk]))
        """(E,) elements rank by rank, in the order of their numbers there."""

    def _chunk_order(self, sizes: Integers) -> Integers:
        """Return the chunks rank by rank: those away from the rim by their distance, then others.

        Other chunks that are not full are the last ones.
        """
        chunks = np.arange(sizes.size)
        begin, end = (self._bounds[self._rank_of_chunk + k] for k in (0, 1))
        below = np.where(begin == 0, sizes.size, chunks - begin)
        above = np.where(end == sizes.size, sizes.size, end - 1 - chunks)
        distance = np.where(self._late, 0, np.minimum(below, above))
        return np.lexsort((distance, -sizes, self._late, self._rank_of_chunk))

    def part(self, rank: int) -> MeshPart:
        """Return the elements and nodes of a rank."""
        elements = self._order[self._rank[self._order] == rank]
        nodes, inverse = np.unique(self._mesh.nodes[elements], return_inverse=True)
        chunk = self._owner[nodes]
        turn = np.where(self._rank_of_chunk[chunk] == rank, self._late[chunk], 2)
        order = np.lexsort((self._place[nodes], turn, self._kind[nodes]))
        large = elements.size * self._points >= RINGED
        inside = np.bincount(self._kind[nodes[(turn == 0) & large]], minlength=3)
        nodes, node_of = nodes[order], inverse_permutation(order)[inverse]
        contributors, sends, receives = self._messages(rank, elements, nodes)
        away = int(np.sum(~self._late[self._chunk[elements]])) // BLOCK * BLOCK
        return MeshPart(
            elements, away, nodes, node_of, self._counts[nodes], contributors,
            sends, receives, inside, self._spans(rank, nodes),
        )  # fmt: skip

    def _messages(
        self, rank: int, elements: Integers, nodes: Integers
    ) -> tuple[Integers, dict[int, Integers], dict[int, int]]:
        mesh, counts = self._mesh, self._counts[nodes]
        node = np.repeat(np.arange(nodes.size), counts)
        skipped = mesh.gather_offsets[nodes] - (np.cumsum(counts) - counts)
        entries = mesh.gather_entries[skipped[node] + np.arange(node.size)].astype(np.int64)
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
        for other in neighbours.tolist():
            shared = np.zeros(nodes.size, dtype=bool)
            shared[node[owner == other]] = True
            going = np.flatnonzero(shared[node] & (owner == rank))
            sends[other] = contributors[going[np.argsort(entries[going])]]
        return contributors, sends, dict(zip(neighbours.tolist(), received.tolist(), strict=True))

    def _spans(self, rank: int, nodes: Integers) -> Integers:
        first, behind = self._bounds[rank : rank + 2]
        own = np.flatnonzero(self._rank_of_chunk[self._owner[nodes]] == rank)
        code = self._kind[nodes[own]] * (behind - first) + self._owner[nodes[own]] - first
        code, begins, lengths = np.unique(code, return_index=True, return_counts=True)
        spans = np.zeros((3 * (behind - first), 2), dtype=np.int64)
        spans[code] = np.stack([own[begins], own[begins] + lengths], axis=-1)
        return spans.reshape(3, -1, 2)


def dissection_order(mesh: Mesh) -> Integers:
    """Return an order (N,) of the nodes: halves of the sphere, each recursively, then the rest.

    The factors of a matrix that couples only nodes of the same element then have N log N entries
    instead of N^1.5 (George 1973, SIAM J. Numer. Anal. 10, 345-363).
    """
    centres = mesh.xyz[mesh.nodes].mean(axis=(1, 2))
    code = np.zeros(mesh.elements, dtype=np.int64)
    """(E,) binary digits: which half holds the element, which half of that half, and so on."""
    parts = [np.arange(mesh.elements)]
    for digit in reversed(range(mesh.elements.bit_length())):
        halves = []
        for part in parts:  # cut across its longest extent
            apart = centres[part] - centres[part].mean(axis=0)
            _, _, axes = np.linalg.svd(apart, full_matrices=False)
            order = part[np.argsort(apart @ axes[0], kind="stable")]
            lower, upper = np.split(order, [part.size // 2])
            code[upper] += 1 << digit
            halves += [half for half in (lower, upper) if half.size > 1]
        parts = halves
    owners = code[mesh.gather_entries // mesh.np**2]
    first = np.minimum.reduceat(owners, mesh.gather_offsets[:-1])
    last = np.maximum.reduceat(owners, mesh.gather_offsets[:-1])
    _, height = np.frexp((first ^ last).astype(np.float64))  # height of the smallest common part
    return np.lexsort((height, ((first >> height) + 1) << height))
