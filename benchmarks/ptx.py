"""Machine code for GPUs without a GPU: Warp compiles kernels to PTX, and ptxas assembles the PTX.

`pip install 'spectral-swe-sphere[ptx]'` installs a ptxas that accepts the PTX of Warp.
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
from unittest.mock import patch

import warp as wp

from swe_sphere import Simulation
from swe_sphere.errors import ConfigError, RunFailed
from swe_sphere.kernels import specialise
from swe_sphere.kernels.simd.memory import pack, unpack
from swe_sphere.kernels.vectors import axpby, combine_rows, least, products
from swe_sphere.operators.device_mesh import REALS
from swe_sphere.operators.launch import Launcher

VIRTUAL = 80
"""Architecture of the PTX, which newer GPUs also accept."""
REPORT = re.compile(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads")
SHARED = re.compile(r"(\d+) bytes smem")
STEPS = 3
CPU_ONLY = {"swe_sphere.kernels.simd.strips", "swe_sphere.kernels.simd.sums"}
"""Modules of the kernels in C++ for sums and for strips, which no GPU runs."""


@dataclass(frozen=True)
class MachineCode:
    """Resources of a kernel as ptxas reports them."""

    registers: int
    """Number of registers per thread."""
    spills: int
    """Bytes that a thread stores because registers run out, and loads again."""
    stack: int
    """Bytes of the local arrays of a thread that are in memory."""
    shared: int
    """Bytes of shared memory per block."""


def kernels_of(scene: str, stepper: str, precision: str, **options: Any) -> dict[str, wp.Kernel]:
    """Return all kernels that this run would launch on a GPU, by the name of their module.

    The function runs some steps on the CPU with the kernels for GPUs.  The kernels of vector
    operations, which differ on GPUs, are not included: see `vector_kernels`.
    """
    found: dict[str, wp.Kernel] = {}
    load = Launcher.load

    def keep(launcher: Launcher, *kernels: wp.Kernel) -> None:
        on_gpu = (k for k in kernels if k.func.__module__ not in CPU_ONLY)
        found.update({kernel.module.name: kernel for kernel in on_gpu})
        load(launcher, *kernels)

    with patch.object(Launcher, "load", keep):
        sim = Simulation(
            scene, stepper=stepper, precision=precision, launch="node", ne=2, days=1.0, **options
        )
        sim.begin()
        with suppress(RunFailed):  # all have been loaded
            for _ in range(STEPS):
                sim.stepper.step()
    return found


def vector_kernels() -> dict[str, wp.Kernel]:
    """Return the kernels of the vector operations of the solvers, by the name of their module."""
    kernels = axpby, combine_rows, products, least, pack, unpack
    made = [specialise(kernel, real) for kernel in kernels for real in REALS.values()]
    return {kernel.module.name: kernel for kernel in made}


def find_ptxas() -> str | None:
    """Return the path of ptxas of the Python package; others are often too old for the PTX."""
    try:
        package = find_spec("nvidia.cu13")
    except ModuleNotFoundError:
        package = None
    places = package.submodule_search_locations or () if package else ()
    return next((str(file) for place in places for file in Path(place).glob("bin/ptxas")), None)


def compile_ptx(kernel: wp.Kernel, folder: Path) -> Path:
    """Compile a kernel to PTX in a folder; return the file."""
    wp.compile_aot_module(kernel.module, arch=VIRTUAL, use_ptx=True, module_dir=folder)
    (file,) = folder.glob("*.ptx")
    file.write_bytes(file.read_bytes().rstrip(b"\0"))
    return file


def assemble(ptx: Path, architectures: Iterable[int]) -> dict[int, MachineCode]:
    """Return the machine code by architecture; RuntimeError if ptxas fails."""
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
