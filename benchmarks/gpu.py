"""What GPUs do with a step: measured times where there is one, machine code and bytes elsewhere.

python benchmarks/gpu.py                      all sections
python benchmarks/gpu.py traffic              one of them
python benchmarks/gpu.py steps days agreement these three need a GPU
"""

from __future__ import annotations

import math
import re
import statistics
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any
from unittest.mock import patch

import typer
import warp as wp
from generated import cost
from ptx import MachineCode, assemble, compile_ptx, kernels_of, vector_kernels
from sections import Section, measure

from swe_sphere import Simulation
from swe_sphere.errors import ConfigError
from swe_sphere.mesh import Mesh
from swe_sphere.operators import Launcher
from swe_sphere.operators.device_mesh import REALS
from swe_sphere.planet import DAY
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene, list_scenes

ARCHITECTURES = (80, 90)


@dataclass(frozen=True)
class Device:
    """A GPU as its maker's data sheet has it."""

    name: str
    bandwidth: float
    """Of its memory [B/s]."""
    flops: float
    """float64 operations a second, without tensor cores."""


DEVICES = Device("A100 80 GB SXM", 2.039e12, 9.7e12), Device("H100 SXM", 3.35e12, 34e12)


def main(names: Annotated[list[str] | None, typer.Argument(help="Sections.")] = None) -> None:
    """Measure sections."""
    sections = {"kernels": machine_code, "traffic": traffic}
    measured = {"steps": steps, "days": days, "agreement": agreement}
    if not names and wp.get_cuda_device_count() == 0:
        names = list(sections)
    measure("gpu", measured | sections, names or [])


# --- measured

STEPPED = ("rk4", "forward-backward", "leapfrog", "semi-implicit", "bdf2", "tr-bdf2")
SIZES = {4: (30, 60, 120, 240), 8: (15, 30, 60)}
"""Elements along a face's edge, by np."""
LARGEST = 120
"""Largest ne of `days` for steps with a solver, whose set-up takes minutes on finer meshes."""
LONG = {"bdf2": 3600.0, "tr-bdf2": 14400.0}
"""Steps [s] that the accuracy of williamson5 bears."""
ROUNDS = 5


def steps() -> Section:
    """Explicit steps, in time of an element node."""
    copied = copy_bandwidth()
    rows = []
    for precision in REALS:
        for np, sizes in SIZES.items():
            for stepper in ("rk4", "forward-backward"):
                launches, moved, _ = _counted(precision, np, stepper)
                for ne in sizes:
                    sim = _prepared(stepper, ne, np, precision)
                    nodes = sim.mesh.elements * np**2
                    each = [1e12 * seconds / nodes for seconds in _timed(sim)]
                    share = moved / (1e-12 * min(each)) / copied
                    rows.append([
                        precision, str(np), stepper, str(ne), str(launches),
                        f"{1e-6 * nodes * min(each):.0f}", f"{min(each):.0f}",
                        f"{statistics.median(each):.0f}", f"{share:.2f}",
                    ])  # fmt: skip
                    print(*rows[-1])  # noqa: T201
    note = (
        f"williamson5, steps replayed as one graph, on {_gpu()}; a large copy moved"
        f" {copied / 1e9:.0f} GB/s there, bytes read and written both counted. Times are wall times"
        f" of an element node and step in picoseconds, least and median of {ROUNDS} rounds. Share:"
        " bytes of all arrays that the kernels of a step read or write (see below) over time, as a"
        " share of the copy."
        " Above 1, the cache kept what one launch had written until the next one read it."
    )
    columns = ["precision", "np", "stepper", "ne", "launches", "µs a step", "ps", "median", "share"]
    return Section("Explicit steps, measured", note, columns, rows)


def days() -> Section:
    """Seconds that a simulated day of williamson5 takes with each family."""
    rows = []
    for ne in SIZES[4]:
        found = {}
        for stepper in STEPPED if ne <= LARGEST else STEPPED[:3]:
            sim = _prepared(stepper, ne, 4, "float64")
            found[stepper] = sim.stepper.dt, min(_timed(sim))
            print(ne, stepper, *found[stepper])  # noqa: T201
        day = {stepper: DAY / dt * seconds for stepper, (dt, seconds) in found.items()}
        for stepper, (dt, seconds) in found.items():
            rows.append([str(ne), stepper, f"{dt:.1f}", f"{1e3 * seconds:.3g}",
                         f"{day[stepper]:.3g}", f"{day[stepper] / day['rk4']:.2f}",
                         f"{day[stepper] / min(day.values()):.2f}"])  # fmt: skip
    note = (
        f"williamson5 (20 m/s), np 4, float64, on {_gpu()}, explicit and semi-implicit steppers at"
        " their automatic steps, bdf2 with steps of 1 h and tr-bdf2 of 4 h: least wall time of"
        f" {ROUNDS} rounds of steps that follow the fourth, output and set-up not counted. Implicit"
        f" and semi-implicit steps are taken up to ne {LARGEST}."
    )
    columns = ["ne", "stepper", "Δt [s]", "ms a step", "s a day", "over rk4", "over the cheapest"]
    return Section("A simulated day, measured", note, columns, rows)


