"""Peak memory of each rank of a run with a file, and the time to its first step.

python benchmarks/rank_memory.py      prints the table of docs/howto/parallel.md
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

RUNS = ((30, "rk4", 0.2), (30, "semi-implicit", 0.2), (120, "rk4", 0.01))
"""Mesh, stepper and length [days] of runs of williamson5."""
RANKS = (1, 2, 4)
MPIEXEC = Path(sys.executable).with_name("mpiexec")


def run(ne: int, stepper: str, days: float) -> None:
    """Run as one rank; rank 0 prints time to the first step [s] and peaks of all ranks [MB]."""
    begin = time.perf_counter()
    from swe_sphere import Simulation

    sim = Simulation("williamson5", ne=ne, np=4, stepper=stepper, days=days)
    sim.step()
    seconds = time.perf_counter() - begin
    with TemporaryDirectory() as folder:
        sim.run(out=Path(sim.comm.allgather(folder)[0]) / "run.nc", progress=False)
    status = Path("/proc/self/status").read_text()
    peaks = sim.comm.allgather(int(re.findall(r"VmHWM:\s+(\d+)", status)[0]) / 1024)
    if sim.comm.rank == 0:
        sys.stdout.write(json.dumps([seconds, peaks]) + "\n")


def main() -> None:
    """Print a row for each run on each number of ranks."""
    sys.stdout.write("| mesh | stepper | ranks | peak of each [MB] | first step after [s] |\n")
    sys.stdout.write("|---|---|---|---|---|\n")
    for ne, stepper, days in RUNS:
        for ranks in RANKS:
            command = [sys.executable, __file__, str(ne), stepper, str(days)]
            command = [str(MPIEXEC), "-n", str(ranks), *command] if ranks > 1 else command
            told = subprocess.check_output(command, text=True)
            seconds, peaks = json.loads(told.splitlines()[-1])
            of_each = f"{min(peaks):.0f} to {max(peaks):.0f}" if ranks > 1 else f"{peaks[0]:.0f}"
            row = f"| ne{ne} np4 | {stepper} | {ranks} | {of_each} | {seconds:.1f} |\n"
            sys.stdout.write(row)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        run(int(sys.argv[1]), sys.argv[2], float(sys.argv[3]))
    else:
        main()
