"""Time of kernels, of hand-written C and of the machine limits, in ns per element node on one core.

    python benchmarks/kernel_bound.py [kernels] [large]

All cases of one mesh and precision are evaluated in turn, one call each, so that other load on the
machine affects all of them.  Meshes have about 25 000 element nodes, whose arrays fit into the last
cache.  In `large` np is 4, and meshes grow from this size to 100 times the second-level cache.
"""

from __future__ import annotations

import ctypes
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import typer
import warp as wp
from effect_cost import recorded
from matplotlib.ticker import FixedLocator, NullFormatter
from sections import PAGES, Section, command

from swe_sphere.equations.model import Model
from swe_sphere.mesh import Mesh
from swe_sphere.operators.replay import Replay
from swe_sphere.steppers import get_stepper
from swe_sphere.steppers.stepper import Stepper
from swe_sphere.testcases import get_scene

ELEMENTS = {4: 16, 6: 12, 8: 8, 12: 4}
"""Elements along the edge of a cube face for each np; their number fills whole registers."""
PRECISIONS = {"float64": "double", "float32": "float"}
SCENE = "williamson5"
FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-mprefer-vector-width=512")
SOURCE = Path(__file__).with_suffix(".c")
PARTS = ("local", "DSS", "whole", "stage")
COPIED = 2 << 20
"""Bytes of a copy that fits into the last cache, as the arrays of a mesh do."""
LARGE = (16, 30, 60, 120)
"""Elements along the edge of a cube face in `large`."""
ROUNDS, ROUNDS_LARGE, ROUNDS_OF_ARITHMETIC = 400, 20, 2000


@dataclass
class Case:
    """Measurements for one np and precision."""

    ne: int
    np: int
    precision: str
    times: dict[tuple[str, str], list[float]]
    """Times [ns per element node] by program (Warp or C) and part."""
    flops: float
    """Floating-point operations per element node."""
    bytes: float
    """Bytes per element node that a right-hand side must move."""
    bandwidth: float = 0.0
    """Bandwidth of a copy, reads and writes [B/ns]."""
    peak: float = 0.0
    """Peak rate of products and sums [1/ns]."""

    def least(self, who: str, part: str) -> float:
        """Return the least time [ns per element node]."""
        return min(self.times[who, part])


def counts(mesh: Mesh, size: int) -> tuple[float, float]:
    """Return operations and bytes per element node; local tendencies are written and read again."""
    unique = mesh.size / mesh.nodes.size
    inner = (mesh.np - 2) ** 2 / mesh.np**2
    rim = unique - inner
    reals = 4 + (3 + 1 + 3 + 2) * unique + 2 * rim + 6 * (1 - inner)
    return 12 * mesh.np + 40 + 7 * unique, size * reals + 4 + 16 * rim


