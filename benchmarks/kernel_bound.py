"""Kernels beside C by hand and beside what the machine can do, in ns an element node, on one core.

    python benchmarks/kernel_bound.py [--rounds 400] [--write docs/results]
    python benchmarks/kernel_bound.py --large [--rounds 20] [--write docs/results]

All cases of one mesh and precision are evaluated in turn, one call each, so that a busy moment
meets all of them.  Meshes have about 25 000 element nodes, whose arrays fit into the last cache;
with --large np is 4 and meshes grow from there to a hundred times the size of the second-level
cache.  Each form replaces its own table in the page.
"""

from __future__ import annotations

import ctypes
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
import warp as wp
from effect_cost import recorded
from matplotlib.ticker import FixedLocator, NullFormatter
from rich.console import Console

from swe_sphere.equations.model import Model
from swe_sphere.files.fingerprints import machine
from swe_sphere.mesh import Mesh
from swe_sphere.operators.replay import Replay
from swe_sphere.steppers import get_stepper
from swe_sphere.testcases import get_scene

ELEMENTS = {4: 16, 6: 12, 8: 8, 12: 4}
"""Elements along a face's edge for each np; those of a mesh fill whole registers."""
PRECISIONS = {"float64": "double", "float32": "float"}
SCENE = "williamson5"
FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-mprefer-vector-width=512")
SOURCE = Path(__file__).with_suffix(".c")
PARTS = ("local", "DSS", "whole", "stage")
COPIED = 2 << 20
"""Bytes of a copy: in the last cache, as the arrays of a mesh."""
LARGE = (16, 30, 60, 120)
"""Elements along a face's edge with --large."""
ROUNDS_OF_ARITHMETIC = 2000


@dataclass
class Case:
    """What was measured for one np and precision."""

    ne: int
    np: int
    precision: str
    times: dict[tuple[str, str], list[float]]
    """ns an element node by who (Warp, C) and part."""
    flops: float
    """Of an element node."""
    bytes: float
    """That its right-hand side must move."""
    bandwidth: float = 0.0
    """Of a copy, reads and writes [B/ns]."""
    peak: float = 0.0
    """Of products and sums [1/ns]."""

    def least(self, who: str, part: str) -> float:
        """The fastest."""
        return min(self.times[who, part])


def counts(mesh: Mesh, size: int) -> tuple[float, float]:
    """Operations and bytes of an element node: every array once, local tendencies both ways."""
    unique = mesh.size / mesh.nodes.size
    inner = (mesh.np - 2) ** 2 / mesh.np**2
    rim = unique - inner
    reals = 4 + (3 + 1 + 3 + 2) * unique + 2 * rim + 6 * (1 - inner)
    return 12 * mesh.np + 40 + 7 * unique, size * reals + 4 + 16 * rim


