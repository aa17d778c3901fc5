"""Mesh arrays in the order in which the kernels read them."""

import functools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from swe_sphere.arrays import Array, inverse_permutation
from swe_sphere.errors import ConfigError, NotCopyable
from swe_sphere.kernels.define import Register, lanes_of, specialise
from swe_sphere.kernels.element import work_bytes
from swe_sphere.kernels.simd.memory import Contributors, Runs, in_runs
from swe_sphere.kernels.simd.stages import stage_struct
from swe_sphere.kernels.simd.strips import sweep_strips
from swe_sphere.kernels.terms import KernelTypes, kernel_types
from swe_sphere.mesh import Mesh, partition
from swe_sphere.mesh.cubed_sphere import BLOCK
from swe_sphere.mesh.partition import MeshPart, Partition, single_part
from swe_sphere.operators.chunks import Chunks
from swe_sphere.operators.halo import Halo
from swe_sphere.operators.launch import MOST_CACHED, Launcher, Span
from swe_sphere.operators.strips import Strips
from swe_sphere.ranks.communicator import Communicator

ALONE = Communicator()
REALS = {"float64": wp.float64, "float32": wp.float32}
LEAST_AWAY = 32
"""Smallest number of groups away from the rim for which two launches pay off."""


@dataclass(frozen=True)
class Field:
    """Values at the nodes of each element, local results there before DSS, or a coarse vector.

    `values` (groups + 1, np*np, unknowns) or (registers,): SIMD registers; `flat`: their numbers.
    """

    values: wp.array
    flat: wp.array