def compile_bound(np_: int, precision: str, folder: str) -> ctypes.CDLL | None:
    """Return the compiled C program as a library; None if no compiler is found."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    out = Path(folder, f"bound_{np_}_{precision}.so")
    defines = (f"-DNP={np_}", f"-DREAL={PRECISIONS[precision]}")
    command = [compiler, *FLAGS, "-shared", "-fPIC", *defines, str(SOURCE), "-o", str(out)]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(out))


def measure(ne: int, np_: int, precision: str, library: ctypes.CDLL | None, rounds: int) -> Case:
    """Measure all parts of both programs in turns; return the case."""
    mesh = Mesh.build(ne, np_)
    model = Model(mesh, get_scene(SCENE), precision=precision)
    stepper = get_stepper("rk4")(model, 60.0)
    stepper.start(model.initial_state())
    calls = {("Warp", part): call for part, call in _ours(model, stepper).items()}
    if library is not None:
        calls |= {("C", part): call for part, call in _by_hand(model, library).items()}
    for call in (*calls.values(),) * 3:  # which records them too
        call()
    times: dict[tuple[str, str], list[float]] = {key: [] for key in calls}
    for _ in range(rounds):
        for key, call in calls.items():
            times[key].append(_seconds(call) * 1e9 / mesh.nodes.size)
    stages = 4 * stepper.fused_steps
    times["Warp", "stage"] = [t / stages for t in times["Warp", "stage"]]
    numbers = counts(mesh, model.device_mesh.numpy_real.itemsize)
    case = Case(ne, np_, precision, times, *numbers)
    if library is not None:
        copied = COPIED if ne == ELEMENTS[np_] else int(case.bytes * mesh.nodes.size)
        case.bandwidth, case.peak = _machine_limits(library, case.precision, copied, rounds)
    return case


def _ours(model: Model, stepper: Stepper) -> dict[str, Callable[[], object]]:
    """Return the calls of this package by part, with recorded launches.

    "stage" takes as many steps of rk4 as large meshes take at once.
    """
    state, out, replay = model.initial_state(), model.zeros(), Replay(model.launch)
    local, *dss = recorded(model)

    def steps() -> None:
        end = stepper.steps + stepper.fused_steps
        while stepper.steps < end:
            stepper.take(end - stepper.steps)

    def launch(*launches: tuple[Any, int, tuple[Any, ...]]) -> None:
        for kernel, threads, arguments in launches:
            model.launch(kernel, threads, *arguments)

    return {
        "local": partial(replay, "local", launch, local),
        "DSS": partial(replay, "DSS", launch, *dss),
        "whole": lambda: model.tendency(state, 0.0, out),
        "stage": steps,
    }


def _by_hand(model: Model, library: ctypes.CDLL) -> dict[str, Callable[[], object]]:
    mesh, state, out, stage = model.device_mesh, model.initial_state(), model.zeros(), model.zeros()
    (operation,) = model.tendency.operations
    operator: Any = operation.operator
    room = operator.local
    local, flat = room.values, room.flat
    given = model.parameters
    gravity = np.array([given["gravity"]], dtype=mesh.numpy_real)
    step = np.array([60.0], dtype=mesh.numpy_real)
    size = ctypes.c_size_t(mesh.size)

    def pointer(array: wp.array | np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data if isinstance(array, np.ndarray) else array.ptr)

    over_elements = [
        pointer(array)
        for array in (
            mesh.nodes, mesh.basis, mesh.derivative, mesh.weight, gravity, given["bottom"],
            mesh.inverse_area, given["coriolis"], state, local, out,
        )
    ]  # fmt: skip
    over_nodes = [
        pointer(array)
        for array in (mesh.places(3), mesh.inverse_area, given["coriolis"], flat, state, out)
    ]
    kept = (state, out, stage, local, flat, gravity, step)
    to_stage = [pointer(array) for array in (state, out, step, stage)]

    def element() -> object:
        return library.element(mesh.groups, mesh.block_groups, size, *over_elements), kept

    def dss() -> None:
        library.dss(mesh.inner, size, *over_nodes)

    def whole() -> None:
        element()
        dss()

    def with_stage() -> None:
        whole()
        library.stage(ctypes.c_size_t(state.size), *to_stage)

    whole()
    expected = model.zeros()
    model.tendency(state, 0.0, expected)
    error = np.abs(out.numpy() - expected.numpy()).max() / np.abs(expected.numpy()).max()
    assert error < 1e5 * np.finfo(mesh.numpy_real).eps, f"C and Warp differ by {error:.1e}"
    return {"local": element, "DSS": dss, "whole": whole, "stage": with_stage}


def _machine_limits(
    library: ctypes.CDLL, precision: str, copied: int, rounds: int
) -> tuple[float, float]:
    source, target = np.ones(copied, np.uint8), np.ones(copied, np.uint8)
    registers = np.ones(64 * 9, np.uint8)
    registers = registers[-registers.ctypes.data % 64 :]
    chains = 8 * library.register_bytes() // np.dtype(precision).itemsize
    ends = [ctypes.c_void_p(a.ctypes.data) for a in (source, target, registers)]
    moved = min(
        _seconds(lambda: library.copy(ctypes.c_size_t(copied), *ends[:2])) for _ in range(rounds)
    )
    done = min(
        _seconds(lambda: library.arithmetic(ctypes.c_size_t(ROUNDS_OF_ARITHMETIC), ends[2]))
        for _ in range(rounds)
    )
    return 2 * copied / moved * 1e-9, 2 * chains * ROUNDS_OF_ARITHMETIC / done * 1e-9


def _seconds(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start


HEAD = ["np", "precision", *PARTS[:3], "median", "stage of rk4", "C: local", "DSS", "whole",
        "stage", "Warp / C", "bytes / copy", "operations / peak"]  # fmt: skip
LARGE_HEAD = ["ne", "precision", "right-hand side", "stage of rk4", "over ne 16", "C: whole",
              "stage", "bytes / copy"]  # fmt: skip


def large_rows(cases: list[Case]) -> list[list[str]]:
    """Return rows with the least times of a right-hand side and of a quarter of a step of rk4."""
    rows, first = [], {case.precision: case for case in reversed(cases)}
    for case in cases:
        stage, limit = case.least("Warp", "stage"), case.bytes / case.bandwidth
        growth = stage / first[case.precision].least("Warp", "stage")
        least = (case.least("C", part) for part in ("whole", "stage"))
        numbers = case.least("Warp", "whole"), stage, growth, *least, limit
        rows.append([str(case.ne), case.precision, *(f"{number:.2f}" for number in numbers)])
    return rows


def _row(case: Case) -> list[str]:
    ours = [f"{case.least('Warp', part):.2f}" for part in PARTS]
    ours.insert(3, f"{statistics.median(case.times['Warp', 'whole']):.2f}")
    named = [str(case.np), case.precision, *ours]
    bound = [f"{case.least('C', part):.2f}" for part in PARTS]
    ratio = f"{case.least('Warp', 'whole') / case.least('C', 'whole'):.2f}"
    limits = [f"{case.bytes / case.bandwidth:.2f}", f"{case.flops / case.peak:.2f}"]
    return [*named, *bound, ratio, *limits]


def draw(cases: list[Case], path: Path) -> None:
    """Draw operations per ns against operations per byte, below the limits of the machine."""
    figure, both = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", sharey=True)
    for axes, precision in zip(both, PRECISIONS, strict=True):
        mine = [case for case in cases if case.precision == precision]
        bandwidth = max(case.bandwidth for case in mine)
        peak = max(case.peak for case in mine)
        intensity = np.geomspace(0.4, 8.0, 200)
        axes.loglog(intensity, np.minimum(bandwidth * intensity, peak), "k", label="limit")
        for who, marker in (("Warp", "o"), ("C", "x")):
            across = [case.flops / case.bytes for case in mine]
            up = [case.flops / case.least(who, "whole") for case in mine]
            axes.plot(across, up, marker, label=who)
            if who == "Warp":
                for case, x, y in zip(mine, across, up, strict=True):
                    axes.annotate(str(case.np), (x, 0.9 * y), ha="center", va="top")
        axes.set(title=f"{precision}, np below the points", xlabel="operations a byte")
        axes.set_ylim(8.0, 200.0)
        for axis, at in ((axes.xaxis, (0.5, 1, 2, 4, 8)), (axes.yaxis, (10, 20, 50, 100, 200))):
            axis.set_major_locator(FixedLocator(at))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        axes.grid(alpha=0.3)
    both[0].set_ylabel("operations a nanosecond")
    both[0].legend()
    figure.savefig(path)


def cases_of(meshes: Iterable[tuple[int, int]], rounds: int) -> list[Case]:
    """Measure meshes (ne, np) in both precisions; end the program where there is no C compiler."""
    if shutil.which("cc") is None and shutil.which("gcc") is None:
        raise SystemExit("install a C compiler (cc or gcc): its program is the bound")
    with TemporaryDirectory() as folder:
        return [
            measure(ne, np_, precision, compile_bound(np_, precision, folder), rounds)
            for ne, np_ in meshes
            for precision in PRECISIONS
        ]


def kernels() -> Section:
    """Kernels of meshes in the cache, and the picture of the page."""
    cases = cases_of([(ne, np_) for np_, ne in ELEMENTS.items()], ROUNDS)
    draw(cases, PAGES / "performance.svg")
    return Section(
        f"A right-hand side of {SCENE} with DSS on one core",
        "The table shows nanoseconds an element node on ne 16, 12, 8 and 4 (in the order of np),"
        " for this package and for a C program with the same arrays (np known to its compiler,"
        f" `{' '.join(FLAGS)}`). Each time is the least of {ROUNDS} calls, which were made in"
        " turns; *median* is the median of the whole right-hand side.",
        HEAD,
        [_row(case) for case in cases],
    )


def large() -> Section:
    """Kernels of growing meshes."""
    cases = cases_of([(ne, 4) for ne in LARGE], ROUNDS_LARGE)
    return Section(
        "Large meshes, np 4",
        f"Nanoseconds of CPU time an element node: least of {ROUNDS_LARGE} calls of each made in"
        " turns. *over ne 16*: the stage over the one on ne 16. *bytes / copy*: every array of a"
        " right-hand side moved once, at the rate of a copy of as many bytes.",
        LARGE_HEAD,
        large_rows(cases),
    )


main = command("performance", {"kernels": kernels, "large": large})


def _size(np_: int) -> int:
    return 6 * (ELEMENTS[np_] * (np_ - 1)) ** 2 + 2


if __name__ == "__main__":
    typer.run(main)
