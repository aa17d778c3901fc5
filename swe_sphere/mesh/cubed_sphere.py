"""Equiangular gnomonic cubed sphere: its nodes, points, tangent vectors and placement.

With M = ne (np-1) every node of every element lies at a triple of integers in {0..M}^3 on the
surface of the cube, so nodes shared by elements or faces are found by comparing integers.

Face coordinates alpha, beta in [-pi/4, pi/4]; the cube point is P = n + tan(alpha) t1 + tan(beta)
t2 and the sphere point P/|P| (Ronchi, Iacono & Paolucci 1996, doi:10.1006/jcph.1996.0047).

A rotation and then a Schmidt stretching about its centre place the cube on the sphere. The Schmidt
transformation (Schmidt 1977; Courtier & Geleyn 1988, doi:10.1002/qj.49711448303) is the conformal
map of the sphere that shortens lengths s times at a centre c and lengthens them s times at its
antipode. With D = (s^2-1)/(s^2+1) and mu = n.c it reads n' = [(D + mu) c + sqrt(1 - D^2) (n - mu
c)] / (1 + D mu). The code multiplies numerator and denominator by s^2 + 1 and computes 1 +- mu as
|n +- c|^2 / 2, which keeps all digits at the antipode.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array, Int32, Integers, inverse_permutation
from swe_sphere.mesh.sphere import frame, position

FACES: Integers = np.array([
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
])  # fmt: skip
"""The faces of the cube, (6, 3, 3): outward normal, directions of xi1 and xi2; right-handed."""

BLOCK = 16
"""Number of elements in a block, in which nodes at the same point of each element are adjacent."""


def _lattice(ne: int, np_: int) -> Integers:
    """Return the lattice coordinates (ne, np): [a, i] of node i of element a along an edge."""
    return np.arange(ne)[:, None] * (np_ - 1) + np.arange(np_)


def lattice_tangents(ne: int, points: Array) -> Array:
    """Return tan(alpha) (M+1,), antisymmetric, at the lattice coordinates for GLL points (np,)."""
    middles = (np.arange(ne) + 0.5) / ne - 0.5
    lattice = _lattice(ne, points.size)
    line = np.empty(lattice[-1, -1] + 1)
    line[lattice] = np.tan(0.5 * np.pi * (middles[:, None] + 0.5 * points / ne))
    line = 0.5 * (line - line[::-1])
    line[0], line[-1] = -1.0, 1.0
    return line


def build_cube(ne: int, points: Array) -> tuple[Int32, Array, Array]:
    """Return node numbers (E, np, np), unit vectors (N, 3) and tangents dx/dxi (2, E, np, np, 3).

    points: GLL points (np,). Element number: (face * ne + i) * ne + j, i along xi1, j along xi2.
    """
    line, lattice = lattice_tangents(ne, points), _lattice(ne, points.size)
    face, first, second = np.indices((6, ne, ne)).reshape(3, -1)
    axes = FACES[face][:, None, None]
    along = lattice[first][:, :, None], lattice[second][:, None, :]
    nodes, triples = _number_nodes(axes, *along, line.size - 1)
    cube = line[triples]
    distance = np.sqrt(np.sum(cube**2, axis=-1))
    xyz = cube / distance[..., None]
    radius, outward, tangents = distance[nodes], xyz[nodes], np.empty((2, *nodes.shape, 3))
    for a, coordinate in enumerate(along):
        slope = 1.0 + line[coordinate] ** 2  # d tan(alpha)/d alpha
        dcube = slope[..., None] * axes[..., 1 + a, :]
        radial = np.sum(outward * dcube, axis=-1, keepdims=True)
        tangents[a] = (dcube - outward * radial) / radius[..., None]
    tangents *= 0.25 * np.pi / ne  # d alpha / d xi
    return nodes, xyz, tangents


def _number_nodes(
    axes: Integers, first: Integers, second: Integers, last: int
) -> tuple[Int32, Integers]:
    """Number the nodes at face lattice coordinates: first inside elements, then edges, vertices.

    Returns the node numbers (E, np, np) and the lattice triples (N, 3) in {0..last}^3 of the nodes.
    Separate kinds let the processor predict how many contributors DSS adds at a node. In a kind,
    sorting by block, point and element keeps the nodes of an element near each other in memory.
    """
    normal, one, two = np.moveaxis(axes, -2, 0)
    # twice the coordinates, counted from the centre of the cube, are integers too
    doubled = last * normal + (2 * first - last)[..., None] * one
    triples = (doubled + (2 * second - last)[..., None] * two + last) // 2
    code = np.ravel_multi_index(np.moveaxis(triples, -1, 0), (last + 1,) * 3)
    _, earliest, inverse, met = np.unique(
        code.ravel(), return_index=True, return_inverse=True, return_counts=True
    )
    element, point = np.divmod(earliest, code.shape[-1] ** 2)
    block, lane = np.divmod(element, BLOCK)
    order = np.lexsort((lane, point, block, np.minimum(met, 3)))
    number = inverse_permutation(order)
    return number[inverse].reshape(code.shape), triples.reshape(-1, 3)[earliest[order]]


def locate(xyz: Array, ne: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Return element numbers (T,) and xi1, xi2 in [-1, 1] (T,) of unit vectors (T, 3).

    The unit vectors are points of the plain cubed sphere.
    """
    outward = xyz @ FACES[:, 0].T
    face = np.argmax(outward, axis=-1)
    height = outward[np.arange(face.size), face]
    number, xi = face, []
    for a in (1, 2):
        angle = np.arctan(np.sum(xyz * FACES[face, a], axis=-1) / height)
        along = (angle / (0.5 * np.pi) + 0.5) * ne
        place = np.clip(np.floor(along).astype(np.int64), 0, ne - 1)
        number = number * ne + place
        xi.append(np.clip(2.0 * (along - place) - 1.0, -1.0, 1.0))
    return number, xi[0], xi[1]


