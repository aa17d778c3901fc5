"""What a step takes on any number of ranks, by what it does on one: a model, and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from swe_sphere.mesh.partition import pieces

NODES = 4
"""On an edge of an element, np."""
NEIGHBOURS = 8


@dataclass(frozen=True)
class Network:
    """What a message costs."""

    latency: float
    """[s]"""
    bandwidth: float
    """Of a rank [bytes s-1]."""


@dataclass(frozen=True)
class Step:
    """What a step does on a mesh of so many elements; counts are those of a rank."""

    elements: int
    seconds: float
    """On one process [s]."""
    fixed: float
    """Of these, what does not go with the elements: what Python does between kernels."""
    coarse_seconds: float
    """Of these, sweeps over coarse functions, of which ranks have those on their rims in common."""
    longest_seconds: float
    """Of these, what every rank does for itself: products that solve for the longest waves."""
    exchanges: float
    """Of contributions to nodes on the rim."""
    width: float
    """Bytes that go out for an element node on the rim, in the mean."""
    sums: float
    """Messages of all to all that carry products."""
    sum_bytes: float
    """Of both of two ranks together in one of them."""
    coarse: float
    """Messages of all to all that carry residuals of smooth coarse functions."""
    coarse_bytes: float
    """Of all ranks together in one of them."""


def as_it_is(
    step: Step, elements: float, ranks: np.ndarray, net: Network, rim: float
) -> np.ndarray:
    """Seconds of a step as the program is: sums of large branches and the longest waves everywhere.

    rim: element nodes of n elements at nodes of others, over sqrt(n).
    """
    size = elements / step.elements
    wide = (np.sqrt(elements / ranks) + 1.0) ** 2 / elements  # with functions on its rim
    sweeps = size * step.coarse_seconds * np.where(ranks > 1, np.minimum(wide, 1.0), 1.0)
    hops = np.ceil(np.log2(ranks))
    everywhere = step.sums * (hops * net.latency + 0.5 * ranks * step.sum_bytes / net.bandwidth)
    everywhere += step.coarse * (hops * net.latency + size * step.coarse_bytes / net.bandwidth)
    serial = sweeps + size * step.longest_seconds
    return _shared(step, elements, ranks, net, rim) + serial + np.where(ranks > 1, everywhere, 0.0)


def in_trees(
    step: Step, elements: float, ranks: np.ndarray, net: Network, rim: float
) -> np.ndarray:
    """Seconds of a step were sums taken along trees, and the coarse level dealt out.

    A sum goes up a tree and down again; a coarse solve visits log2(ne) levels twice, with the
    messages of a halo on each.
    """
    size, ne = elements / step.elements, np.sqrt(elements / 6.0)
    hops = 2.0 * np.ceil(np.log2(ranks))
    levels = 2.0 * np.ceil(np.log2(ne))
    messages = step.sums * hops + step.coarse * levels * np.minimum(ranks - 1, NEIGHBOURS)
    dealt_out = size * (step.coarse_seconds + step.longest_seconds) / ranks
    return _shared(step, elements, ranks, net, rim) + dealt_out + messages * net.latency


def _shared(step: Step, elements: float, ranks: np.ndarray, net: Network, rim: float) -> np.ndarray:
    """What all ranks share already: elements, and exchanges on the rims of their pieces."""
    mine = elements / ranks
    apart = step.fixed + step.coarse_seconds + step.longest_seconds
    work = mine * (step.seconds - apart) / step.elements
    messages = np.minimum(ranks - 1, NEIGHBOURS) * net.latency
    halo = step.exchanges * (messages + rim * np.sqrt(mine) * step.width / net.bandwidth)
    return step.fixed + work + np.where(ranks > 1, halo, 0.0)


def picture(path: Path, steps: Mapping[str, Step], ne: int, net: Network, rim: float) -> None:
    """Time of a step on a mesh over the number of ranks, both ways."""
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for (name, step), colour in zip(steps.items(), ("C0", "C1", "C2", "C3"), strict=False):
        ranks, elements = np.logspace(0, np.log10(pieces(ne)[0]), 100), 6.0 * ne**2
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