def compile_bound(np_: int, precision: str, folder: str) -> ctypes.CDLL | None:
    """The C program, or None where there is no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    out = Path(folder, f"bound_{np_}_{precision}.so")
    defines = (f"-DNP={np_}", f"-DREAL={PRECISIONS[precision]}")
    command = [compiler, *FLAGS, "-shared", "-fPIC", *defines, str(SOURCE), "-o", str(out)]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(out))


def measure(ne: int, np_: int, precision: str, library: ctypes.CDLL | None, rounds: int) -> Case:
    """All parts of both, in turn."""
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
    times["Warp", "stage"] = [t / 4 for t in times["Warp", "stage"]]
    numbers = counts(mesh, model.device_mesh.numpy_real.itemsize)
    case = Case(ne, np_, precision, times, *numbers)
    if library is not None:
        copied = COPIED if ne == ELEMENTS[np_] else int(case.bytes * mesh.nodes.size)
        case.bandwidth, case.peak = _machine_limits(library, case.precision, copied, rounds)
    return case


def _ours(model: Model, stepper: object) -> dict[str, Callable[[], object]]:
    """All recorded, as in runs.  The part "stage" is a whole step of rk4."""
    state, out, replay = model.initial_state(), model.zeros(), Replay(model.launch)
    local, *dss = recorded(model)

    def launch(*launches: tuple[Any, int, tuple[Any, ...]]) -> None:
        for kernel, threads, arguments in launches:
            model.launch(kernel, threads, *arguments)

    return {
        "local": partial(replay, "local", launch, local),
        "DSS": partial(replay, "DSS", launch, *dss),
        "whole": lambda: model.tendency(state, 0.0, out),
        "stage": stepper.step,
    }


def _by_hand(model: Model, library: ctypes.CDLL) -> dict[str, Callable[[], object]]:
    mesh, state, out, stage = model.device_mesh, model.initial_state(), model.zeros(), model.zeros()
    (operation,) = model.tendency.operations
    room = operation.operator.local
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
        return library.element(mesh.groups, mesh.whole, size, *over_elements), kept

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


def table(cases: list[Case]) -> str:
    """Markdown: the least, and the median of the whole."""
    head = ["np", "precision", *PARTS[:3], "median", "stage of rk4", "C: local", "DSS", "whole",
            "stage", "Warp / C", "bytes / copy", "operations / peak"]  # fmt: skip
    lines = [head, ["---"] * len(head), *(_row(case) for case in cases)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def large_table(cases: list[Case]) -> str:
    """Markdown: the least times of a right-hand side and of a quarter of a step of rk4."""
    head = ["ne", "precision", "right-hand side", "stage of rk4", "over ne 16", "C: whole", "stage",
            "bytes / copy"]  # fmt: skip
    lines, first = [head, ["---"] * len(head)], {case.precision: case for case in reversed(cases)}
    for case in cases:
        stage, limit = case.least("Warp", "stage"), case.bytes / case.bandwidth
        growth = stage / first[case.precision].least("Warp", "stage")
        least = (case.least("C", part) for part in ("whole", "stage"))
        numbers = case.least("Warp", "whole"), stage, growth, *least, limit
        lines.append([str(case.ne), case.precision, *(f"{number:.2f}" for number in numbers)])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _row(case: Case) -> list[str]:
    ours = [f"{case.least('Warp', part):.2f}" for part in PARTS]
    ours.insert(3, f"{statistics.median(case.times['Warp', 'whole']):.2f}")
    named = [str(case.np), case.precision, *ours]
    if not case.peak:
        return [*named, *["–"] * 7]
    bound = [f"{case.least('C', part):.2f}" for part in PARTS]
    ratio = f"{case.least('Warp', 'whole') / case.least('C', 'whole'):.2f}"
    limits = [f"{case.bytes / case.bandwidth:.2f}", f"{case.flops / case.peak:.2f}"]
    return [*named, *bound, ratio, *limits]


def draw(cases: list[Case], path: Path) -> None:
    """Operations a nanosecond over operations a byte, under what bandwidth and arithmetic allow."""
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


PAGE = """# Performance of the kernels

Time of one right-hand side of {scene} with DSS on one core, in nanoseconds an element node,
beside a program in C that does the same with the same arrays (np known to its compiler,
`{flags}`).
Made by `python benchmarks/kernel_bound.py --write docs/results`: least of {rounds} calls of each
made in turns, and the median of the whole, which tells how busy the machine was. {machine}.

{table}

*local*: the kernel over elements. *DSS*: the sum over what elements share, with the Coriolis
force. *stage of rk4*: a quarter of a step (in C: the sum for the next stage, none for the step).
Launches are recorded, as in steps: one by one from Python each adds about 7 microseconds.
*bytes / copy*: every array moved once at the rate of a copy in the same cache.
*operations / peak*: products and sums at the rate of registers. The larger of the two is a bound:
arithmetic binds, the more so the higher np.

![Roofline](performance.svg)

What the kernels do for it:

- A SIMD register holds one node of 8 elements (float32: 16). Nodes are numbered so that those of
  one place in 16 elements follow one another; where they do, one load takes the place of 8 or 16.
- Work arrays of a group of elements lie on cache lines, stay in the first-level cache and are
  never set to zero.
- Sums along lines and products at a node are taken in whole registers: of the last field of a sum
  the compiler made four pieces, a sixth of the time.
