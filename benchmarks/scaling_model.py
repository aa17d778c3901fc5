"""Model of the time of a step on any number of ranks from counts on few ranks, and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from swe_sphere.mesh.partition import chunking

NODES = 4
"""Number of nodes along the edge of an element, np."""
NEIGHBOURS = 6
"""Largest number of neighbours of a rank with less than a ring; one with more has two."""


@dataclass(frozen=True)
class Network:
    """Cost of messages."""

    latency: float
    """Time of an empty message [s]."""
    bandwidth: float
    """Bandwidth of a rank [bytes s-1]."""


@dataclass(frozen=True)
class Step:
    """Work and messages of a step on a mesh of `elements` elements; counts are per rank."""

    elements: int
    seconds: float
    """Time on one process [s]."""
    fixed: float
    """Part of `seconds` that does not depend on the mesh: Python between kernels."""
    coarse_seconds: float
    """Part of `seconds` in sweeps over coarse functions; ranks repeat those on their boundaries."""
    longest_seconds: float
    """Part of `seconds` that every rank repeats: products that solve for the longest waves."""
    exchanges: float
    """Number of exchanges of contributions to nodes on the boundary of a partition."""
    width: float
    """Mean number of bytes sent per exchange and element node on the boundary."""
    sums: float
    """Number of messages from all ranks to all with products (sums)."""
    sum_bytes: float
    """Bytes of one such message, both of two ranks together."""
    coarse: float
    """Number of messages from all ranks to all with integrals of coarse functions."""
    coarse_bytes: float
    """Bytes of one such message, all ranks together."""


def as_it_is(
    step: Step, elements: float, ranks: np.ndarray, net: Network, rim: float
) -> np.ndarray:
    """Return the time of a step [s] of the present program: each rank solves for the longest waves.

    rim: element nodes sent for each side of an element on the boundary of a partition.
    """
    size = elements / step.elements
    wide = 1.0 / ranks + 0.5 * _sides(elements, ranks) / elements  # with functions on its rim
    sweeps = size * step.coarse_seconds * np.where(ranks > 1, np.minimum(wide, 1.0), 1.0)
    hops = np.ceil(np.log2(ranks))
    everywhere = step.sums * (hops * net.latency + 0.5 * ranks * step.sum_bytes / net.bandwidth)
    everywhere += step.coarse * (hops * net.latency + size * step.coarse_bytes / net.bandwidth)
    serial = sweeps + size * step.longest_seconds
    return _shared(step, elements, ranks, net, rim) + serial + np.where(ranks > 1, everywhere, 0.0)


def in_trees(
    step: Step, elements: float, ranks: np.ndarray, net: Network, rim: float
) -> np.ndarray:
    """Return the time of a step [s] with sums along trees and a distributed coarse level.

    A sum goes up a tree and down again; a coarse solve visits log2(ne) levels twice, with one
    exchange between neighbours on each level.
    """
    size, ne = elements / step.elements, np.sqrt(elements / 6.0)
    hops = 2.0 * np.ceil(np.log2(ranks))
    levels = 2.0 * np.ceil(np.log2(ne))
    messages = step.sums * hops + step.coarse * levels * _neighbours(elements, ranks)
    dealt_out = size * (step.coarse_seconds + step.longest_seconds) / ranks
    return _shared(step, elements, ranks, net, rim) + dealt_out + messages * net.latency


def _ring(elements: float) -> float:
    """Return the largest number of elements in a ring."""
    return float(4.0 * np.sqrt(elements / 6.0))


def _sides(elements: float, ranks: np.ndarray) -> np.ndarray:
    """Return the sides of elements on the boundary of a belt of rings, or of a piece of a ring."""
    return np.minimum(2.0 * _ring(elements), 2.0 * elements / ranks + 2.0)


def _neighbours(elements: float, ranks: np.ndarray) -> np.ndarray:
    """Return the number of ranks that a rank exchanges messages with."""
    most = np.where(elements / ranks < _ring(elements), NEIGHBOURS, 2)
    return np.minimum(ranks - 1, most)


def _shared(step: Step, elements: float, ranks: np.ndarray, net: Network, rim: float) -> np.ndarray:
    """Return the time [s] of the distributed work: elements, and exchanges between partitions."""
    mine = elements / ranks
    apart = step.fixed + step.coarse_seconds + step.longest_seconds
    work = mine * (step.seconds - apart) / step.elements
    sent = rim * _sides(elements, ranks) * step.width
    halo = step.exchanges * (_neighbours(elements, ranks) * net.latency + sent / net.bandwidth)
    return step.fixed + work + np.where(ranks > 1, halo, 0.0)


def picture(path: Path, steps: Mapping[str, Step], ne: int, net: Network, rim: float) -> None:
    """Draw the time of a step by the number of ranks, by both models."""
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for (name, step), colour in zip(steps.items(), ("C0", "C1", "C2", "C3"), strict=False):
        ranks, elements = np.logspace(0, np.log10(chunking(ne)[0]), 100), 6.0 * ne**2
        axes.loglog(ranks, as_it_is(step, elements, ranks, net, rim), color=colour, label=name)
        trees = in_trees(step, elements, ranks, net, rim)
        axes.loglog(ranks, trees, "--", color=colour)
        axes.loglog(ranks, trees[0] / ranks, ":", color=colour, linewidth=0.8)
    axes.plot([], [], "k-", label="as the program is")
    axes.plot([], [], "k--", label="sums in trees, longest waves dealt out")
    axes.plot([], [], "k:", linewidth=0.8, label="no loss")
    axes.set(xlabel="ranks", ylabel="time of a step [s]", title=f"ne {ne} np {NODES}, a model")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
