"""Bytes that ranks send in a step, from the mesh, its partition and the launches of one process.

The exchanges themselves are not consulted; scaling.py compares the result with the bytes sent.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import warp as wp

from swe_sphere import Simulation
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.partition import Partition
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.sparse import gradients
from swe_sphere.solvers.preconditioners.coarse import STEPS, coarse_spaces

FIELDS = {"tendency_of_groups": 3, "gradient": 2, "wind_fluxes": 1, "slope_fluxes": 1}
"""Number of fields that kernels over elements send to other ranks at a shared node: rates of wind
and depth, both components of a gradient, a divergence."""
RESTRICT = "restrict"
"""Name of the first kernel of a coarse correction: integrals over the elements."""
SINGLE = 4
"""Bytes per number of the coarse level."""

Launches = Mapping[str, float]
"""Number of launches per step by name of the kernel and bytes of its numbers."""


def launches(sim: Simulation, steps: int) -> Launches:
    """Return the launches per step of kernels whose results are exchanged, on a single process."""
    found = Counter[str]()
    with each_launch(sim.model.launch) as made:
        for _ in range(steps):
            sim.step()
    for kernel, _, _ in made:
        name = re.search(r"^(?:\w+__locals__)?(\w+)_[0-9a-f]+$", kernel.module.name)
        if name and name[1] in (*FIELDS, RESTRICT):
            found[f"{name[1]} {_bytes(kernel)}"] += 1
    return {kernel: calls / steps for kernel, calls in found.items()}


@contextmanager
def each_launch(launch: Launcher) -> Iterator[list[tuple[Any, object, float]]]:
    """Yield a list that receives kernel, threads and time [s] of each launch; recording is off."""
    made: list[tuple[Any, object, float]] = []
    plain, records = Launcher.__call__, launch.records

    def timed(launcher: Launcher, kernel: Any, dim: Any, *arguments: Any, **cuts: Any) -> None:
        start = time.perf_counter()
        plain(launcher, kernel, dim, *arguments, **cuts)
        if launcher is launch:
            made.append((kernel, dim, time.perf_counter() - start))

    Launcher.__call__ = timed  # type: ignore[method-assign]
    launch.records = False
    try:
        yield made
    finally:
        Launcher.__call__ = plain  # type: ignore[method-assign]
        launch.records = records


def _bytes(kernel: Any) -> int:
    """Return the bytes of the numbers (scalars or SIMD registers) of a kernel over elements."""
    types = [getattr(argument.type, "dtype", None) for argument in kernel.adj.args]
    lanes = next(kind for kind in types if hasattr(kind, "_wp_scalar_type_"))
    return int(wp.types.type_size_in_bytes(lanes._wp_scalar_type_))


class Traffic:
    """Traffic between a number of ranks on a mesh."""

    def __init__(self, mesh: Mesh, ranks: int) -> None:
        self.mesh, self.ranks = mesh, ranks
        self.owner, self.neighbours = np.empty(mesh.elements, dtype=int), []
        partition = Partition(mesh, ranks)
        for rank in range(ranks):
            part = partition.part(rank)
            self.owner[part.element_numbers] = rank
            self.neighbours.append(len(part.sends))

    @cached_property
    def on_the_rim(self) -> int:
        """Number of element nodes that all ranks send, each to every other rank at its node."""
        of_entry = self.owner[self.mesh.gather_entries // self.mesh.np**2]
        pieces = np.split(of_entry, self.mesh.gather_offsets[1:-1])
        return sum(p.size * (np.unique(p).size - 1) for p in pieces if p.size > 1)

    @cached_property
    def coarse(self) -> tuple[int, int]:
        """Numbers of integrals that ranks receive for a coarse correction, and functions in rings.

        A rank computes the coarse functions on its elements, and needs their integrals over all
        elements.  Its ring contains the functions of other ranks that couple to its functions:
        smooth functions on a common element, computational modes where both have a slope.
        """
        on, see = self._functions
        mine = _one_hot(self.owner, self.ranks).T
        own = ((mine @ on) > 0).astype(int)
        needed = (own @ on.T) > 0
        elements = needed.sum() - needed.multiply(mine > 0).sum()
        return int(elements) * self._of_an_element, int(((own @ see) > 0).sum() - own.sum())

    def bytes_sent(self, did: Launches) -> float:
        """Return the bytes that all ranks send in a step; did: launches per step on one process."""
        total = 0.0
        for kernel, calls in did.items():
            name, size = kernel.split()
            if name in FIELDS:
                total += calls * FIELDS[name] * int(size) * self.on_the_rim
        if f"{RESTRICT} {SINGLE}" in did:
            integrals, functions = self.coarse
            of_one = integrals + (STEPS - 1) * functions
            total += did[f"{RESTRICT} {SINGLE}"] * SINGLE * of_one
        return total

    @cached_property
    def _of_an_element(self) -> int:
        return sum(space.numbers.shape[1] for space in coarse_spaces(self.mesh))

    @cached_property
    def _functions(self) -> tuple[Any, Any]:
        """Return matrices of functions on elements (E, V) and of functions that couple (V, V)."""
        spaces = coarse_spaces(self.mesh)
        on = []
        for space in spaces:
            where = np.indices(space.numbers.shape)[0].ravel(), space.numbers.ravel()
            shape = self.mesh.elements, space.numbers.max() + 1
            on.append(scipy.sparse.csr_array((np.ones(where[0].size, int), where), shape))
        sloping = [_entries(gradients(self.mesh, space)) for space in spaces[1:]]
        see = scipy.sparse.block_diag([each.T @ each for each in (on[0], *sloping)], format="csr")
        return scipy.sparse.hstack(on, format="csr"), see


def _one_hot(owner: np.ndarray, ranks: int) -> scipy.sparse.csr_array:
    """Return the matrix (E, ranks) that is 1 where an element belongs to a rank."""
    where = np.arange(owner.size), owner
    return scipy.sparse.csr_array((np.ones(owner.size, int), where), (owner.size, ranks))


def _entries(matrix: Any) -> scipy.sparse.csr_array:
    """Return the matrix with every entry replaced by 1."""
    found = scipy.sparse.csr_array(matrix)
    return scipy.sparse.csr_array((np.ones(found.nnz, int), found.indices, found.indptr))
