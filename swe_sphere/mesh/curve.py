"""The order of the elements along a space-filling curve of the cube, whose pieces are compact."""

import numpy as np

from swe_sphere.mesh.numbering import Integers

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
