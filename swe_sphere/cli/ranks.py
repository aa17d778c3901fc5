"""Processes that share a run: started by `swe-sphere run --ranks P`, or by mpiexec."""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from swe_sphere.errors import ConfigError
from swe_sphere.parallel import world

BANNER = ("===", "=   ")
"""How lines of mpiexec about a process that died begin; ours says it in one."""


def start_ranks(ranks: int, arguments: Sequence[str]) -> int:
    """Run the same command line in that many processes; returns the exit status of all.

    Raises ConfigError where there is no MPI to start them.
    """
    if ranks < 1:
        raise ConfigError(f"ranks={ranks}: give a number of processes, at least 1")
    beside = Path(sys.executable).with_name("mpiexec")
    starter = str(beside) if beside.exists() else shutil.which("mpiexec")
    if starter is None or find_spec("mpi4py") is None:
        missing = "mpi4py" if starter else "mpiexec"
        raise ConfigError(f"ranks: there is no {missing}: pip install 'swe-sphere[mpi]'")
    command = [starter, "-n", str(ranks), sys.executable, "-m", "swe_sphere", *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as job:
        assert job.stderr is not None
        told = [_pass_on(line) for line in job.stderr]
    if job.returncode and not any(told):
        sys.stderr.write("swe-sphere: a rank has died; all frames written so far can be read\n")
    return min(abs(int(job.returncode)), 255)


def _pass_on(line: str) -> bool:
    """Print a line of stderr, but for the noise of mpiexec; whether it is one of ours."""
    if not line.startswith(BANNER):
        sys.stderr.write(line)
    return line.startswith("swe-sphere: ") and "warning:" not in line


def fail(line: str, status: int) -> int:
    """Say in one line why the program fails, if all ranks do, on one of them."""
    comm = world()
    comm.agree_to_fail(line)
    if comm.rank == 0:
        sys.stderr.write(f"swe-sphere: {line}\n")
    return status


def refuse_ranks() -> None:
    """ConfigError where several ranks were started for a command that they cannot share."""
    if world().size > 1:
        raise ConfigError("only `swe-sphere run` is for several ranks: start this command alone")