class DeviceMesh(NotCopyable):
    """Element data of a mesh, or of this rank's part of it, in the memory of a Warp device.

    real: Warp number type; shape: launch shape "element" or "node". Arrays at nodes hold one field
    after the other. Arrays on element nodes are (groups, np*np, ..., lanes), with `lanes` elements
    side by side in registers; copies of the last element, which DSS never reads, pad the last
    group. Metric terms are computed in float64 and then rounded to `real`: a float32 geometry would
    excite a spurious wave (Nakano et al. 2018, doi:10.1175/MWR-D-17-0257.1).
    """

    def __init__(
        self, mesh: Mesh, device: str, real: Any, shape: str, comm: Communicator = ALONE,
        part: MeshPart | None = None, launch: Launcher | None = None,
    ) -> None:  # fmt: skip
        if part is None and comm.shared:
            part = Partition(mesh, comm.size).part(comm.rank)
        part = part or single_part(mesh, shape)
        self.mesh, self.part, self.comm = mesh, part, comm
        self.launch = launch or Launcher(device, comm, mesh.np**2)
        self.device, self.real, self.shape = device, real, shape
        self.elements, self.size = part.element_numbers.size, part.node_numbers.size
        self.points = mesh.np**2
        """Number of elements and of nodes of this rank, and of the nodes of an element."""
        self.lanes = lanes_of(real) if shape == "element" else 1
        self.groups = -(-self.elements // self.lanes)
        self.numpy_real = np.dtype(wp.dtype_to_numpy(real))
        self.derivative = self.upload(mesh.derivative)
        """Derivative matrix of the GLL nodes."""
        self.weight = self.upload(mesh.quadrature)
        """Products of GLL weights (np, np)."""
        self.stage = stage_struct(real)()
        """Stage that is not `on`: rates are stored unchanged."""
        received = -(-sum(part.receives.values()) // self.lanes)
        received += bool(received)  # loads of whole registers may end behind the last value
        self.rows = (self.groups + 1 + -(-received // self.points)) * self.points
        """Number of rows in a local field: element nodes, an empty group, and received values."""
        self.halos: dict[int, Halo] = {}
        """Exchanges between ranks by the address of the array."""
        self._stages: dict[tuple[int, int, float], Any] = {}
        self.places = functools.cache(self._find_places)
        self._awaited: Halo | None = None  # exchange that `over_elements` left in transit
        self.scratch = functools.cache(self.local)
        """Function like `local`, but operators share the field: read it before the next launch."""

    def like(self, real: Any, shape: str) -> "DeviceMesh":
        """Return the same part in another number type or launch shape."""
        if (real, shape) == (self.real, self.shape):
            return self
        return DeviceMesh(self.mesh, self.device, real, shape, self.comm, self.part, self.launch)

    def types(self, **options: Any) -> KernelTypes:
        """Return the types of kernels on these elements; the options are those of `KernelTypes`."""
        return kernel_types(self.mesh.np, self.real, self.shape, **options)

    def threads(self, *fields: int) -> int | tuple[int, ...]:
        """Return the threads of a launch over element nodes, and over `fields` in shape "node"."""
        return self.groups if self.shape == "element" else (self.groups, *fields, self.points)

    @functools.cached_property
    def chunks(self) -> Chunks:
        """The parts of sums over nodes, which do not depend on the number of ranks."""
        return Chunks(self.part, self.launch)

    @functools.cached_property
    def nodes(self) -> wp.array:
        """Unique node numbers of the element nodes; for runs see `kernels/simd/memory.py`."""
        numbers = self.in_lanes(self.part.nodes.reshape(self.elements, self.points, 1))
        if self.lanes > 1:
            numbers[..., 0][(np.diff(numbers) == 1).all(axis=-1)] ^= -1
        return self.registers(numbers[:, :, 0], wp.int32)

    @functools.cached_property
    def basis(self) -> wp.array:
        """The four entries of dx/dxi_i . e_k [m] at the element nodes."""
        return self.on_elements(self.mesh.basis[self.part.element_numbers], (4,))

    @functools.cached_property
    def inverse_jacobian(self) -> wp.array:
        """One over the area element [m-2]."""
        return self.on_elements(1.0 / self.mesh.jacobian[self.part.element_numbers])

    @functools.cached_property
    def inner(self) -> int:
        """Number of nodes inside the elements of `block_groups`, which are numbered first."""
        return self.block_groups * self.lanes * (self.mesh.np - 2) ** 2

    @functools.cached_property
    def block_groups(self) -> int:
        """Number of groups whose nodes inside elements are numbered in blocks of BLOCK elements."""
        blocks, side = self.elements // BLOCK, self.mesh.np - 2
        inside = self.part.nodes[: blocks * BLOCK, 1:-1, 1:-1].reshape(blocks, BLOCK, side, side)
        expected = np.arange(inside.size).reshape(blocks, side, side, BLOCK)
        fits = (np.moveaxis(inside, 1, -1) == expected).all(axis=(1, 2, 3))
        return int(np.logical_and.accumulate(fits).sum()) * BLOCK // self.lanes

    @functools.cached_property
    def work(self) -> int:
        """Address of the work arrays of a group; kernels run one after the other and share it."""
        self._work = wp.zeros(work_bytes(self.mesh.np), dtype=wp.uint8, device=self.device)
        return int(self._work.ptr)

    @functools.cached_property
    def fluxes(self) -> wp.array:
        """Array for the fluxes of diffused fields, in the launch shape "node"."""
        return self.unshared(4, self.real).values

    def stage_at(self, start: wp.array, tau: float) -> Any:
        """Return the stage that stores start + tau rate, the same object for the same arguments."""
        key = start.ptr, start.size, tau
        if key not in self._stages:
            if len(self._stages) >= MOST_CACHED:
                self._stages.clear()
            stage = self._stages[key] = stage_struct(self.real)()
            stage.on, stage.start, stage.tau = True, start, tau
        return self._stages[key]

    @functools.cached_property
    def inverse_area(self) -> wp.array:
        """One over the nodal area (N,) [m-2]."""
        return self.scatter(1.0 / self.mesh.area)

    def _find_places(self, unknowns: int) -> wp.array:
        """Return offsets (N,) of each node's contributors in local arrays of `unknowns` fields.

        A missing contributor is -1; the fourth of three points to the empty group. Raises
        ConfigError if the offsets exceed 32 bits.
        """
        width, count = unknowns * self.lanes, self.part.counts
        if self.rows * width >= 2**31:
            raise ConfigError(
                f"{unknowns} fields of this part of the mesh have more than 2^31 numbers: take more"
                " ranks, or a coarser mesh"
            )
        places = np.full((self.size, 4), -1, dtype=np.int32)
        places[count == 3, 3] = self.groups * self.points * width
        node = np.repeat(np.arange(self.size), count)
        turn = np.arange(node.size) - np.repeat(np.cumsum(count) - count, count)
        places[node, turn] = self._positions(self.part.contributors, width)
        return wp.array(places, dtype=Contributors, device=self.device)

    @functools.cached_property
    def first_copies(self) -> wp.array:
        """Offset (N,) of each node in a local field, in this rank's first element that has it."""
        around = self.places(1).numpy()
        is_own = (around >= 0) & (around < self.groups * self.points * self.lanes)
        first = np.take_along_axis(around, np.argmax(is_own, axis=1)[:, None], axis=1)
        return wp.array(first[:, 0], dtype=wp.int32, device=self.device)

    @functools.cached_property
    def contributors(self) -> dict[str, wp.array]:
        """Offsets in a local field of the contributors from other elements to each element node.

        `runs` (groups, np*np, 3) and `others` are stored as by `in_runs`. A node on an element's
        edge has one such contributor, a corner has three; a missing one points to the empty group.
        DSS adds an element's own contribution to the first one before the other two, so that (own +
        first) + (second + third) has the same bits in every element.
        """
        own = self._positions(np.arange(self.elements * self.points), self.lanes)
        around = self.places(1).numpy()[self.part.nodes.ravel()]
        mine = np.argmax(around == own[:, None], axis=1)[:, None]
        away = np.take_along_axis(around, mine ^ np.array([1, 2, 3]), axis=1)
        empty = self.groups * self.points * self.lanes
        places = np.where(away < 0, empty, away).reshape(self.elements, -1, 3)
        runs, others = self.runs(self.in_lanes(places).reshape(self.groups, -1, 3, self.lanes))
        return {"runs": runs, "others": others}

    def runs(self, places: NDArray[np.integer]) -> tuple[wp.array, wp.array]:
        """Return the places (..., lanes) of registers as `load_runs` reads them, see `in_runs`."""
        plain = places[..., 0], places.reshape(-1, self.lanes)[:0]
        runs, rest = in_runs(places) if self.lanes > 1 else plain
        stored = wp.array(runs, Runs if self.lanes > 1 else wp.int32, device=self.device)
        return stored, self.registers(rest, wp.int32)

    def geometry(self, kind: Any, given: Mapping[str, Any] | None = None) -> Any:
        """Return a Warp structure `kind`, with members by name from `given`, else from the mesh."""
        filled, known = kind(), given or {}
        for name in kind.vars:
            setattr(filled, name, known[name] if name in known else getattr(self, name))
        return filled

    def local(self, unknowns: int, value: Any, blocks: int = 1) -> Field:
        """Return an array of local tendencies: blocks (groups + 1 ..., np*np, unknowns) of `value`.

        `value` is a Warp type. No element writes to the first group behind the elements, which
        stays zero; the groups behind that one receive values of other ranks, see `exchange`.
        """
        field, part = self.unshared(unknowns, value, blocks), self.part
        if part.sends:
            width = field.flat.size // (blocks * self.rows)
            starts = self.rows * width * np.arange(blocks)[:, None]
            offsets = (starts + np.arange(0, width, self.lanes)).ravel()
            ends = np.cumsum([*part.receives.values()])
            slots = np.split(-1 - np.arange(ends[-1]), ends[:-1])
            sends, receives = (
                {rank: self._positions(e, width)[:, None] + offsets for rank, e in each.items()}
                for each in (part.sends, dict(zip(part.receives, slots, strict=True)))
            )
            self.register_exchange(field.flat, sends, receives)
        return field

    def unshared(self, unknowns: int, value: Any, blocks: int = 1) -> Field:
        """Return an array like that of `local`, but without messages to and from other ranks."""
        rows = blocks * self.rows // self.points
        return self.field(wp.zeros((rows, self.points, unknowns), value, device=self.device))

    def register_exchange(
        self, flat: wp.array, sends: Mapping[int, Any], receives: Mapping[int, Any]
    ) -> None:
        """Register an array (n,) for `exchange`; all ranks must call this method together.

        sends, receives: by neighbour, positions of the values to send and of those to receive.
        """
        if self.comm.size > 1:
            self.halos[flat.ptr] = Halo(self.launch, flat, sends, receives)

    def exchange(self, field: Field) -> None:
        """Fetch local results from other ranks for the nodes that this rank shares."""
        if self.halos:
            self.halos[field.flat.ptr]()

    def over_elements(
        self, field: Field | None, kernel: Any, threads: Any, *inputs: Any, wait: bool = True
    ) -> None:
        """Launch a kernel, whose first argument is its first group of elements, over all elements.

        The kernel stores its results in `field`, if other ranks read them. Several ranks launch the
        groups on the rim first, and exchange their results while the groups away from it are
        computed. wait: False if a function of `over_nodes`, which waits itself, reads the results.
        """
        each, cuts = threads[1:] if isinstance(threads, tuple) else (), None
        away = self.groups if field is None else self.away
        if self.strips is not None:
            away, cuts = self.away, self.strips.groups
        if away < self.groups:
            on_rim = cuts is not None  # otherwise these may be all
            self.launch(kernel, (self.groups - away, *each), away, *inputs, on_rim=on_rim)
        self._awaited = None if field is None else self.halos.get(field.flat.ptr)
        if self._awaited is not None:
            self._awaited.start()
        if away:
            self.launch(kernel, (away, *each), 0, *inputs, cuts=cuts)
        if wait:
            self.wait()

    def wait(self) -> None:
        """Wait for the values of other ranks that the last `over_elements` left in transit."""
        if self._awaited is not None:
            self._awaited.wait()
            self._awaited = None

    @functools.cached_property
    def away(self) -> int:
        """Number of groups of elements away from the rim; 0 if they are too few for a launch."""
        if not self.comm.shared:
            return self.groups
        away = self.part.interior_elements // self.lanes
        return away if away >= LEAST_AWAY else 0

    @functools.cached_property
    def is_cut(self) -> bool:
        """True if parts of this mesh that are not too small are cut into strips."""
        return self.lanes > 1 and self.mesh.nodes.size >= partition.RINGED

    @functools.cached_property
    def strips(self) -> Strips | None:
        """Strips for launches away from the rim; None on small parts and in launch shape "node"."""
        if self.is_cut:  # all ranks load the kernel together, although some may have no strips
            (self.launch.sweep,) = self.launch.compile(wp.float64, sweep_strips)
        has_strips = self.is_cut and self.away and self.part.interior_nodes.any()
        return Strips(self.part, self.away, self.lanes) if has_strips else None

    def spans(self, begin: int = 0) -> list[Span]:
        """Return the nodes from `begin` on: in one span, or as `Strips.spans`."""
        spans = [Span(0, self.size)] if self.strips is None else self.strips.spans
        return [Span(max(s.begin, begin), *s[1:]) for s in spans if s.end > begin]

    def over_nodes(
        self, kernel: Any, begin: int = 0, lanes: int | None = None, spans: Iterable[Span] = ()
    ) -> Callable[..., None]:
        """Return a function that launches a kernel over the nodes from `begin` on, or over `spans`.

        A thread processes `lanes` numbers, by default those of a register, or one in the remainder
        of a span. The first argument of the kernel is its first number; callers give the others.
        Values in transit from other ranks are awaited before the first span outside the strips.
        Without strips in a recording and values in transit, all nodes are one span.
        """
        lanes = lanes or self.lanes
        parts = self._runs(kernel, spans or self.spans(begin), lanes)
        whole = self._runs(kernel, spans or [Span(begin, self.size)], lanes)
        self.launch.load(*(made[0] for made, *_ in (*parts, *whole)))

        def launch_all(*arguments: Any) -> None:
            in_parts = self.launch.defer or self._awaited
            for made, cuts, on_rim in parts if in_parts else whole:
                if cuts is None:
                    self.wait()
                self.launch(*made, *arguments, cuts=cuts, on_rim=on_rim)
            self.wait()

        return launch_all

    def _runs(self, kernel: Any, spans: Iterable[Span], lanes: int) -> list[tuple[Any, ...]]:
        """Return for each launch: kernel, threads, first number; its cuts; if it is on the rim."""
        runs = []
        for span in spans:
            whole = span.begin + (span.end - span.begin) // lanes * lanes
            for n, a, b in (lanes, span.begin, whole), (1, whole, span.end):
                if a < b:
                    made = specialise(kernel, Register(self.real, n)), (b - a) // n, a
                    runs.append((made, span.cut(a, b, n), span.on_rim))
        return runs

    def launch_over_fields(self, kernel: Any, numbers: int, *inputs: Any) -> None:
        """Launch a kernel, whose first argument is its first number, over fields (numbers,)."""
        if self.strips is None or self.launch.defer is None:
            self.launch(kernel, numbers, 0, *inputs)
            return
        for field in range(0, numbers, self.size):
            for span in self.strips.spans:
                there = span.end - span.begin, field + span.begin, *inputs
                cuts = span.cut(span.begin, span.end, 1, field)
                self.launch(kernel, *there, cuts=cuts, on_rim=span.on_rim)

    def _positions(self, entries: NDArray[Any], width: int) -> NDArray[np.int64]:
        """Return the offsets of element nodes (element np^2 + point) in rows of the length `width`.

        Received values, -1 - k, follow the empty group.
        """
        element, point = np.divmod(entries, self.points)
        group, lane = np.divmod(element, self.lanes)
        behind, lane_behind = np.divmod(-1 - entries, self.lanes)
        received = (self.groups + 1) * self.points + behind
        row = np.where(entries >= 0, group * self.points + point, received)
        return row * width + np.where(entries >= 0, lane, lane_behind)

    def field(self, values: wp.array) -> Field:
        """Return an array of registers of the mesh's number type, and its memory as numbers."""
        size = wp.types.type_size_in_bytes
        numbers = values.size * size(values.dtype) // size(self.real)
        flat = wp.array(ptr=values.ptr, shape=(numbers,), dtype=self.real, device=self.device)
        return Field(values, flat)

    def upload(self, values: Array) -> wp.array:
        """Return a numpy array on the device in the number type of the mesh."""
        numbers = np.ascontiguousarray(values, self.numpy_real)
        return wp.array(numbers, dtype=self.real, device=self.device)

    def write(self, values: NDArray[Any], to: wp.array) -> None:
        """Copy numbers (k,) from the host to the front of an array, on a CPU without Warp."""
        if to.device.is_cpu:
            to.numpy()[: values.size] = values
        else:
            wp.copy(to, self.upload(values), count=values.size)

    def on_elements(
        self, values: NDArray[Any], tail: tuple[int, ...] = (), scalar: Any = None
    ) -> wp.array:
        """Return (e, k, *tail) or (e, np, np, *tail) of this rank's elements as (groups, k, *tail).

        The result contains registers of lanes. scalar: a number type other than the mesh's.
        """
        lanes = self.in_lanes(values.reshape(self.elements, -1, math.prod(tail)))
        return self.registers(lanes.reshape(*lanes.shape[:2], *tail, self.lanes), scalar)

    def in_lanes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return (e, k, ...) as (groups, k, m, lanes), with m numbers in the axes after k."""
        short = self.groups * self.lanes - self.elements
        padded = np.concatenate([values, np.repeat(values[-1:], short, axis=0)])
        grouped = padded.reshape(self.groups, self.lanes, values.shape[1], -1)
        return np.ascontiguousarray(grouped.transpose(0, 2, 3, 1))

    def registers(self, values: NDArray[Any], scalar: Any = None) -> wp.array:
        """Return numbers (..., lanes) on the device, lanes side by side; see `on_elements`."""
        scalar = scalar or self.real
        dtype = wp.types.vector(self.lanes, scalar) if self.lanes > 1 else scalar
        array = wp.zeros(values.shape[:-1], dtype, device=self.device)
        array.assign(values.astype(wp.dtype_to_numpy(scalar)).reshape(array.numpy().shape))
        return array

    def scatter(self, values: Array) -> wp.array:
        """Return fields (k N,) of the whole mesh on the nodes (k n,) of this rank."""
        return self.upload(self.on_rank(values))

    def on_rank(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return fields (..., k N) of the whole mesh at the nodes of this rank: (..., k n)."""
        if self.part.is_mesh:
            return values
        fields = values.reshape(-1, self.mesh.size)
        here = np.take(fields, self.part.node_numbers, axis=1, mode="clip")  # faster than an index
        return here.reshape(*values.shape[:-1], -1)

    def collect(self, vector: wp.array | NDArray[Any]) -> NDArray[Any]:
        """Return fields (..., k n) of all ranks on the host as those of the whole mesh (..., k N).

        Fields are sent one by one, so that messages take no more memory than one field.
        """
        values: NDArray[Any] = vector.numpy() if isinstance(vector, wp.array) else vector
        if self.part.is_mesh:
            return values
        fields = values.reshape(-1, self.size)
        joined = np.empty((len(fields), self.mesh.size), values.dtype)
        room = np.empty(self.mesh.size, values.dtype)
        counts, places = self._owners
        for field, out in zip(fields, joined, strict=True):
            gathered = self.comm.allgather_arrays(field[self.part.owned], counts, room)
            np.take(gathered, places, out=out, mode="clip")
        return joined.reshape(*values.shape[:-1], -1)

    @functools.cached_property
    def _owners(self) -> tuple[list[int], NDArray[Any]]:
        """Number of nodes by owning rank, and position (N,) of each node in the joined nodes."""
        numbers = self.comm.allgather(self.part.node_numbers[self.part.owned])
        return [each.size for each in numbers], inverse_permutation(np.concatenate(numbers))
