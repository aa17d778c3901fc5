"""The mesh: spectral elements on the cubed sphere, their nodes, metric terms and connections."""

import math
import operator
from dataclasses import dataclass

import numpy as np

from swe_sphere.arrays import Array, Int32
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import cubed_sphere, gll
from swe_sphere.mesh.cubed_sphere import Placement
from swe_sphere.mesh.sphere import frame, longitude_latitude, snap_poles
from swe_sphere.planet import EARTH

LARGEST_STRETCH = 100.0
"""Largest stretch; beyond it almost no nodes remain on the side away from the centre."""


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """Spectral elements on the equiangular cubed sphere; built by `Mesh.build`.

    E = 6 ne^2 elements of np x np Gauss-Lobatto-Legendre nodes, N = 6 (ne (np-1))^2 + 2 unique
    nodes. Element node (e, i, j): i along xi1, j along xi2, both on [-1, 1]; (xi1, xi2, outward) is
    right-handed. The arrays are read-only.

    Examples:
        >>> from swe_sphere import Mesh
        >>> mesh = Mesh.build(ne=4, np=6, stretch=2.0, centre=(90.0, 30.0))
        >>> mesh.elements, mesh.size
        (96, 2402)
    """

    ne: int
    """Number of elements along an edge of the cube."""
    np: int
    """Number of GLL nodes along an edge of an element."""
    radius: float
    """Radius of the sphere [m]."""
    stretch: float
    """Schmidt refinement factor at the centre (1 = uniform)."""
    centre: tuple[float, float]
    """Longitude and latitude [degrees] of the centre of face 0."""
    spin: float
    """Rotation of the cube about the centre [degrees], anticlockwise."""
    gll_points: Array
    """(np,) points on [-1, 1]."""
    gll_weights: Array
    """(np,) quadrature weights, summing to 2."""
    derivative: Array
    """(np, np): (D f)_i is the derivative at point i of the polynomial with nodal values f."""
    xyz: Array
    """(N, 3) unit vectors."""
    lon: Array
    """(N,) longitude [rad] in [0, 2 pi), 0 at the poles."""
    lat: Array
    """(N,) latitude [rad]."""
    east: Array
    """(N, 3) first unit vector of each node's tangent frame."""
    north: Array
    """(N, 3) second unit vector of each node's tangent frame."""
    nodes: Int32
    """(E, np, np) node number of each element node."""
    basis: Array
    """(E, np, np, 2, 2) [m]: basis[..., i, k] = dx/dxi_i . frame_k; u_i = sum_k basis[i, k] V_k."""
    jacobian: Array
    """(E, np, np) [m2]: determinant of the basis, positive."""
    area: Array
    """(N,) [m2]: nodal quadrature weights, summing to 4 pi radius^2 up to quadrature error."""
    gather_offsets: Int32
    """(N+1,) start of each node's contributors in gather_entries."""
    gather_entries: Int32
    """(E np^2,) flat element-node indices (e np^2 + i np + j), node by node, ascending."""

    @staticmethod
    def build(
        ne: int, np: int, radius: float = EARTH.radius, stretch: float = 1.0,
        centre: tuple[float, float] = (0.0, 0.0), spin: float = 0.0,
    ) -> "Mesh":  # fmt: skip
        """Build the cubed sphere of 6 ne^2 elements with np x np GLL nodes each.

        radius [m]; centre = (lon, lat) [degrees] is the position of the centre of cube face 0; spin
        [degrees] rotates the cube anticlockwise about that point; stretch is the factor by which
        the mesh is finer there (coarser at the antipode). Raises ConfigError if out of range.
        """
        ne, np, placement = check_settings(ne, np, radius, stretch, centre, spin)
        return _assemble(ne, np, float(radius), placement)

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def elements(self) -> int:
        """Number of elements E = 6 ne^2."""
        return 6 * self.ne**2

    @property
    def size(self) -> int:
        """Number of nodes N = 6 (ne (np-1))^2 + 2."""
        return 6 * (self.ne * (self.np - 1)) ** 2 + 2

    @property
    def placement(self) -> Placement:
        """The rotation and stretching that put the cube on the sphere."""
        return Placement(self.centre, self.spin, self.stretch)

    def quads(self) -> Int32:
        """Return the corner nodes (E (np-1)^2, 4) of all quads, anticlockwise seen from outside."""
        n = self.nodes
        corners = [n[:, :-1, :-1], n[:, 1:, :-1], n[:, 1:, 1:], n[:, :-1, 1:]]
        return np.stack(corners, axis=-1).reshape(-1, 4)

    def cell_corners(self) -> tuple[Array, Array]:
        """Return longitude and latitude (N, 4) [rad] of each node cell's corners, anticlockwise.

        Each quad between four nodes contains one corner. The corners cut the reference square in
        proportion to the quadrature weights, so that on a square element the area of a cell is the
        weight of its node. The cells cover the sphere; edges are great circles. At the corners of
        the cube a cell has three corners, of which the last is repeated.
        """
        at = gll.lagrange(self.gll_points, np.cumsum(self.gll_weights)[:-1] - 1.0)
        inside = np.einsum("ai,bj,eijx->eabx", at, at, self.xyz[self.nodes]).reshape(-1, 3)
        inside /= np.linalg.norm(inside, axis=1)[:, None]
        quads = self.quads()
        turn = np.empty(quads.shape)
        for k, node in enumerate(quads.T):  # one at a time, to save memory on large meshes
            away = inside - self.xyz[node]
            north, east = (np.einsum("qx,qx->q", away, x[node]) for x in (self.north, self.east))
            turn[:, k] = np.arctan2(north, east)
        order = np.lexsort((turn.ravel(), quads.ravel())) // 4
        number = np.bincount(quads.ravel(), minlength=self.size)
        starts = np.cumsum(number) - number
        around = order[starts[:, None] + np.minimum(np.arange(4), number[:, None] - 1)]
        lon, lat = longitude_latitude(inside)
        return lon[around], lat[around]

    @property
    def quadrature(self) -> Array:
        """Quadrature weights (np, np) of the nodes of an element on [-1, 1]^2."""
        return np.outer(self.gll_weights, self.gll_weights)

    def spacing(self) -> tuple[float, float]:
        """Return the smallest and largest mean node spacing of the elements [m].

        The mean spacing of an element is the square root of its area, divided by np - 1.
        """
        areas = np.einsum("i,j,eij->e", self.gll_weights, self.gll_weights, self.jacobian)
        mean = np.sqrt(areas) / (self.np - 1)
        return float(mean.min()), float(mean.max())

    def __repr__(self) -> str:
        return (
            f"Mesh(ne={self.ne}, np={self.np}, radius={self.radius}, stretch={self.stretch}, "
            f"centre={self.centre}, spin={self.spin})"
        )


