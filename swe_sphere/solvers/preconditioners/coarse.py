"""Coarse corrections of smooth waves and of computational modes, one for each, added up.

Each rank holds the functions of its elements and a ring around, exchanged between Chebyshev steps.
"""

from __future__ import annotations  # scipy.sparse is loaded where it is used

from typing import Any

import numpy as np
import scipy
import warp as wp
from numpy.polynomial import legendre
from numpy.typing import NDArray

from swe_sphere.arrays import Array, Integers, inverse_permutation
from swe_sphere.kernels import Register
from swe_sphere.kernels.coarse import assemble, transfer_kernels
from swe_sphere.mesh import Mesh, cubed_sphere
from swe_sphere.mesh.partition import RINGED
from swe_sphere.mesh.sphere import position
from swe_sphere.operators import sparse
from swe_sphere.operators.device_mesh import Field
from swe_sphere.operators.halo import Halo
from swe_sphere.operators.lane_matrices import MOST, SlicedMatrix, TallMatrix, vector
from swe_sphere.operators.schur import SchurOperator
from swe_sphere.operators.sparse import ElementSpace
from swe_sphere.solvers.preconditioners.chebyshev import chebyshev_steps, spectral_bound

CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))
"""Element corners (end along xi1, end along xi2)."""


def coarse_spaces(mesh: Mesh) -> list[ElementSpace]:
    """Return three spaces: smooth functions, and computational modes at V = 6 ne^2 + 2 vertices.

    Modes alternate from node to node in both directions (second space) or in one of them (third),
    paired across element boundaries: two at each vertex. At the eight cube corners, where three
    elements meet, directions cannot be paired: there is one mode with both (2V - 8 in all).
    """
    vertices = _numbered(mesh, np.array([0, mesh.np - 1]))
    hat = 0.5 * (1.0 - mesh.gll_points)
    pattern = hat * legendre.legval(-mesh.gll_points, np.eye(mesh.np)[-1])
    along_either = np.concatenate([_products(pattern, hat), _products(hat, pattern)], axis=1)
    turned, corner = _turned(vertices), np.bincount(vertices.ravel())[vertices] == 3
    renumbered = np.cumsum(np.bincount(vertices.ravel()) != 3, dtype=np.int32) - 1
    belongs = np.concatenate([~turned | corner, turned | corner], axis=1)
    first, second = np.tile(vertices, 2), np.tile(renumbered[vertices] + vertices.max() + 1, 2)
    return [
        smooth_functions(mesh),
        ElementSpace(_products(pattern, pattern), vertices),
        ElementSpace(along_either, np.where(belongs, first, second)),
    ]


