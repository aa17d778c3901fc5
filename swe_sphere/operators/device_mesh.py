"""Mesh arrays in the order in which the kernels read them."""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.errors import ConfigError
from swe_sphere.kernels.element import room
from swe_sphere.kernels.simd.memory import CONTRIBUTORS, Contributors
from swe_sphere.kernels.simd.stages import stage_struct
from swe_sphere.mesh import Mesh
from swe_sphere.mesh.numbering import BLOCK
from swe_sphere.mesh.partition import Part, Partition, whole
from swe_sphere.operators.chunks import Chunks
from swe_sphere.operators.field import Field
from swe_sphere.operators.halo import Halo, Rim
from swe_sphere.operators.launch import Launcher
from swe_sphere.operators.layout import Layout
from swe_sphere.ranks.communicator import Communicator

ALONE = Communicator()
REALS = {"float64": wp.float64, "float32": wp.float32}


class DeviceMesh(Layout):
    """Element data of a mesh, or of this rank's part of it, `lanes` elements side by side.

    Arrays on element nodes have shape (groups, np*np, ..., lanes); the last group is filled up with
    copies of the last element, which DSS never reads.  Metric terms are computed in float64 and
    only then rounded to `real`: a geometry in float32 would grow a spurious wave (Nakano et al.
    2018, doi:10.1175/MWR-D-17-0257.1).
    """

    def __init__(
        self, mesh: Mesh, device: str, real: Any, shape: str, comm: Communicator = ALONE,
        part: Part | None = None,
    ) -> None:  # fmt: skip
        if part is None:
            part = Partition(mesh, comm.size).part(comm.rank) if comm.shared else whole(mesh)
        super().__init__(mesh, part, comm, device, real, shape)
        self.points = mesh.np**2
        self._halos: dict[int, Halo] = {}
        self._places: dict[int, wp.array] = {}
        self._scratch: dict[tuple[int, Any], Field] = {}

    def like(self, real: Any, shape: str) -> "DeviceMesh":
        """The same part in another number type or order."""
        if (real, shape) == (self.real, self.shape):
            return self
        return DeviceMesh(self.mesh, self.device, real, shape, self.comm, self.part)

    @property
    def dim(self) -> int | tuple[int, int]:
        """Threads of a launch over the element nodes."""
        return self.groups if self.shape == "element" else (self.groups, self.points)

    def dim_of(self, fields: int) -> int | tuple[int, int, int]:
        """Threads of a launch over the element nodes of so many fields."""
        return self.groups if self.shape == "element" else (self.groups, fields, self.points)

    @functools.cached_property
    def chunks(self) -> Chunks:
        """By which sums over the nodes are taken."""
        return Chunks(self.part, self.comm, self.device)

    @functools.cached_property
    def nodes(self) -> wp.array:
        """Unique node numbers of the element nodes; for runs see `kernels/simd/memory.py`."""
        numbers = self.in_lanes(self.part.node_of.reshape(self.elements, self.points, 1))
        if self.lanes > 1:
            first = numbers[..., 0]
            first[(np.diff(numbers) == 1).all(axis=-1)] ^= -1
        return self.registers(numbers[:, :, 0], wp.int32)

    @functools.cached_property
    def basis(self) -> wp.array:
        """The four entries of dx/dxi_i . e_k [m] at the element nodes."""
        return self.on_elements(self.mesh.basis[self.part.elements], (4,))

    @functools.cached_property
    def inverse_jacobian(self) -> wp.array:
        """One over the area element [m-2]."""
        jacobian = self.mesh.jacobian[self.part.elements]
        return self.on_elements(1.0 / jacobian)

    @functools.cached_property
    def derivative(self) -> wp.array:
        """Derivative matrix of the GLL nodes."""
        return self.upload(self.mesh.derivative)

    @functools.cached_property
    def weight(self) -> wp.array:
        """Products of GLL weights (np, np)."""
        return self.upload(self.mesh.quadrature)

    @functools.cached_property
    def inner(self) -> int:
        """Nodes inside the elements of the first `whole` groups, which are numbered first."""
        return self.whole * self.lanes * (self.mesh.np - 2) ** 2

    @functools.cached_property
    def whole(self) -> int:
        """Groups whose nodes inside the elements stand in blocks of BLOCK elements."""
        blocks, side = self.elements // BLOCK, self.mesh.np - 2
        inside = self.part.node_of[: blocks * BLOCK, 1:-1, 1:-1].reshape(blocks, BLOCK, side, side)
        expected = np.arange(inside.size).reshape(blocks, side, side, BLOCK)
        fits = (np.moveaxis(inside, 1, -1) == expected).all(axis=(1, 2, 3))
        return int(np.logical_and.accumulate(fits).sum()) * BLOCK // self.lanes

    @functools.cached_property
    def work(self) -> int:
        """Address of the work arrays of a group; kernels run one after the other."""
        self._room = self.aligned((room(self.mesh.np),), wp.uint8)
        return int(self._room.ptr)

    @functools.cached_property
    def stage(self) -> Any:
        """None: rates are left as they are."""
        return stage_struct(self.real)()

    @functools.cached_property
    def inverse_area(self) -> wp.array:
        """One over the nodal area (N,) [m-2]."""
        return self.scatter(1.0 / self.mesh.area)

    def places(self, unknowns: int) -> wp.array:
        """(N,) where the contributors of each node stand in local tendencies of that many fields.

        A node lacks those that are -1; the fourth of three stands in the empty last group.
        Raises ConfigError where 32 bits cannot tell the places.
        """
        if unknowns not in self._places:
            self._places[unknowns] = self._find_places(unknowns)
        return self._places[unknowns]

    def _find_places(self, unknowns: int) -> wp.array:
        part, width = self.part, unknowns * self.lanes
        if self.rows * width >= 2**31:
            raise ConfigError(
                f"{unknowns} fields of this part of the mesh have more than 2^31 numbers: take more"
                " ranks, or a coarser mesh"
            )
        position = self._positions(part.contributors, width)
        empty = self.groups * self.points * width
        places = np.full((self.size, CONTRIBUTORS), -1, dtype=np.int32)
        count = part.counts
        places[count == 3, 3] = empty
        node = np.repeat(np.arange(self.size), count)
        places[node, np.arange(node.size) - np.repeat(np.cumsum(count) - count, count)] = position
        return wp.array(places, dtype=Contributors, device=self.device)

    @functools.cached_property
    def of_own(self) -> wp.array:
        """(N,) where each node stands in a local field, in the first of this rank's elements."""
        part = self.part
        mine = np.flatnonzero(part.contributors >= 0)
        node = np.repeat(np.arange(self.size), part.counts)[mine]
        first = part.contributors[mine[np.unique(node, return_index=True)[1]]]
        places = self._positions(first, self.lanes)
        return wp.array(places, dtype=wp.int32, device=self.device)

    @functools.cached_property
    def others(self) -> wp.array:
        """Places of the contributors of each element node but its own, in a local field.

        (groups, np*np, 3): one of an element's edge has one, a corner three; what it lacks stands
        in the empty group.  The first is the one that DSS adds the own to, before the other two, so
        that (own + first) + (second + third) has the same bits in every element.
        """
        own = self._positions(np.arange(self.elements * self.points), self.lanes)
        around = self.places(1).numpy()[self.part.node_of.ravel()]
        mine = np.argmax(around == own[:, None], axis=1)[:, None]
        others = np.take_along_axis(around, mine ^ np.array([1, 2, 3]), axis=1)
        empty = self.groups * self.points * self.lanes
        return self.on_elements(np.where(others < 0, empty, others), (3,), wp.int32)

    def geometry(self, kind: Any, given: Mapping[str, Any] | None = None) -> Any:
        """A structure of that kind: members by name from those given, else from the mesh."""
        known = {"size": self.size} | dict(given or {})
        filled = kind()
        for name in kind.vars:
            setattr(filled, name, known[name] if name in known else getattr(self, name))
        return filled

    def scratch(self, unknowns: int, value: Any) -> Field:
        """Return the room for local tendencies that all operators share, see `local`.

        An operator must have read its results before another one is launched.
        """
        key = unknowns, value
        if key not in self._scratch:
            self._scratch[key] = self.local(unknowns, value)
        return self._scratch[key]

    def local(self, unknowns: int, value: Any) -> Field:
        """Return room for local tendencies, (groups + 1 ..., np*np, unknowns) of `value`.

        No element writes to the first group behind the others, which stays zero; those after it
        are for what other ranks send.
        """
        local = self.unshared(unknowns, value)
        self.share(local.flat, self.lanes * np.arange(unknowns), unknowns * self.lanes)
        return local

    def unshared(self, unknowns: int, value: Any) -> Field:
        """Return the same room without messages: other ranks get nothing of it."""
        local = self.aligned((self.rows // self.points, self.points, unknowns), value)
        return Field(local, self.flat(local))

    @property
    def rows(self) -> int:
        """Places of element nodes in local tendencies, `lanes` in each, those behind included."""
        behind = -(-self._received // self.lanes)
        return (self.groups + 1 + -(-behind // self.points)) * self.points

    def share(self, flat: wp.array, offsets: NDArray[Any], width: int) -> None:
        """Have `exchange` serve an array (n,) whose element nodes begin in rows of that width.

        offsets: where their numbers stand, from there.
        """
        if self.part.sends:
            part = self.part
            slots = np.split(-1 - np.arange(self._received), np.cumsum([*part.receives.values()]))
            entries = dict(zip(part.receives, slots, strict=False))
            sends, receives = (
                {rank: self._positions(e, width)[:, None] + offsets for rank, e in each.items()}
                for each in (part.sends, entries)
            )
            self.share_places(flat, sends, receives)

    def share_places(
        self, flat: wp.array, sends: Mapping[int, Any], receives: Mapping[int, Any]
    ) -> None:
        """Have `exchange` serve an array (n,): places (...) of what each neighbour gets and has.

        All ranks do so together, those that have nothing to tell as well.
        """
        if self.comm.size > 1:
            self._halos[flat.ptr] = Halo(self.comm, flat, sends, receives)

    def share_blocks(self, local: wp.array, lanes: int) -> wp.array:
        """The same of an array (blocks, rows) of so many numbers each; returns its flat view."""
        blocks, rows = local.shape
        flat = wp.array(
            ptr=local.ptr, shape=(local.size * lanes,), dtype=self.real, device=self.device
        )
        starts = rows * lanes * np.arange(blocks)
        self.share(flat, (starts[:, None] + np.arange(lanes)).ravel(), lanes)
        return flat

    @property
    def _received(self) -> int:
        return sum(self.part.receives.values())

    def fields(self, count: int, value: Any) -> tuple[list[Field], wp.array]:
        """Room for local fields of one unknown, and a flat view of all: they are exchanged at once.

        See `local`.
        """
        room = self.aligned((count, self.rows // self.points, self.points, 1), value)
        flat = self.flat(room)
        self.share(flat, self.rows * self.lanes * np.arange(count), self.lanes)
        return [Field(room[i], self.flat(room[i])) for i in range(count)], flat

    def exchange(self, flat: wp.array) -> None:
        """Fetch from other ranks what their elements have left for nodes that this one has too.

        Between the elements and the nodes of every step; flat: the view that came with `local`.
        """
        if self._halos:
            self._halos[flat.ptr]()

    def sweep_of(self, launch: Launcher, flat: wp.array) -> Callable[..., None]:
        """Return `launch`, or what exchanges the results in `flat` too where there are other ranks.

        The function takes a kernel over the elements, its threads and its arguments.  While
        messages are on their way, elements away from the rim are computed.
        """
        if not self._halos:
            return launch
        halo = self._halos[flat.ptr]

        def sweep(kernel: Any, dim: int | tuple[int, ...], *arguments: Any) -> None:
            each = dim[1:] if isinstance(dim, tuple) else ()
            self._rim.launch(launch, kernel, each, arguments, halo)

        return sweep

    @functools.cached_property
    def _rim(self) -> Rim:
        return Rim(self.groups, self.part.away // self.lanes)

    @property
    def bytes_sent(self) -> int:
        """By this rank, to its neighbours."""
        return sum(halo.bytes_sent for halo in self._halos.values())

    def _positions(self, entries: NDArray[Any], width: int) -> NDArray[np.int64]:
        """Where element nodes (element np^2 + point) begin, in rows of that many numbers.

        Those that are received, -1 - k, stand behind the empty group.
        """
        element, point = np.divmod(entries, self.points)
        group, lane = np.divmod(element, self.lanes)
        behind, lane_behind = np.divmod(-1 - entries, self.lanes)
        row = np.where(
            entries >= 0, group * self.points + point, (self.groups + 1) * self.points + behind
        )
        return row * width + np.where(entries >= 0, lane, lane_behind)
