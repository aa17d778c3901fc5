"""Nested dissection: an order of the nodes of a mesh in which sparse factors stay small."""

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.mesh.cubed_sphere import Integers
from swe_sphere.mesh.mesh import Mesh


def dissection_order(mesh: Mesh) -> Integers:
    """Return (N,) nodes: those inside each half of the sphere, recursively, then those between.

    A factorisation of a matrix that couples nodes of one element alone then fills in N log N
    entries instead of N^1.5 (George 1973, SIAM J. Numer. Anal. 10, 345-363).
    """
    centres: Array = mesh.xyz[mesh.nodes].mean(axis=(1, 2))
    code = np.zeros(mesh.elements, dtype=np.int64)
    """(E,) numbers whose binary digits are the halves of halves that hold an element."""
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
    _, height = np.frexp((first ^ last).astype(np.float64))  # of the smallest common part
    end = ((first >> height) + 1) << height
    return np.lexsort((height, end))
