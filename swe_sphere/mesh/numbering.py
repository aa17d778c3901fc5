"""Unique numbers for the nodes of the cubed sphere, from integer lattice points of the cube.

With M = ne (np-1) every node of every element lies at a triple of integers in {0..M}^3 on the
surface of the cube, so nodes shared by elements or faces are found by comparing integers.
"""

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Int32 = NDArray[np.int32]

FACES: Integers = np.array(
    [
        # outward normal, direction of xi1, direction of xi2: right-handed
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    ]
)
"""The faces of the cube, (6, 3, 3): outward normal, direction of xi1, direction of xi2."""


BLOCK = 16
"""Elements whose nodes of one place in the element follow one another."""


def line_lattice(ne: int, np_: int) -> Integers:
    """Lattice coordinate (ne, np) of node i of element a along one edge of a face."""
    lattice: Integers = np.arange(ne)[:, None] * (np_ - 1) + np.arange(np_)
    return lattice


def element_lattice(ne: int, np_: int) -> tuple[Integers, Integers, Integers]:
    """Face (E,1,1) and lattice coordinates along xi1 (E,np,1) and xi2 (E,1,np) of each node.

    Element number: (face * ne + place along xi1) * ne + place along xi2.
    """
    line = line_lattice(ne, np_)
    face, first, second = np.indices((6, ne, ne)).reshape(3, -1)
    return face[:, None, None], line[first][:, :, None], line[second][:, None, :]


def number_nodes(
    face: Integers, first: Integers, second: Integers, last: int
) -> tuple[Int32, Integers]:
    """Number the nodes at face lattice coordinates: nodes inside elements, on edges, vertices.

    Returns the node numbers (E, np, np) and the lattice triples (N, 3) in {0..last}^3 of the nodes.
    The separate kinds let the processor foresee how many contributors DSS adds up at a node; within
    a kind the order in which nodes first appear keeps those of an element together in memory.
    """
    shape = np.broadcast_shapes(face.shape, first.shape, second.shape)
    # twice the coordinates, counted from the centre of the cube, are integers too
    doubled = [np.broadcast_to(c, shape) for c in (last, 2 * first - last, 2 * second - last)]
    axes = np.broadcast_to(FACES[face], (*shape, 3, 3))
    triples = (np.einsum("a...,...ak->...k", np.stack(doubled), axes) + last) // 2
    code = (triples[..., 0] * (last + 1) + triples[..., 1]) * (last + 1) + triples[..., 2]
    _, earliest, inverse, met = np.unique(
        code.ravel(), return_index=True, return_inverse=True, return_counts=True
    )
    element, point = np.divmod(earliest, shape[-1] ** 2)
    block, lane = np.divmod(element, BLOCK)
    order = np.lexsort((lane, point, block, np.minimum(met, 3)))
    number = np.empty(order.size, dtype=np.int32)
    number[order] = np.arange(order.size, dtype=np.int32)
    nodes = number[inverse].reshape(shape)
    return nodes, triples.reshape(-1, 3)[earliest[order]]


def contributors(nodes: Int32, size: int) -> tuple[Int32, Int32]:
    """CSR list of the flat element-node indices of each node: offsets (size+1,), entries."""
    flat = nodes.ravel()
    counts = np.bincount(flat, minlength=size)
    offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int32)
    return offsets, np.argsort(flat, kind="stable").astype(np.int32)
