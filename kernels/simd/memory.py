"""Loads and stores in C++, for which Warp's own code checks and computes more than necessary.

An index of Warp may be negative and an array may be strided; both cost instructions in a gather. A
register of `lanes` elements is loaded at once if their nodes follow one another in memory. The
first lane of such a node vector stores the complement of the first number, which is negative.
"""

import functools
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.kernels.define import Placeholder, Register, index, kernel, source, value, vector

Contributors = wp.types.vector(4, wp.int32)
"""Offsets of a node's contributors to the first local field; -1 stands for a missing one."""
Places = wp.array(dtype=Contributors)
Numbers = wp.array(dtype=wp.int32)
nodes = wp.array2d(dtype=index)
"""Numbers of the nodes of each element (groups, np*np)."""


@Register.func_native("return as_value(*runs(x.data + i));")
def load(x: vector, i: int) -> value:
    """Return the register that begins at x[i] of a contiguous array, i not negative."""


number: Any = load.find(Register(wp.int32))


@Register.func_native("*reinterpret_cast<value*>(x.data + i) = v;")
def put(x: vector, i: int, v: value):
    """Store v, or a register, at x[i] and the numbers after it."""


@kernel
def pack(x: vector, places: Numbers, packed: vector, threads: int):
    """Set packed = x[places], with `packed` and `places` of shape (n,).

    A GPU runs n `threads`, a CPU one: starting a thread costs more there than a copy.
    """
    for i in range(wp.tid(), places.shape[0], threads):
        put(packed, i, load(x, number(places, i)))


@kernel
def unpack(x: vector, places: Numbers, packed: vector, threads: int):
    """Set x[places] = packed; shapes and threads are those of `pack`."""
    for i in range(wp.tid(), places.shape[0], threads):
        put(x, number(places, i), load(packed, i))


@Register.func_native("return wp::uint64(x.data + i);")
def address(x: wp.array3d(dtype=value), i: int) -> wp.uint64:
    """Return the address of the i-th entry of a contiguous array."""


@functools.cache
def _load_nodes(register: Register, given: Any) -> Any:
    """Return the device function (x, offset, node) that loads numbers of x at nodes.

    x contains numbers of the type `given`. Consecutive ones are loaded at once.
    """
    each = ", ".join(f"at[node.c[{lane}]]" for lane in range(register.lanes))
    whole = source("load_nodes", given=given.__name__, lanes=register.lanes, each=each)

    @Register.func_native(whole if register.lanes > 1 else "return number(x.data[offset + node]);")
    def load_nodes(x: wp.array(dtype=given), offset: int, node: index) -> value: ...

    return load_nodes.find(register)


MOST_RUNS = 4
"""Number of runs that load_runs.cpp can load."""
Runs = wp.types.vector(2 * MOST_RUNS, wp.int32)
run_table: Any = Placeholder(lambda of: Runs if of.lanes > 1 else wp.int32)
"""The places of a register, see `in_runs`, or one place."""


@functools.cache
def _load_runs(register: Register) -> Any:
    lanes = [*range(register.lanes)]
    each = ", ".join(f"at[node.c[{lane}]]" for lane in lanes)
    whole = source("load_runs", lanes=str(lanes)[1:-1], each=each)

    @Register.func_native(whole if len(lanes) > 1 else "return x.data[table];")
    def load_runs(x: vector, table: run_table, others: wp.array(dtype=index)) -> value: ...

    return load_runs.find(register)


load_runs: Any = Placeholder(_load_runs)
"""Function (x, table, others) that loads x at places, stored as `in_runs` returns them."""


@functools.cache
def converting(given: Any) -> tuple[Any, Any]:
    """Return device functions (x, i) and (x, i, v) that load and store x[i] and what follows.

    x is a contiguous array of the number type `given`; a register holds converted numbers.
    """

    @Register.func_native(source("load_as"))
    def load_as(x: wp.array(dtype=given), i: int) -> value: ...

    @Register.func_native(source("put_as", given=given.__name__))
    def put_as(x: wp.array(dtype=given), i: int, v: value): ...

    return load_as, put_as


EACH_LANE = source("each_lane")
"""Beginning of functions that find the numbers of a register one by one."""


@Register.func_native(EACH_LANE + source("pick"))
def pick(x: vector, places: Numbers, first: int) -> value:
    """Return x at the places from `first` on."""


@functools.cache
def picking(given: Any) -> Any:
    """Return the device function that stores x at the places from `first` on in an array out.

    The function has the arguments (x, places, first, out); `given` is the number type of `out`.
    """

    @Register.func_native(source("put_picked", given=given.__name__))
    def put_picked(x: vector, places: Numbers, first: int, out: wp.array(dtype=given)): ...

    return put_picked


def in_runs(places: NDArray[np.integer]) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """Return registers (..., lanes) of places as runs (..., 8), and others (m, lanes) as they are.

    Places that form at most MOST_RUNS runs in memory become the place of each run less its first
    lane, the first lane of each run but the first, and the number of runs. A missing run has the
    place of the first one and begins behind the last lane. For other registers the number of runs
    is -1, and the first number is their row in the second array.
    """
    lanes, flat = places.shape[-1], places.reshape(-1, places.shape[-1])
    begins = np.diff(flat, prepend=flat[:, :1] - 2) != 1
    count = begins.sum(axis=1)
    lane = np.argsort(~begins, axis=1, kind="stable")[:, :MOST_RUNS]
    exists = np.arange(MOST_RUNS) < count[:, None]
    place = np.take_along_axis(flat, lane, axis=1) - lane
    place, lane = np.where(exists, place, place[:, :1]), np.where(exists, lane, lanes)
    other = (count > MOST_RUNS) | (place < 0).any(axis=1)
    place[other, 0], count[other] = np.arange(other.sum()), -1
    runs = np.concatenate([place, lane[:, 1:], count[:, None]], axis=1)
    return runs.reshape(*places.shape[:-1], -1), flat[other]


load_nodes: Any = Placeholder(lambda of: _load_nodes(of, of.real))
"""Function (x, offset, node) that loads x at a register of nodes."""
load_given: Any = Placeholder(lambda of: _load_nodes(of.register, of.given), of_elements=True)
"""Variant of `load_nodes` for a vector of the number type `given`."""


@Register.func_native(EACH_LANE + source("gather"))
def gather(local: vector, places: Places, first: int, offset: int) -> value:
    """Return the sums over the contributors of the nodes from `first` on (DSS)."""
