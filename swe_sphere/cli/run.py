"""`swe-sphere run`: a run from flags and a file, in this process or in ranks, and its result."""

import ctypes
import logging
import os
import re
import shlex
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
from typing import Any

import typer

from swe_sphere.cli.options import given, option, with_flags
from swe_sphere.cli.show import explain
from swe_sphere.errors import ConfigError, Interrupted, in_one_line
from swe_sphere.files.user_file import is_user_file
from swe_sphere.logs import LOGGER, append_lines, print_lines
from swe_sphere.mesh.partition import check_ranks
from swe_sphere.ranks.communicator import PRINT_RANK, RANK_PREFIX, world
from swe_sphere.ranks.limits import available_memory
from swe_sphere.settings.values import by_field, convert, override, read_toml
from swe_sphere.simulation.build import make_scene
from swe_sphere.simulation.config import RunConfig, make_config
from swe_sphere.simulation.observers import LogLines, Observer, ProgressBar
from swe_sphere.simulation.restart import check_paths, read_restart
from swe_sphere.simulation.simulation import run_scene
from swe_sphere.simulation.summary import Summary, failed_summary

NOISE = (
    "===", "=   ", "YOUR APPLICATION TERMINATED", "This typically refers", "Please see the FAQ",
    "Abort(", "application called MPI_Abort", "MPICH:", "[mpiexec@",
)  # fmt: skip
"""Prefixes of mpiexec's lines about a process that died; this program prints one line instead."""
ENDING = {
    signal.SIGINT: signal.SIGINT, signal.SIGTERM: signal.SIGTERM, signal.SIGHUP: signal.SIGTERM,
    signal.SIGUSR1: signal.SIGTERM,
}  # fmt: skip
"""Signals that end a run, and those that mpiexec gets instead, for its ranks."""
PROCESS = 100 * 2**20
"""Memory [bytes] of a rank that others do not share, with the smallest mesh."""


@with_flags(RunConfig, argument="scene", without=("outputs",))
def run(
    context: typer.Context,
    config: Path | None = option("FILE.toml", "Options by name; flags override them."),
    ranks: int | None = option("P", "Processes that share the mesh, by MPI."),
    **values: Any,
) -> int:
    """Run a scene and report errors, conservation and cost."""
    comm, said = world(), given(values, RunConfig)
    try:
        said = said if config is None else override(by_field(read_toml(config)), said)
        in_file = said.pop("ranks", None)
        ranks = convert("ranks", int | None, in_file if ranks is None else ranks)
        asked = make_config(said)
        if ranks is not None and not comm.shared:
            before = read_restart(asked)
            mesh = asked if before is None else before.adopt(asked)
            return start_ranks(ranks, mesh.ne or make_scene(mesh).ne, context.obj)
        if ranks not in (None, comm.size):
            raise ConfigError(f"ranks={ranks}: {comm.size} are running already: leave ranks out")
        comm.on_root(lambda: check_paths(asked, [] if config is None else [config]))
        level = logging.ERROR if asked.quiet or comm.rank else logging.INFO
        with print_lines(level), append_lines(None if comm.rank else asked.log):
            summary = _run(asked)
    except Exception as error:
        if said.get("as_json") and comm.rank == 0:
            typer.echo(failed_summary(said, *explain(error)).as_json())
        raise
    if comm.rank == 0:
        _show_summary(summary, asked)
    return summary.exit_status


def _run(config: RunConfig) -> Summary:
    """Run the scene with progress on stderr; print there why it stopped early."""
    is_plain = not (config.quiet or config.as_json or config.live)
    has_bar = is_plain and sys.stderr.isatty()
    level = logging.INFO if is_plain and not has_bar else logging.DEBUG
    progress: list[Observer] = [LogLines(level), *([ProgressBar()] if has_bar else [])]
    try:
        summary = run_scene(config, [] if world().rank else progress, LOGGER.warning)
    except KeyboardInterrupt:
        raise Interrupted("interrupted by Ctrl-C") from None
    if world().rank == 0:
        _report_end(summary, config)
    return summary