def smooth_functions(mesh: Mesh) -> ElementSpace:
    """Return bilinear hats for the smooth waves on the cells between about every third GLL node.

    One hat per element would burden the smoother too much if an edge has more than four nodes.
    """
    cells = -(-(mesh.np - 1) // 3)
    cells += mesh.np % 2 == 0 and cells % 2 == 0  # there is no middle node to separate them
    points = mesh.gll_points
    kept = np.abs(points[:, None] - np.linspace(-1.0, 1.0, cells + 1)).argmin(axis=0)
    kept[cells // 2 + 1 :] = mesh.np - 1 - kept[: cells - cells // 2][::-1]
    hats = np.stack([np.interp(points, points[kept], h) for h in np.eye(cells + 1)])
    hats = 0.5 * (hats + hats[::-1, ::-1])  # the same bits from either end
    values = np.einsum("pi,qj->ijpq", hats, hats).reshape(mesh.np**2, -1)
    return ElementSpace(values, _numbered(mesh, kept))


def _numbered(mesh: Mesh, kept: Integers) -> NDArray[np.int32]:
    """Return numbers (E, k*k) of the nodes at the `kept` k GLL points in both directions.

    They follow the lines of each face, so that their neighbours are at few distances: along xi1 on
    large meshes, whose elements are in rings, else along xi2, as elements follow in memory.
    """
    nodes = mesh.nodes[:, kept][:, :, kept].reshape(6, mesh.ne, mesh.ne, kept.size, kept.size)
    axes = (0, 2, 4, 1, 3) if mesh.nodes.size >= RINGED else (0, 1, 3, 2, 4)
    lines = nodes.transpose(axes)
    _, first, inverse = np.unique(lines.ravel(), return_index=True, return_inverse=True)
    numbers = inverse_permutation(np.argsort(first))[inverse].reshape(lines.shape)
    return numbers.transpose(np.argsort(axes)).reshape(mesh.elements, -1).astype(np.int32)


def _products(along_1: Array, along_2: Array) -> Array:
    """Return the products (np*np, 4) of two functions of the distance from each corner."""
    sides = [np.outer(along_1[:: 1 - 2 * p], along_2[:: 1 - 2 * q]).ravel() for p, q in CORNERS]
    return np.stack(sides, axis=1)


def _turned(vertices: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return (E, 4) flags: direction 1 of the element is the second one of its corner's vertex.

    The first direction of a vertex is direction 1 of the first element there. Around a vertex of
    four elements the directions of the edges alternate, so the anticlockwise order of the two
    changes from an element to its neighbour; neighbours share an edge, given by its far end. All
    elements are right-handed: at a corner with equal ends direction 1 comes first.
    """
    far_1, far_2 = vertices[:, [2, 3, 0, 1]].ravel(), vertices[:, [1, 0, 3, 2]].ravel()
    _, first, inverse = np.unique(vertices.ravel(), return_index=True, return_inverse=True)
    first = first[inverse]
    leads = np.tile([p == q for p, q in CORNERS], len(vertices))
    neighbour = np.zeros(leads.size, dtype=bool)
    for mine in (far_1, far_2):
        neighbour |= (mine == far_1[first]) | (mine == far_2[first])
    turned: NDArray[np.bool_] = np.where(neighbour, leads == leads[first], leads != leads[first])
    turned[first] = False
    return turned.reshape(-1, 4)


def _mass(mesh: Mesh, space: ElementSpace) -> scipy.sparse.csr_array:
    """Return the integrals (V, V) [m2] of the products of functions."""
    area = (mesh.quadrature * mesh.jacobian).reshape(mesh.elements, -1, 1)
    products = space.values.T @ (area * space.values)
    return space.matrix(space.numbers, products).tocsr()


class CoarsePart:
    """Functions and elements of this rank; a single process owns all.

    The methods transfer between fields and coefficients of these functions.
    """

    def __init__(
        self, operator: SchurOperator, spaces: list[ElementSpace], gradients: list[Any]
    ) -> None:
        """Find the functions of this rank; gradients (2N, V): those of the computational modes."""
        mesh, launch = operator.mesh, operator.mesh.launch
        self._mesh, self._launch, self._here = mesh, launch, mesh.part.element_numbers
        self._numbers = _numbers(spaces)
        self._mine = np.unique(self._numbers[self._here])
        self._is_mine = np.zeros(self._numbers.max() + 1, dtype=bool)
        self._is_mine[self._mine] = True
        self.functions = self._mine
        """Numbers (n,) of the functions of this rank, ascending."""
        self._away: dict[int, Integers] = {}
        self._owner = np.zeros(len(self._numbers), dtype=int)
        if mesh.comm.shared:
            reach = _reach(spaces[0], gradients)
            rows = np.unique(reach.T.tocsr()[self._mine].indices)
            self.functions = np.unique(reach[rows].indices)
            for rank, elements in enumerate(mesh.comm.allgather(self._here)):
                self._owner[elements] = rank
            needed = np.flatnonzero(self._is_mine[self._numbers].any(axis=1))
            self._away = _by_rank(needed, self._owner[needed])
            self._away.pop(mesh.comm.rank, None)
        count, groups = self._numbers.shape[1], mesh.groups
        made = transfer_kernels(mesh.types(whole=False), count)
        self._restrict, self._prolong, (few, many) = made
        (self._assemble,) = launch.compile(Register(mesh.real, mesh.lanes), assemble)
        launch.load(self._restrict, self._prolong)
        self._dims = (groups, count // few), (groups, mesh.points // many)
        self._values = mesh.upload(np.concatenate([space.values for space in spaces], axis=1).T)
        self._mass = mesh.on_elements(mesh.mesh.quadrature * mesh.mesh.jacobian[self._here])
        self._of_elements = mesh.on_elements(self.here(self._numbers[self._here]), scalar=wp.int32)
        size = count * (groups * mesh.lanes + sum(map(len, self._away.values())))
        self._integrals, places = vector(mesh, size + 1), self._places()
        self._local = self._integrals.values[: groups * count].reshape((groups, count))
        exchange = (mesh.comm.requests(self._away), self._away)
        of_integrals = ({r: places[e] for r, e in each.items()} for each in exchange)
        mesh.register_exchange(self._integrals.flat, *of_integrals)
        self._contributions = self._contributing(places, size)

    def restrict(self, b: Field, out: Field) -> None:
        """Set out to the integrals of b [m] times each function [m3]."""
        inputs = self._values, self._mass, b.values, self._local
        self._mesh.over_elements(self._integrals, self._restrict, self._dims[0], *inputs)
        contributions = *self._contributions, self._integrals.flat
        self._launch(self._assemble, out.values.size, *contributions, out.values)

    def prolong(self, coefficients: Field, x: Field) -> None:
        """Add the functions times their coefficients to x."""
        inputs = self._values, self._of_elements, coefficients.flat, x.values
        self._mesh.over_elements(None, self._prolong, self._dims[1], *inputs)

    def square(self, matrix: Any) -> scipy.sparse.csr_array:
        """Return rows and columns of this rank's functions, without entries in rows of the ring."""
        kept = scipy.sparse.diags_array(self._is_mine[self.functions].astype(matrix.dtype))
        square: scipy.sparse.csr_array = (kept @ matrix[self.functions][:, self.functions]).tocsr()
        square.eliminate_zeros()
        return square

    def here(self, functions: Integers) -> Integers:
        """Return the indices of `functions` among the functions of this rank."""
        return np.searchsorted(self.functions, functions)

    def owner_of(self, functions: Integers) -> Integers:
        """Return the ranks (V',) to which the first elements of `functions` belong."""
        _, first = np.unique(self._numbers, return_index=True)
        return np.asarray(self._owner[first[functions] // self._numbers.shape[1]])

    def messages(self, functions: Integers) -> tuple[dict[int, Integers], dict[int, Integers]]:
        """Return indices here of functions that ranks request, and the `functions`, by rank."""
        wanted = _by_rank(functions, self.owner_of(functions))
        return {r: self.here(f) for r, f in self._mesh.comm.requests(wanted).items()}, wanted

    def ring(self) -> tuple[dict[int, Integers], dict[int, Integers]]:
        """Return indices of functions in the rings of other ranks, and of its own ring, by rank."""
        sends, ring = self.messages(np.setdiff1d(self.functions, self._mine))
        return sends, {r: self.here(functions) for r, functions in ring.items()}

    def _places(self) -> Integers:
        """Return offsets (E, k) of integrals in (groups, k, lanes), other ranks' behind these."""
        lanes, k = self._mesh.lanes, self._numbers.shape[1]
        group, lane = np.divmod(np.arange(self._here.size), lanes)
        places = np.full(self._numbers.shape, -1)
        places[self._here] = (group[:, None] * k + np.arange(k)) * lanes + lane[:, None]
        away = np.concatenate([*self._away.values(), np.zeros(0, dtype=int)])
        places[away] = self._mesh.groups * k * lanes + np.arange(away.size * k).reshape(-1, k)
        return places

    def _contributing(self, places: Integers, size: int) -> tuple[wp.array, wp.array, wp.array]:
        """Return the contributions to functions as `assemble` reads them, in the mesh's order.

        A missing contribution, as to functions of the ring, points to `size`, where there is 0.
        """
        element, slot = np.nonzero(self._is_mine[self._numbers])
        row, lanes = self.here(self._numbers[element, slot]), self._mesh.lanes
        order = np.argsort(row, kind="stable")
        counts = np.bincount(row, minlength=self.functions.size)
        within = np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts)
        table = np.full((-(-counts.size // lanes), counts.max(), lanes), size, dtype=np.int32)
        group, lane = np.divmod(row[order], lanes)
        table[group, within, lane] = places[element, slot][order]
        exist = (table != size).any(axis=2)
        exist[:, 0] = True
        at = wp.array(np.cumsum([0, *exist.sum(axis=1)]), wp.int32, device=self._mesh.device)
        return at, *self._mesh.runs(table[exist])


def _by_rank(numbers: Integers, ranks: Integers) -> dict[int, Integers]:
    """Return the numbers (n,) grouped by rank; ranks (n,): the rank of each number."""
    return {r: numbers[ranks == r] for r in np.unique(ranks).tolist()}


def _numbers(spaces: list[ElementSpace]) -> Integers:
    """Return numbers (E, k) of the functions on each element, one space after the other."""
    starts = np.cumsum([0, *(int(space.numbers.max()) + 1 for space in spaces)])
    numbers = [space.numbers + start for space, start in zip(spaces, starts[:-1], strict=True)]
    return np.concatenate(numbers, axis=1, dtype=np.int32)


NEGLIGIBLE = 0.01
"""Size of omitted couplings of computational modes, relative to the diagonal."""
RIDGE = 1e-4
"""Relative increase of the diagonal of a matrix of long waves, which may depend on one another."""
DROP_TOLERANCE = 1e-4
"""Largest size of omitted entries of an inverse, relative to the diagonal."""
SMALL = 1e-6
"""Sum of the coefficients of a wave up to which it counts as zero."""
STEPS = 5
"""Number of Chebyshev steps; with four, fine meshes need more iterations."""
SPACING, SPACING_OF_MODES = 5, 12
"""Cells of smooth functions, and elements with modes, along an element of the long waves' mesh."""
FINEST = 20
"""Largest ne of the mesh of long waves, whose full matrices have size 6 ne^2 + 2."""


class CoarseCorrection:
    """x += sum over the spaces of P_k S_k^-1 P_k^T M b, all inverses by Chebyshev steps.

    The smooth waves have the compact Helmholtz operator, the computational modes the Galerkin
    operators of S. Of both the longest waves are first solved for exactly, on meshes so coarse that
    dense inverses suffice: in the longest waves of a mode S is about 1, far below its diagonal.
    """

    def __init__(self, operator: SchurOperator) -> None:
        mesh, spaces = operator.mesh.mesh, coarse_spaces(operator.mesh.mesh)
        self._operator, self._hats = operator, spaces[0]
        self._mass, *masses = [_mass(mesh, space) for space in spaces]
        gradients = [sparse.gradients(mesh, space, np.float32) for space in spaces[1:]]
        self._modes = list(zip(masses, gradients, strict=True))
        self._longest = longest_waves(mesh, spaces)
        longest = scipy.sparse.block_diag(self._longest, format="csr")
        count, few = longest.shape
        self._part = CoarsePart(operator, spaces, gradients)
        vectors = (vector(operator.mesh, self._part.functions.size) for _ in range(4))
        self._b, self._x, self._new, self._per_diagonal = vectors
        self._few = vector(operator.mesh, few), vector(operator.mesh, few)
        self._spread = TallMatrix(operator.mesh, longest[self._part.functions])
        self._gather, self._all_b = self._spread.transposed, self._b
        if operator.mesh.comm.shared:
            launch, comm = operator.mesh.launch, operator.mesh.comm
            of_wave = self._part.owner_of(abs(longest).argmax(axis=0))
            mine = longest @ scipy.sparse.diags_array((of_wave == comm.rank).astype(np.float32))
            mine.eliminate_zeros()
            rows = np.flatnonzero(np.diff(mine.indptr))
            self._gather = TallMatrix(operator.mesh, mine).transposed
            self._all_b, once = vector(operator.mesh, count), self._few[0].flat
            self._join = Halo(launch, self._b.flat, *self._part.messages(rows), self._all_b.flat)
            """The integrals of the functions in the waves of this rank."""
            waves = _by_rank(np.arange(few), of_wave)
            sends = {r: waves[comm.rank] for r in range(comm.size) if comm.rank in waves}
            self._share = Halo(launch, once, sends, waves)
            """The sums of all waves, each from the rank where the wave is largest."""
            ring = self._part.ring()
            for each in (self._x, self._new):
                operator.mesh.register_exchange(each.flat, *ring)

    def setup(self, tau: float, depth: Array) -> None:
        """Build operators for the implicit step tau [s] and depth (N,) [m]."""
        schur = self._operator.matrix
        compact = sparse.stiffness(schur.mesh, schur.weight(tau, depth), self._hats)
        smooth = self._mass + tau**2 * schur.gravity * compact
        modes = [schur.galerkin(mass, gradients, tau, depth) for mass, gradients in self._modes]
        exact = map(_inverse, (smooth, *modes), self._longest)
        self._exact = TallMatrix(self._operator.mesh, scipy.sparse.block_diag([*exact], "csr"))
        for each in modes:
            _omit_small(each)
        matrix = scipy.sparse.block_diag([smooth, *modes], format="csr", dtype=np.float32)
        inverse = 1.0 / matrix.diagonal()
        matrix.data *= np.repeat(inverse, np.diff(matrix.indptr))
        self._sizes = chebyshev_steps(STEPS, spectral_bound(matrix.__matmul__, inverse.size))
        unit = float(np.abs(matrix.data).max()) / MOST
        self._matrix = SlicedMatrix(self._operator.mesh, self._part.square(matrix), unit)
        self._operator.mesh.write(inverse[self._part.functions], self._per_diagonal.flat)

    def correct(self, b: Field, x: Field, add: bool = True) -> None:
        """Add the correction for the residual b to x, or set x to it."""
        now, new = self._x, self._new
        self._part.restrict(b, self._b)
        self._solve_longest(now)
        for number, size in enumerate(self._sizes, 1):
            self._matrix.chebyshev_step(size, self._per_diagonal, self._b, now, new)
            if number < len(self._sizes):
                self._operator.mesh.exchange(new)
            now, new = new, now
        if not add:
            x.values.zero_()
        self._part.prolong(now, x)

    def _solve_longest(self, out: Field) -> None:
        """Set out = P A^-1 P^T b for the longest waves."""
        once, twice = self._few
        if self._all_b is not self._b:
            self._join()
        self._gather(self._all_b, once)
        if self._all_b is not self._b:
            self._share()
        self._exact(once, twice)
        self._spread(twice, out)


def longest_waves(mesh: Mesh, spaces: list[ElementSpace]) -> list[scipy.sparse.csr_array]:
    """Return long waves in the spaces of `coarse_spaces`: coefficients (V, m) of the functions.

    They are the values of hats on a coarse mesh at the vertices of the functions. If np is even,
    modes have opposite signs at neighbours in each direction in which they alternate. As these are
    directions of a face of the cube, each face has its own waves of modes.
    """
    nodes = _vertices(mesh, spaces[0])
    waves = [_hats(mesh, nodes, np.sqrt((nodes.size - 2) / 6.0) / SPACING)]
    for space in spaces[1:]:
        _, first = np.unique(space.numbers, return_index=True)
        element, slot = np.divmod(first, space.numbers.shape[1])
        kind, corner = np.divmod(slot, len(CORNERS))
        face, *place = np.unravel_index(element, (6, mesh.ne, mesh.ne))
        i, j = np.array(place) + np.array(CORNERS)[corner].T
        distance = i + j if space is spaces[1] else np.where(kind == 0, i, j)
        signs = (-1.0) ** ((mesh.np - 1) * distance)
        values = _hats(mesh, _vertices(mesh, space), mesh.ne / SPACING_OF_MODES)
        of_faces = (signs * (6 * kind + face == k) for k in range(6 * (1 + kind.max())))
        parts = [scipy.sparse.diags_array(of_face) @ values for of_face in of_faces]
        waves.append(scipy.sparse.hstack(parts, format="csr"))
    return [each[:, abs(each).sum(axis=0) > SMALL] for each in waves]


def _vertices(mesh: Mesh, space: ElementSpace) -> NDArray[np.integer]:
    """Return the nodes (V,) at which the functions are largest."""
    nodes = mesh.nodes.reshape(mesh.elements, -1)[:, space.values.argmax(axis=0)]
    return nodes.ravel()[np.unique(space.numbers, return_index=True)[1]]


def _hats(mesh: Mesh, nodes: NDArray[np.integer], ne: float) -> scipy.sparse.csr_array:
    """Return values (V, m) at nodes of bilinear hats on a mesh with about `ne` elements."""
    ne = min(max(2, round(ne)), FINEST)
    vertices = _numbered(Mesh.build(ne, 3), np.array([0, 2]))
    points = mesh.placement.lift(position(mesh.lon[nodes], mesh.lat[nodes]))
    element, *places = cubed_sphere.locate(points, ne)
    first, second = (0.5 + 0.5 * np.stack([-xi, xi], axis=-1) for xi in places)
    values = (first[:, :, None] * second[:, None, :]).ravel()
    entries = values, vertices[element].ravel(), 4 * np.arange(nodes.size + 1)
    return scipy.sparse.csr_array(entries, shape=(nodes.size, vertices.max() + 1))


def _inverse(
    matrix: scipy.sparse.csr_array, waves: scipy.sparse.csr_array
) -> scipy.sparse.csr_array:
    """Return the inverse (m, m) of a symmetric matrix (V, V) in the space of waves (V, m).

    For short steps it falls off within a few functions. In float32, most of the other entries
    would be subnormal numbers, with which processors are many times slower.
    """
    few = (waves.T @ matrix @ waves).toarray(order="F")
    diagonal = np.diag_indices_from(few)
    few[diagonal] *= 1.0 + RIDGE
    root, _ = scipy.linalg.lapack.dpotrf(few, overwrite_a=True)
    few, _ = scipy.linalg.lapack.dpotri(root, overwrite_c=True)  # the upper triangle
    scale = np.sqrt(few[diagonal])
    few[np.abs(few) < DROP_TOLERANCE * scale * scale[:, None]] = 0.0
    few[diagonal] *= 0.5
    half = scipy.sparse.csr_array(few, dtype=np.float32)
    return half + half.T


def _reach(smooth: ElementSpace, gradients: list[Any]) -> scipy.sparse.csr_array:
    """Return rows of functions that couple: smooth ones by element, modes by common gradients."""
    element, function = np.indices(smooth.numbers.shape)[0].ravel(), smooth.numbers.ravel()
    of_elements = scipy.sparse.csr_array((np.ones(element.size), (element, function)))
    return scipy.sparse.block_diag([of_elements, *gradients], format="csr")


def _omit_small(matrix: scipy.sparse.csr_array) -> None:
    """Remove the entries of a matrix that are NEGLIGIBLE relative to the diagonal."""
    scale = np.sqrt(matrix.diagonal())
    least = NEGLIGIBLE * np.repeat(scale, np.diff(matrix.indptr)) * scale[matrix.indices]
    matrix.data[np.abs(matrix.data) <= least] = 0.0
    matrix.eliminate_zeros()