def agreement() -> Section:
    """How far final states of a GPU are from those of a CPU."""
    rows = []
    for stepper in STEPPERS:
        each = [_apart(*case, stepper) for case in AGREEING]
        rows.append([stepper, *(f"{apart:.1e}" for apart in each)])
    note = (
        f"Largest difference between the states on {_gpu()} and on a CPU, over the largest number"
        " of the state, in float64 at the automatic step: 6 steps of williamson5 on ne 3 np 4, 4"
        " steps of galewsky with hyperviscosity on ne 2 np 5, and 4 steps of williamson6 with the"
        " edge penalty on ne 2 np 6. Implicit steps end their iterations on a tolerance, others"
        " differ by rounding errors."
    )
    columns = [
        "stepper",
        "williamson5",
        "galewsky with hyperviscosity",
        "williamson6 with the edge penalty",
    ]
    return Section("Agreement with a CPU, measured", note, columns, rows)


AGREEING: tuple[tuple[str, int, int, int, dict[str, object]], ...] = (
    ("williamson5", 3, 4, 6, {}),
    ("galewsky", 2, 5, 4, {"hyperviscosity.nu": "default"}),
    ("williamson6", 2, 6, 4, {"edge-penalty.c": 0.01}),
)
"""Scene, ne, np, steps, effects."""


def _apart(
    scene: str, ne: int, np: int, count: int, effects: dict[str, object], stepper: str
) -> float:
    ends = []
    for device in ("cpu", "cuda:0"):
        sim = Simulation(
            scene, stepper=stepper, ne=ne, np=np, days=1, effects=effects, device=device
        )
        for _ in range(count):
            sim.step()
        ends.append(sim.stepper.state.numpy())
    return float(abs(ends[1] - ends[0]).max() / abs(ends[0]).max())


def _gpu() -> str:
    return str(wp.get_device("cuda:0").name)


def _prepared(stepper: str, ne: int, np: int, precision: str) -> Simulation:
    """Return a run at its first day, past what multistep methods begin with."""
    sim = Simulation(
        scene="williamson5",
        stepper=stepper,
        dt=LONG.get(stepper, "auto"),
        precision=precision,
        device="cuda:0",
        mesh=_mesh(ne, np),
        days=30.0,
    )  # fmt: skip
    sim.begin()
    for _ in range(4):
        sim.stepper.step()
    return sim


@cache
def _mesh(ne: int, np: int) -> Mesh:
    return Mesh.build(ne, np)


def _timed(sim: Simulation) -> list[float]:
    """Return the wall seconds of a step in each round, of about half a second."""
    count, found = 1, []
    while len(found) < ROUNDS:
        wp.synchronize_device("cuda:0")
        begun = time.perf_counter()
        for _ in range(count):
            sim.stepper.step()
        wp.synchronize_device("cuda:0")
        seconds = time.perf_counter() - begun
        if seconds > 0.1 or found or count >= 256:
            found.append(seconds / count)
        else:
            count *= 4
    return found


def copy_bandwidth() -> float:
    """Return the bytes a second of a copy of 2 GB, read and written both counted."""
    source, target = (wp.zeros(1 << 28, dtype=wp.float64, device="cuda:0") for _ in range(2))
    best = math.inf
    for _ in range(10):
        wp.synchronize_device("cuda:0")
        begun = time.perf_counter()
        wp.copy(target, source)
        wp.synchronize_device("cuda:0")
        best = min(best, time.perf_counter() - begun)
    return 2.0 * 8.0 * (1 << 28) / best


# --- machine code


def machine_code() -> Section:
    """Every kernel of every scene and stepper, through ptxas."""
    found = defaultdict(list)
    with TemporaryDirectory() as folder:
        for i, (name, kernel) in enumerate(sorted(all_kernels().items())):
            made = assemble(compile_ptx(kernel, Path(folder, str(i))), ARCHITECTURES)
            found[kind_of(name)].append(made)
    codes = [code for kind in found.values() for made in kind for code in made.values()]
    note = (
        f"All {sum(map(len, found.values()))} kernels that any scene launches with any stepper and"
        " its default preconditioner, in both precisions, compiled to PTX by the compiler that"
        " comes with Warp and assembled by ptxas for the architectures sm_80 (A100) and sm_90"
        " (H100): fewest and most registers of a thread, largest stack and shared memory of a block"
        " (Warp takes 1024 bytes of it)."
        f" Spilled: {sum(code.spills for code in codes)} bytes in all."
    )
    columns = ["kernel", "variants", *(f"registers, sm_{each}" for each in ARCHITECTURES)]
    columns += ["spilled, B", "stack, B", "shared, B"]
    return Section("Registers", note, columns, [_row(*each) for each in sorted(found.items())])


def all_kernels() -> dict[str, wp.Kernel]:
    """By the name of their module; one scene stands for all with the same effects."""
    found = vector_kernels()
    for scene in representatives():
        for stepper in STEPPERS:
            for precision in REALS:
                try:
                    found |= kernels_of(scene, stepper, precision)
                except ConfigError as error:  # what the pair cannot do
                    print(f"{scene} with {stepper}: {error}")  # noqa: T201
    return found