def _report_end(summary: Summary, config: RunConfig) -> None:
    """Print on stderr why a run stopped early, and the command that resumes it."""
    if summary.reason is not None:
        named = not (config.out and config.out.exists()) or str(config.out) in summary.reason
        kept = "" if named else f"; {config.out} keeps all that was written"
        LOGGER.error("%s%s", in_one_line(summary.reason), kept)
    if config.out and summary.status in ("interrupted", "timed-out"):
        words = ["swe-sphere", "run", config.scene, "--restart", str(config.out)]
        words += ["--out", str(config.out), "--days", f"{summary['days_planned']:.12g}"]
        methods = (config.stepper, config.chosen_preconditioner or "")
        code = {*map(str, config.trust), *filter(is_user_file, methods)}
        words += [word for file in sorted(code) for word in ("--trust", file)]
        words += ["--log", str(config.log)] if config.log else []
        words += ["--reference", str(config.reference)] if config.reference else []
        words += [word for file in config.diagnostics for word in ("--diagnostics", str(file))]
        level = logging.DEBUG if config.as_json else logging.INFO
        LOGGER.log(level, "resume with: %s", shlex.join(words))


def _show_summary(summary: Summary, config: RunConfig) -> None:
    """Print the result as a table or a line of JSON."""
    if config.as_json:
        sys.stdout.write(summary.as_json() + "\n")
    elif not config.quiet:
        from rich.console import Console
        from rich.table import Table

        outputs = ", ".join(os.path.relpath(path) for path in summary.get("outputs") or ()) or None
        frames = config.out if config.out and config.out.exists() else None
        files = {"frames": frames, "further files": outputs, "picture": config.plot}
        table = Table(show_header=False, title=summary.title)
        for line in (*summary.rows(), *files.items()):
            if line[1] is not None:
                table.add_row(*map(str, line))
        Console(markup=False, highlight=False).print(table)


def start_ranks(ranks: int, ne: int, arguments: Sequence[str]) -> int:
    """Run the command line `arguments` in processes of mpiexec; return their exit status.

    Raises ConfigError if MPI or memory for so many processes is missing, or elements are too few.
    """
    if ranks < 1:
        raise ConfigError(f"ranks={ranks}: give a number of processes, at least 1")
    check_ranks(ne, ranks)
    if (there := available_memory()) is not None and ranks * PROCESS > there:
        most = max(int(there / PROCESS), 1)
        raise ConfigError(f"ranks={ranks}: there is memory for about {most} processes: take fewer")
    beside = Path(sys.executable).with_name("mpiexec")
    starter = str(beside) if beside.exists() else shutil.which("mpiexec")
    if starter is None or find_spec("mpi4py") is None:
        missing = "mpi4py" if starter else "mpiexec"
        raise ConfigError(f"ranks: there is no {missing}: pip install 'spectral-swe-sphere[mpi]'")
    command = [starter, "-n", str(ranks), sys.executable, "-m", "swe_sphere", *arguments]
    with subprocess.Popen(
        command, stdin=DEVNULL, stdout=PIPE, stderr=PIPE, text=True, preexec_fn=_end_with_parent,
        process_group=0, env={**os.environ, PRINT_RANK: "1"},
    ) as job:  # fmt: skip
        # in a separate group, mpiexec receives Ctrl-C once, from here, like other signals
        for number in ENDING:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                signal.signal(number, lambda sent, _: job.send_signal(ENDING[signal.Signals(sent)]))
        assert job.stdout is not None and job.stderr is not None
        printed: list[str] = []
        results = Thread(target=printed.extend, args=(job.stdout,))
        results.start()
        explained, processes = _pass_on(job.stderr)
        results.join()
    sys.stdout.writelines(x for x in printed if x.strip() and not x.startswith(NOISE))
    was_killed = any("EXIT STRING" in line for line in printed)  # mpiexec names the signal
    if job.returncode and (was_killed or not explained):
        dead = re.findall(r"PID (\d+) RUNNING AT", "".join(printed))
        known = [f"rank {processes[pid]} of {ranks}" for pid in dead if pid in processes]
        rank = known[0] if len(known) == 1 else "a rank"
        sys.stderr.write(f"swe-sphere: {rank} was killed; all frames written so far can be read\n")
    return min(abs(int(job.returncode)), 255)


def _end_with_parent() -> None:
    """Make the system kill this process when its parent dies, if it supports that (Linux).

    mpiexec would outlive its parent, and the ranks with it; ranks do notice the end of mpiexec.
    """
    with suppress(AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _pass_on(lines: Iterable[str]) -> tuple[bool, dict[str, str]]:
    """Print the lines of ranks on stderr, without the noise of mpiexec.

    Returns whether one of them states why the program fails, and numbers of ranks by process.
    """
    explained, ranks = False, dict[str, str]()
    for line in lines:
        if line.startswith(RANK_PREFIX):
            rank, process = line.removeprefix(RANK_PREFIX).split()
            ranks[process] = rank
            continue
        if line.strip() and not line.startswith(NOISE):
            sys.stderr.write(line)
        explained = explained or (line.startswith("swe-sphere: ") and "warning:" not in line)
    return explained, ranks
