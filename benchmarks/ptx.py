"""Machine code for GPUs without one: kernels to PTX by Warp's own compiler, and that by ptxas.

`pip install 'spectral-swe-sphere[ptx]'` brings a ptxas that knows the PTX of Warp's compiler.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import warp as wp

from swe_sphere import Simulation
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.kernels import specialise
from swe_sphere.kernels.simd.memory import pack, unpack
from swe_sphere.kernels.vectors import axpby, combine_rows, least, products
from swe_sphere.operators.device_mesh import REALS

VIRTUAL = 80
"""Architecture of the PTX, which newer ones understand."""
REPORT = re.compile(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads")
SHARED = re.compile(r"(\d+) bytes smem")
STEPS = 3


@dataclass(frozen=True)
class MachineCode:
    """What ptxas says of a kernel."""

    registers: int
    """Of each thread."""
    spills: int
    """Bytes that a thread stores because registers run out, and loads again."""
    stack: int
    """Bytes of a thread's own arrays that stand in memory."""
    shared: int
    """Bytes of a block."""


def kernels_of(scene: str, stepper: str, precision: str, **options: Any) -> dict[str, wp.Kernel]:
    """All kernels that this run would launch on a GPU, by the name of their module.

    It runs some steps on the CPU, with the kernels of GPUs.  Those of the solvers' vectors, which
    are others there, are not among them: see `vector_kernels`.
    """
    sim = Simulation(
        scene=scene, stepper=stepper, precision=precision, launch="node", ne=2, days=1.0, **options
    )
    sim.begin()
    with suppress(RunFailed):  # all have been loaded
        for _ in range(STEPS):
            sim.stepper.step()
    return dict(sim.model.launch.kernels)


def vector_kernels() -> dict[str, wp.Kernel]:
    """The vector operations of the solvers."""
    kernels = axpby, combine_rows, products, least, pack, unpack
    made = [specialise(kernel, real) for kernel in kernels for real in REALS.values()]
    return {kernel.module.name: kernel for kernel in made}


def find_ptxas() -> str | None:
    """That of the Python package: others are often older than the PTX."""
    try:
        package = find_spec("nvidia.cu13")
    except ModuleNotFoundError:
        package = None
    places = package.submodule_search_locations or () if package else ()
    return next((str(file) for place in places for file in Path(place).glob("bin/ptxas")), None)


def compile_ptx(kernel: wp.Kernel, folder: Path) -> Path:
    """The kernel as PTX in that folder."""
    wp.compile_aot_module(kernel.module, arch=VIRTUAL, use_ptx=True, module_dir=folder)
    (file,) = folder.glob("*.ptx")
    file.write_bytes(file.read_bytes().rstrip(b"\0"))
    return file


def assemble(ptx: Path, architectures: Iterable[int]) -> dict[int, MachineCode]:
    """Machine code for each architecture, as ptxas makes it; RuntimeError where it does not."""
    ptxas = find_ptxas()
    if ptxas is None:
        raise ConfigError("there is no ptxas: pip install 'spectral-swe-sphere[ptx]'")
    return {each: _assemble(ptxas, ptx, each) for each in architectures}


def _assemble(ptxas: str, ptx: Path, architecture: int) -> MachineCode:
    command = [ptxas, f"-arch=sm_{architecture}", "-v", str(ptx), "-o", "/dev/null"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    registers = re.search(r"Used (\d+) registers", done.stderr)
    reports = REPORT.findall(done.stderr)
    if done.returncode or registers is None or not reports:
        raise RuntimeError(f"ptxas: {done.stderr.strip() or done.returncode}")
    stack, stores, loads = (sum(map(int, column)) for column in zip(*reports, strict=True))
    shared = SHARED.search(done.stderr)
    return MachineCode(int(registers[1]), stores + loads, stack, int(shared[1]) if shared else 0)