- Nodes inside elements ({inner4:.0f} % of all at np 4, {inner8:.0f} % at np 8) need no DSS: the
  kernel over elements finishes them, unless dynamics and diffusion are taken at once or a term
  other than rotation acts at a point. DSS begins behind them, eight nodes at once.
- What elements finish and what DSS leaves is the next stage of a Runge-Kutta step and not a slope
  to be read again: such a stage takes 1.07 to 1.11 times its right-hand side.
- Loads and stores of DSS leave out what Warp adds for negative indices and strides.

Products and sums are not contracted: a node gets the same bits whichever kernel finishes it, and
so on any number of ranks. Contracted sums along lines took the same time.
"""
LARGE_PAGE = """
## Large meshes

np 4, in nanoseconds of CPU time an element node; made by
`python benchmarks/kernel_bound.py --large --write docs/results`: least of {rounds} calls of each
made in turns. {machine}.

{table}

*over ne 16*: the stage over the one on ne 16. *bytes / copy*: every array of a right-hand side
moved once, at the rate of a copy of as many bytes.

What one launch leaves has left the caches before the next one reads it, if a mesh is large. From
38 400 element nodes on (ne 20 at np 4) a CPU therefore runs launches strip by strip: a strip is a
few hundred elements, whose nodes are summed up and stepped while they are in the cache. Elements
stand in rings around the cube, each of which touches the two rings beside it only. So the stages of
a step follow one another over the rings like waves: the second stage begins as soon as the first
one is two rings ahead. A whole step of rk4, and two steps of `forward-backward` and `leapfrog`,
pass through memory once, with the same bits as one launch after the other. A launch that needs all
of the launch before it ends a wave: a limiter, a sum over the sphere, forcing that changes in time,
messages between ranks (`operators/strips.py`).

The preconditioner of implicit steps runs in such waves as well: from the elimination of the wind to
the restriction to coarse functions, and from their prolongation through all Chebyshev steps to the
next restriction or the substitution.
"""


def main(
    rounds: Annotated[int, typer.Option(min=3, help="Calls of each.")] = 400,
    write: Annotated[Path | None, typer.Option(help="Folder for the page and picture.")] = None,
    large: Annotated[bool, typer.Option("--large", help="Let meshes grow at np 4.")] = False,
) -> None:
    """Measure and print the table."""
    wp.config.log_level = wp.LOG_WARNING
    console, cases = Console(), []
    with TemporaryDirectory() as folder:
        meshes = [(ne, 4) for ne in LARGE] if large else [(e, n) for n, e in ELEMENTS.items()]
        for ne, np_ in meshes:
            for precision in PRECISIONS:
                library = compile_bound(np_, precision, folder)
                cases.append(measure(ne, np_, precision, library, rounds))
    found = large_table(cases) if large else table(cases)
    console.print(found, markup=False, soft_wrap=True)
    console.print(f"{machine()}; {rounds} calls of each in turn")
    if not cases[0].peak:
        console.print("No C compiler (cc or gcc) was found: the bound and the page are left out.")
    elif write is not None and large:
        page, _, _ = (write / "performance.md").read_text().partition("\n## Large meshes")
        page += LARGE_PAGE.format(rounds=rounds, machine=machine(), table=found)
        (write / "performance.md").write_text(page)
    elif write is not None:
        _, heading, others = (write / "performance.md").read_text().partition("\n## Large meshes")
        draw(cases, write / "performance.svg")
        inner4, inner8 = (100 * 6 * (ELEMENTS[n] * (n - 2)) ** 2 / _size(n) for n in (4, 8))
        page = PAGE.format(
            scene=SCENE, flags=" ".join(FLAGS), rounds=rounds, machine=machine(), table=found,
            inner4=inner4, inner8=inner8,
        )  # fmt: skip
        (write / "performance.md").write_text(page + heading + others)


def _size(np_: int) -> int:
    return 6 * (ELEMENTS[np_] * (np_ - 1)) ** 2 + 2


if __name__ == "__main__":
    typer.run(main)
