"""Processes that share a run: started by `swe-sphere run --ranks P`, or by mpiexec."""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from subprocess import DEVNULL, PIPE
from threading import Thread
from typing import TextIO

from swe_sphere.errors import ConfigError
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.ranks.communicator import OF_RANKS, world
from swe_sphere.ranks.limits import available_memory

NOISE = (
    "===", "=   ", "YOUR APPLICATION TERMINATED", "This typically refers", "Please see the FAQ",
    "Abort(", "application called MPI_Abort", "MPICH:", "[mpiexec@",
)  # fmt: skip
"""How lines of mpiexec about a process that died begin; ours says it in one."""
PR_SET_PDEATHSIG = 1
"""Of Linux: see prctl(2)."""
PROCESS = 100 * 2**20
"""Memory [bytes] that a rank shares with no other, with the smallest mesh."""


def start_ranks(ranks: int, ne: int, arguments: Sequence[str]) -> int:
    """Run the same command line in that many processes; returns the exit status of all.

    Raises ConfigError where there is no MPI to start them, or no memory for so many, or a mesh of
    that ne has too few elements.
    """
    if ranks < 1:
        raise ConfigError(f"ranks={ranks}: give a number of processes, at least 1")
    check_ranks(ne, ranks)
    there = available_memory()
    if there is not None and ranks * PROCESS > there:
        most = max(int(there / PROCESS), 1)
        raise ConfigError(f"ranks={ranks}: there is memory for about {most} processes: take fewer")
    beside = Path(sys.executable).with_name("mpiexec")
    starter = str(beside) if beside.exists() else shutil.which("mpiexec")
    if starter is None or find_spec("mpi4py") is None:
        missing = "mpi4py" if starter else "mpiexec"
        raise ConfigError(f"ranks: there is no {missing}: pip install 'swe-sphere[mpi]'")
    command = [starter, "-n", str(ranks), sys.executable, "-m", "swe_sphere", *arguments]
    with subprocess.Popen(
        command, stdin=DEVNULL, stdout=PIPE, stderr=PIPE, text=True, preexec_fn=_end_with_parent,
        process_group=0,
    ) as job:  # fmt: skip
        # in a group of its own a Ctrl-C reaches it once, from here, like what others send
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda sent, _: job.send_signal(sent))
        assert job.stdout is not None and job.stderr is not None
        results = Thread(target=_pass_on, args=(job.stdout, sys.stdout))
        results.start()
        told = _pass_on(job.stderr, sys.stderr)
        results.join()
    if job.returncode and not told:
        sys.stderr.write("swe-sphere: a rank has died; all frames written so far can be read\n")
    return min(abs(int(job.returncode)), 255)


def _end_with_parent() -> None:
    """Have the system kill this process when its parent dies, where it does that (Linux).

    mpiexec does not notice, and its ranks would go on; they do notice the end of mpiexec.
    """
    with suppress(AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def _pass_on(lines: Iterable[str], to: TextIO) -> bool:
    """Print them, but for the noise of mpiexec; whether one of them says why the program fails."""
    told = False
    for line in lines:
        if line.strip() and not line.startswith(NOISE):
            to.write(line)
            to.flush()
        told = told or (line.startswith("swe-sphere: ") and "warning:" not in line)
    return told


def fail(line: str, status: int) -> int:
    """Say in one line why the program fails, if all ranks do, on one of them."""
    try:
        comm = world()
        comm.agree_to_fail(line)
        first = comm.rank == 0
    except ConfigError:  # which is what the line says: nobody knows the others
        first = all(os.environ.get(name, "0") == "0" for name in OF_RANKS)
    if first:
        sys.stderr.write(f"swe-sphere: {line}\n")
    return status
