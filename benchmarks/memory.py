"""Peak memory of runs, in bytes per element node.

Each run is a separate process.  The memory of the same run on 24 elements (the interpreter,
libraries, compiled kernels) is subtracted.  There are 6 ne^2 np^2 element nodes.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys

import typer
from sections import Section, command

MESHES = ((60, 4), (30, 8), (120, 4))
STEPPERS = ("rk4", "leapfrog", "semi-implicit", "bdf2", "tr-bdf2", "esdirk4")
DAYS = 0.03
ESTIMATED = {3: 24, 4: 20, 6: 14, 8: 10, 12: 8}
"""Elements along the edge of a cube face for each np in the table of the estimate."""
FAMILIES = {
    "explicit (rk4)": "rk4", "imex (semi-implicit)": "semi-implicit", "exponential (epi3)": "epi3",
    "implicit (tr-bdf2)": "tr-bdf2", "gauss-legendre": "gauss-legendre",
}  # fmt: skip


def peak(*arguments: str) -> int:
    """Return the peak memory [bytes] of `swe-sphere run williamson5` with these arguments."""
    command = [sys.executable, "-m", "swe_sphere", "run", "williamson5", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with status {process.returncode}")
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def per_node(ne: int, np: int, arguments: list[str]) -> float:
    """Return the peak memory of a run beyond that of a tiny run [bytes per element node]."""
    tiny, whole = (peak("--ne", str(n), "--np", str(np), *arguments) for n in (2, ne))
    return (whole - tiny) / (6 * (ne * np) ** 2)


def peaks() -> Section:
    """Peak memory by mesh and stepper."""
    rows = []
    for (ne, np), name in itertools.product(MESHES, STEPPERS):
        measured = per_node(ne, np, ["--stepper", name, "--days", str(DAYS)])
        rows.append([f"ne{ne} np{np}", name, f"{measured:.0f}"])
    return Section(
        "Peak memory of a run of williamson5",
        f"Bytes an element node beyond those of the same run on ne2, each run in a process of its"
        f" own: {DAYS:g} days, float64, automatic step.",
        ["mesh", "stepper", "bytes an element node"],
        rows,
    )


def estimate() -> Section:
    """Peak memory by family of steppers and np, from which `simulation/memory.toml` is made."""
    rows = []
    for family, name in FAMILIES.items():
        options = ["--stepper", name, "--days", "0.02"]
        cells = (f"{per_node(ne, np, options):.0f}" for np, ne in ESTIMATED.items())
        rows.append([family, *cells])
    return Section(
        "Table of the estimate",
        "The table shows bytes an element node beyond those of the same run on ne2, for runs of"
        " 0.02 days on " + ", ".join(f"ne{ne} np{np}" for np, ne in ESTIMATED.items()) + ".",
        ["family", *(f"np {np}" for np in ESTIMATED)],
        rows,
    )  # fmt: skip


main = command("memory", {"peak": peaks, "estimate": estimate})

if __name__ == "__main__":
    typer.run(main)
