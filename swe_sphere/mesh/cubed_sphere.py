"""Equiangular gnomonic cubed sphere: points and tangent vectors of the plain (unplaced) cube.

Face coordinates alpha, beta in [-pi/4, pi/4]; the cube point is P = n + tan(alpha) t1 +
tan(beta) t2 and the sphere point P/|P| (Ronchi, Iacono & Paolucci 1996,
doi:10.1006/jcph.1996.0047).
"""

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.mesh.numbering import FACES, Integers, line_lattice


def lattice_tangents(ne: int, points: Array) -> Array:
    """tan(angle) (M+1,) at each lattice coordinate of a face, exactly antisymmetric, ends -1, 1."""
    middles = (np.arange(ne) + 0.5) / ne - 0.5
    angles = 0.5 * np.pi * (middles[:, None] + 0.5 * points / ne)
    lattice = line_lattice(ne, points.size)
    line = np.empty(lattice[-1, -1] + 1)
    line[lattice] = np.tan(angles)
    line = 0.5 * (line - line[::-1])
    line[0], line[-1] = -1.0, 1.0
    return line


def cube_points(triples: Integers, line: Array) -> tuple[Array, Array]:
    """Unit vectors (..., 3) and distances |P| (...) of the cube's lattice triples (..., 3)."""
    cube = line[triples]
    distance = np.sqrt(np.sum(cube**2, axis=-1))
    return cube / distance[..., None], distance


def sphere_tangents(
    face: Integers, lattice: tuple[Integers, Integers], line: Array, xyz: Array, distance: Array
) -> Array:
    """Tangents d(xyz)/d(alpha), d(xyz)/d(beta), (2, E, np, np, 3), at the points xyz, |P|.

    face (E,1,1), lattice coordinates (E,np,1) and (E,1,np), xyz (E,np,np,3), distance (E,np,np).
    """
    result = np.empty((2, *xyz.shape))
    for a, coordinate in enumerate(lattice):
        slope = 1.0 + line[coordinate] ** 2  # d tan(alpha)/d alpha
        dcube = slope[..., None] * FACES[face, 1 + a]
        along = np.sum(xyz * dcube, axis=-1, keepdims=True)
        result[a] = (dcube - xyz * along) / distance[..., None]
    return result


def locate(xyz: Array, ne: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Element number (T,) and xi1, xi2 in [-1, 1] (T,) of unit vectors (T, 3) of the plain cube."""
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