def schmidt(n: Array, centre: Array, stretch: float) -> Array:
    """Move unit vectors n (..., 3) towards the unit vector centre (3,); inverted by 1/stretch."""
    plus, minus = _sides(n, centre, stretch)
    across = n - (n @ centre)[..., None] * centre
    moved: Array = (plus - minus)[..., None] * centre + 2.0 * stretch * across
    moved /= np.sqrt(np.sum(moved**2, axis=-1, keepdims=True))
    return moved


def _sides(n: Array, centre: Array, stretch: float) -> tuple[Array, Array]:
    """Return s^2 (1 + mu) and 1 - mu, both free of cancellation; the sum is (s^2+1)(1 + D mu)."""
    plus = 0.5 * stretch**2 * np.sum((n + centre) ** 2, axis=-1)
    minus = 0.5 * np.sum((n - centre) ** 2, axis=-1)
    return plus, minus


@dataclass(frozen=True)
class Placement:
    """The map from the cubed sphere before placement, called plain, to the mesh, and its inverse.

    The centre (+x) of face 0 goes to `centre` = (lon, lat) [degrees], the cube is turned by
    `spin` [degrees] anticlockwise about that point, then refined there by the factor `stretch`.
    """

    centre: tuple[float, float] = (0.0, 0.0)
    spin: float = 0.0
    stretch: float = 1.0

    @property
    def point(self) -> Array:
        """Unit vector (3,) of the centre."""
        return position(*np.radians(self.centre))

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3): its columns are the images of x, y and z."""
        east, north = frame(*np.radians(self.centre))
        spin = np.radians(self.spin)
        cos, sin = np.cos(spin), np.sin(spin)
        return np.stack([self.point, cos * east + sin * north, cos * north - sin * east], axis=1)

    def place(self, n: Array) -> Array:
        """Map points n (..., 3) of the plain cubed sphere to unit vectors (..., 3) of the mesh."""
        n = n @ self.rotation.T
        return schmidt(n, self.point, self.stretch) if self.stretch != 1.0 else n

    def place_tangent(self, n: Array, dn: Array) -> Array:
        """Return the derivative (..., 3) of `place` at n (..., 3) along tangents dn (..., 3)."""
        n, dn = n @ self.rotation.T, dn @ self.rotation.T
        if self.stretch == 1.0:
            return dn
        centre, stretch = self.point, self.stretch
        plus, minus = _sides(n, centre, stretch)
        dmu = (dn @ centre)[..., None]
        change: Array = (stretch**2 + 1.0) * dmu * centre + 2.0 * stretch * (dn - dmu * centre)
        change -= (stretch**2 - 1.0) * dmu * schmidt(n, centre, stretch)
        return change / (plus + minus)[..., None]

    def lift(self, n: Array) -> Array:
        """Invert `place`: map unit vectors (..., 3) of the mesh to the plain cubed sphere."""
        n = schmidt(n, self.point, 1.0 / self.stretch) if self.stretch != 1.0 else n
        return n @ self.rotation
