"""Peak memory of runs, in bytes an element node.

    python benchmarks/memory.py [--meshes 60x4,30x8,120x4] [--steppers rk4,...] [--days D] [--file]

Each run is a process of its own; what the same run on six by four elements takes (the interpreter,
libraries, compiled kernels) is subtracted.  There are 6 ne^2 np^2 element nodes.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

STEPPERS = "rk4,leapfrog,semi-implicit,bdf2,tr-bdf2,esdirk4"


def peak(*arguments: str) -> int:
    """Most memory [bytes] that `swe-sphere run williamson5` of those arguments held resident."""
    command = [sys.executable, "-m", "swe_sphere", "run", "williamson5", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with status {process.returncode}")
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def per_node(ne: int, np: int, arguments: list[str]) -> float:
    """Peak memory of a run beyond that of a tiny one, over the element nodes [bytes]."""
    tiny, whole = (peak("--ne", str(n), "--np", str(np), *arguments) for n in (2, ne))
    return (whole - tiny) / (6 * (ne * np) ** 2)


def main(
    meshes: Annotated[str, typer.Option(help="NExNP, NExNP, ...")] = "60x4,30x8,120x4",
    steppers: Annotated[str, typer.Option(help="Names of steppers.")] = STEPPERS,
    days: Annotated[float, typer.Option(help="Length of the runs.")] = 0.03,
    file: Annotated[bool, typer.Option(help="Write a file too.")] = False,
) -> None:
    """Print a table."""
    console = Console()
    console.print("| mesh | stepper | bytes an element node |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        out = ["--out", str(Path(folder) / "run.nc")] if file else []
        for mesh, name in itertools.product(meshes.split(","), steppers.split(",")):
            ne, np = map(int, mesh.split("x"))
            measured = per_node(ne, np, ["--stepper", name, "--days", str(days), *out])
            console.print(f"| ne{ne} np{np} | {name} | {measured:.0f} |")


if __name__ == "__main__":
    typer.run(main)