def representatives() -> list[str]:
    """A scene for each set of effects."""
    scenes = [get_scene(name) for name in list_scenes()]
    return list({tuple(e.name for e in scene.effects): scene.name for scene in scenes}.values())


def kind_of(module: str) -> str:
    """The name of a kernel, without that of the function around it."""
    return re.sub(r"_[0-9a-f]{8}$", "", module).rpartition("__locals__")[2]


def _row(kind: str, variants: list[dict[int, MachineCode]]) -> list[str]:
    registers = [[made[each].registers for made in variants] for each in ARCHITECTURES]
    codes = [code for made in variants for code in made.values()]
    most = [max(getattr(code, name) for code in codes) for name in ("spills", "stack", "shared")]
    return [kind, str(len(variants)), *map(_range, registers), *map(str, most)]


def _range(numbers: Iterable[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low}–{high}"


# --- bytes moved


def traffic() -> Section:
    """What a step moves, and how long that takes at the bandwidth of the memory."""
    rows = [
        [precision, str(np), stepper, *_prediction(precision, np, stepper)]
        for precision in REALS
        for np in (4, 8)
        for stepper in ("rk4", "forward-backward")
    ]
    memory = ", ".join(f"{each.name}: {each.bandwidth / 1e9:.0f} GB/s" for each in DEVICES)
    peak = ", ".join(f"{each.flops / 1e12:g}" for each in DEVICES)
    note = (
        "**A prediction, not a measurement.** williamson5, an element node and a step. Bytes: of"
        " all arrays that the kernels of a step read or write, each counted once a launch, as if"
        " the caches kept what neighbours share: a lower bound of the time. Operations: in"
        " the code that Warp generates, line sums included. Time: bytes over"
        f" the bandwidth in the makers' data sheets ({memory}); or, marked *, operations over the"
        f" peak ({peak} TFLOP/s in float64, twice that in float32), where that is longer. Start-up"
        " and end of each launch are not included: meshes must be large (ne 120"
        " and more). What the cache keeps from one launch to the next makes it faster."
    )
    columns = ["precision", "np", "stepper", "launches", "bytes", "operations"]
    columns += [f"{device.name}, ps" for device in DEVICES]
    return Section("Bytes moved, and the time that follows", note, columns, rows)


def _counted(precision: str, np: int, stepper: str) -> tuple[int, float, float]:
    """Return the launches of a step, and its bytes and operations an element node."""
    sim = Simulation(
        scene="williamson5",
        stepper=stepper,
        precision=precision,
        launch="node",
        ne=8,
        np=np,
        days=1.0,
    )  # fmt: skip
    sim.begin()
    sim.model.launch.records = False
    for _ in range(3):  # multistep methods begin with others
        sim.stepper.step()
    launches: list[tuple[wp.Kernel, Any, tuple[Any, ...]]] = []
    plain = Launcher.__call__

    def seen(self: Launcher, kernel: wp.Kernel, dim: Any, *arguments: Any, **cuts: Any) -> None:
        launches.append((kernel, dim, arguments))
        plain(self, kernel, dim, *arguments, **cuts)

    with patch.object(Launcher, "__call__", seen):
        sim.stepper.step()
    mesh = sim.mesh
    nodes = mesh.elements * np**2
    moved = sum(_bytes(arguments) for _, _, arguments in launches) / nodes
    contributors = nodes / mesh.size
    flops = (
        sum(cost(kernel, contributors).flops * _threads(dim) for kernel, dim, _ in launches) / nodes
    )
    return len(launches), moved, flops


def _prediction(precision: str, np: int, stepper: str) -> Iterator[str]:
    launches, moved, flops = _counted(precision, np, stepper)
    yield from (str(launches), f"{moved:.0f}", f"{flops:.0f}")
    for device in DEVICES:
        peak = device.flops * (2.0 if precision == "float32" else 1.0)
        by_memory, by_arithmetic = moved / device.bandwidth, flops / peak
        mark = "*" if by_arithmetic > by_memory else ""
        yield f"{1e12 * max(by_memory, by_arithmetic):.0f}{mark}"


def _threads(dim: int | tuple[int, ...]) -> int:
    return dim if isinstance(dim, int) else math.prod(dim)


def _bytes(arguments: Iterable[Any]) -> int:
    """Of the arrays among the arguments and in structures of them, each once."""
    arrays = {array.ptr: array for argument in arguments for array in _arrays(argument)}
    return sum(each.size * wp.types.type_size_in_bytes(each.dtype) for each in arrays.values())


def _arrays(argument: Any) -> Iterator[wp.array]:
    if isinstance(argument, wp.array):
        yield argument
    elif hasattr(argument, "_cls"):  # a structure
        members = (getattr(argument, name) for name in argument._cls.vars)
        yield from (each for each in members if isinstance(each, wp.array) and each.size)


if __name__ == "__main__":
    typer.run(main)
