"""What can be said of GPUs without one: machine code, bytes moved, and the time that follows.

python benchmarks/gpu.py                      all sections
python benchmarks/gpu.py traffic              one of them, into docs/gpu.md and docs/gpu.json
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any
from unittest.mock import patch

import typer
import warp as wp
from generated import cost
from implicit_common import Section
from ptx import MachineCode, assemble, compile_ptx, kernels_of, vector_kernels
from sections import write_page

from swe_sphere import Simulation
from swe_sphere.errors import ConfigError
from swe_sphere.operators import Launcher
from swe_sphere.operators.device_mesh import REALS
from swe_sphere.steppers import STEPPERS
from swe_sphere.testcases import get_scene, list_scenes

HEAD = """# GPUs

Nothing here was run on a GPU: this page holds what the compiler says of the kernels, and a
prediction.  `--device cuda:0` runs the kernels of one thread a node (`--launch node`, which a CPU
runs too: `swe-sphere verify --launch node` puts them through the whole verification suite).
A block has whole elements, whose threads put what right-hand sides and derivatives take line sums
of into shared memory: each value is loaded and worked out once.  The preconditioner's line sums, of
values that stand ready, load them from the cache.
Explicit steps of scenes whose wind and forcing do not change in time are captured once as a graph
and then launched as a whole; on several ranks in pieces, between messages, and with a limiter of
tracers there kernel by kernel.  No step copies a state to the host, nor does the check whether a
solution still makes sense.  Three things do: the set-up of a preconditioner reads the depth (and
`jacobian-direct`, whose factors are on the host, looks at the flow in every step); a difference in
the place of the derivative, of an effect that has none, measures the state on the host; and winds
and forcings that change in time are evaluated by numpy and sent.  Tracer steps that are longer
than those of the flow bring one number to the host in each, the strongest wind.
[Several processes](parallel.md) share a run on GPUs as on CPUs.
Made by `python benchmarks/gpu.py`."""

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
    """Make the page anew."""
    write_page("gpu", HEAD, {"kernels": machine_code, "traffic": traffic}, names or [])


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
        " all arrays that the launches of a step name, each counted once a launch, as if the caches"
        " kept what neighbours share: a lower bound of the time. Operations: in"
        " the code that Warp generates, line sums included. Time: bytes over"
        f" the bandwidth in the makers' data sheets ({memory}); or, marked *, operations over the"
        f" peak ({peak} TFLOP/s in float64, twice that in float32), where that is longer. The start"
        " and the tail of each launch are not in it: meshes must be large (ne 120"
        " and more). What the cache keeps from one launch to the next makes it faster."
    )
    columns = ["precision", "np", "stepper", "launches", "bytes", "operations"]
    columns += [f"{device.name}, ps" for device in DEVICES]
    return Section("Bytes moved, and the time that follows", note, columns, rows)


def _prediction(precision: str, np: int, stepper: str) -> Iterator[str]:
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
    yield from (str(len(launches)), f"{moved:.0f}", f"{flops:.0f}")
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
