"""Strips of a mesh: a launch reads the results of the previous one while they are in the cache.

Nodes are numbered by the first element that touches them. Strips of elements are computed from the
last one to the first: the nodes that a strip is the first to touch are then complete with that
strip, and they follow one another in memory. Consecutive launches over elements and over nodes run
together, strip by strip. A strip of elements reads nodes of strips up to `reach` further on. Each
launch over elements therefore stays `reach` strips behind the launch before it, and a launch over
nodes follows at once. At these distances no launch overwrites values that an earlier launch has yet
to read, even if they share arrays, so that results have the same bits.

On several ranks the strips cover elements away from the rim, the nearest ones first. Elements on
the rim are computed before them, their results are exchanged meanwhile, and nodes on the rim, which
count as a strip in front of the others, come after them. When the strips of a launch are complete,
those of later launches still lag behind, so that the rim can follow before they read it.
"""

import ctypes
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from swe_sphere.mesh.cubed_sphere import BLOCK
from swe_sphere.mesh.partition import MeshPart
from swe_sphere.operators.launch import Cuts, Launcher, Span

CACHE = Path("/sys/devices/system/cpu/cpu0/cache/index2/size")
"""File in which Linux states the size of the second-level cache, as in "1280K"."""
PER_NODE = 128
"""Bytes of that cache for each element node of a strip."""


def _nodes_that_fit() -> int:
    size = 512
    with suppress(OSError, ValueError):
        size = max(size, int(CACHE.read_text().strip().removesuffix("K")))
    return size * 1024 // PER_NODE


NODES = _nodes_that_fit()
"""Least number of element nodes of a strip, whose data fit the second-level cache: 4096 if the
cache has half a megabyte, or if its size is unknown."""


class Strips:
    """The threads of each strip, in launches over groups of elements and over nodes.

    Strips begin at multiples of BLOCK, those of nodes counted from the first node of their kind, so
    at the same nodes in all number types.
    """

    def __init__(self, part: MeshPart, groups: int, lanes: int) -> None:
        """Cut the first `groups` of `lanes` elements, and the interior nodes, into strips."""
        elements, points = min(groups * lanes, len(part.nodes)), part.nodes[0].size
        width = -(-NODES // (points * BLOCK)) * BLOCK
        strip = (np.arange(elements) // width)[:, None, None]
        numbers = np.arange(int(strip.max()) + 2)
        first = np.full(part.node_numbers.size, numbers[-2])
        inside, rim = part.nodes[:elements], part.nodes[elements:]
        np.minimum.at(first, inside, strip)
        first[rim] = 0
        stops = [*np.searchsorted(part.counts, [1, 2], side="right").tolist(), part.counts.size]
        self.spans: list[Span] = []
        """Nodes inside elements, on edges and at vertices, in strips; then those on the rim."""
        done = np.full_like(first, -1)
        for begin, count in zip([0, *stops[:2]], part.interior_nodes.tolist(), strict=True):
            end = begin + count
            last = np.minimum.accumulate(first[begin:end][::-1])[::-1]
            starts = np.searchsorted(last, numbers)
            starts = np.minimum(begin + -(-starts // BLOCK) * BLOCK, end)
            self.spans.append(Span(begin, end, starts))
            done[begin:end] = np.searchsorted(starts, np.arange(begin, end), side="right") - 1
        stops_of = zip(self.spans, stops, strict=True)
        self.spans += [Span(s.end, b, on_rim=True) for s, b in stops_of if s.end < b]
        reach = max(int((strip - done[inside]).max()), int(done[rim].max(initial=-1)) + 1)
        self.groups = Cuts(-(-np.minimum(numbers * width, elements) // lanes), 0, 1, reach)


class StripLaunches:
    """Launches that run together over the strips of one mesh; see `sweep_strips` for the table.

    They form groups. The rim is computed between two groups, when the strips of the first one are
    complete, and those of the second one as far as `reach` allows.
    """

    def __init__(self, launch: Launcher) -> None:
        self._launch, self._rows, self._strips = launch, list[Any](), 0
        self._lags = list[int]()
        """Lag of the last launch of each group."""
        self._commands = list[Any]()
        self._kept = list[Any]()
        """All that the table refers to by address."""

    def begin_group(self) -> Callable[[], None]:
        """Begin a group of launches; return the function that runs them, after earlier groups."""
        self._lags.append(self._lags[-1] if self._lags else 0)
        return partial(self, len(self._lags) - 1)

    def add(self, known: tuple[Any, ...], cuts: Cuts) -> None:
        """Append a launch to the group. known: its command, and objects that must live as long."""
        command, *_ = known
        bounds = type(command.bounds).from_buffer_copy(command.bounds)
        values = command.params[1:]
        members = [(f"argument_{i}", type(value)) for i, value in enumerate(values)]
        arguments = type("Arguments", (ctypes.Structure,), {"_fields_": members})(*values)
        starts = np.ascontiguousarray(cuts.starts, np.int32)
        self._strips = starts.size - 1
        function = ctypes.cast(command.hooks.forward, ctypes.c_void_p).value
        addresses = function, *map(ctypes.addressof, (bounds, arguments)), starts.ctypes.data
        sizes = type(bounds).size.offset, bounds.size // bounds.shape[0]
        self._lags[-1] += cuts.reach if self._rows else 0
        self._rows.append((*addresses, cuts.begin, cuts.step, *sizes, self._lags[-1]))
        self._kept.append((known, bounds, arguments, starts))

    def __call__(self, group: int) -> None:
        if not self._commands:
            table = wp.array(np.array(self._rows, np.uint64), dtype=wp.uint64, device="cpu")
            self._kept.append(table)
            for first, last in pairwise([self._strips, *(-lag for lag in self._lags)]):
                inputs = [table, self._strips, first - 1, last]
                command = wp.launch(self._launch.sweep, 1, inputs, device="cpu", record_cmd=True)
                self._commands.append(command)
        self._commands[group].launch()