def check_settings(
    ne: int, np: int, radius: float, stretch: float, centre: tuple[float, float], spin: float
) -> tuple[int, int, Placement]:
    """Return ne, np and the placement of a mesh; raise ConfigError as `Mesh.build` does."""
    given = f"ne={ne!r}, np={np!r}, {radius=}, {stretch=}, {centre=}, {spin=}"
    try:
        ne, np = operator.index(ne), operator.index(np)
        lon, lat = map(float, centre)
        radius, stretch, spin = map(float, (radius, stretch, spin))
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(f"a mesh needs numbers, whole ones for ne and np, got {given}") from None
    if ne < 1:
        raise ConfigError(f"ne={ne}: a cube edge must have at least one element")
    if not 3 <= np <= 16:
        raise ConfigError(f"np={np}: the number of nodes along an element edge must be 3 to 16")
    if 6 * (ne * np) ** 2 >= 2**31:
        raise ConfigError(f"ne={ne} with np={np} is too large a mesh: take a smaller ne")
    if not (radius > 0.0 and 0.0 < radius * radius < math.inf):
        raise ConfigError(f"radius={radius}: the radius must be a positive length in metres")
    if not 1.0 <= stretch <= LARGEST_STRETCH:
        raise ConfigError(f"stretch={stretch}: the factor must be 1 to {LARGEST_STRETCH:g}")
    if not (math.isfinite(lon) and abs(lat) <= 90.0):
        raise ConfigError(
            f"centre={(lon, lat)}: give longitude and latitude in degrees, |latitude| <= 90"
        )
    if not math.isfinite(spin):
        raise ConfigError(f"spin={spin}: the rotation of the cube must be a finite angle")
    return ne, np, Placement((lon, lat), spin, stretch)


def _assemble(ne: int, np_: int, radius: float, placement: Placement) -> Mesh:
    points = gll.gll_points(np_)
    weights = gll.gll_weights(points)
    nodes, plain, tangents = cubed_sphere.build_cube(ne, points)
    xyz = snap_poles(placement.place(plain))
    tangents = placement.place_tangent(plain[nodes], tangents)
    lon, lat = longitude_latitude(xyz)
    east, north = frame(lon, lat)
    along = [np.einsum("aeijk,eijk->eija", tangents, unit[nodes]) for unit in (east, north)]
    basis = radius * np.stack(along, axis=-1)
    jacobian = basis[..., 0, 0] * basis[..., 1, 1] - basis[..., 0, 1] * basis[..., 1, 0]
    local = jacobian * weights[:, None] * weights
    flat = nodes.ravel()
    area = np.bincount(flat, weights=local.ravel()).astype(np.float64)
    offsets = np.concatenate(([0], np.cumsum(np.bincount(flat)))).astype(np.int32)
    entries = np.argsort(flat, kind="stable").astype(np.int32)
    return Mesh(
        ne, np_, radius, placement.stretch, placement.centre, placement.spin,
        points, weights, gll.derivative_matrix(points), xyz, lon, lat, east, north,
        nodes, basis, jacobian, area, offsets, entries,
    )  # fmt: skip
