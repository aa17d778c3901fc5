"""Nested dissection of the nodes: an order in which sparse factors fill in little."""

import numpy as np
from numpy.typing import NDArray

from swe_sphere.arrays import Array
from swe_sphere.mesh.mesh import Mesh

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
