"""The program `swe-sphere`: its commands and its exit status."""

import os
import sys
import time
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated

import typer
from typer import TyperException

from swe_sphere import __version__
from swe_sphere.cli.show import DEBUG, explain, open_streams
from swe_sphere.compiling import COMPILING, on_compile
from swe_sphere.errors import ConfigError, Interrupted, RunFailed
from swe_sphere.logs import LOGGER, print_lines
from swe_sphere.ranks.communicator import RANK_VARIABLES, refuse_ranks, world
from swe_sphere.ranks.limits import command_began, process_age

COMMANDS = {
    "list": "files:list_all", "run": "run:run", "sweep": "sweep:sweep",
    "advise": "sweep:advise", "plot": "files:plot", "animate": "files:animate",
    "compare": "files:compare", "regrid": "files:regrid",
    "verify": "studies:verify", "stress": "studies:stress", "ensemble": "studies:ensemble",
}  # fmt: skip
"""Module of this package and function in it, for each command."""


def program(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """Return the program with those commands: loading each command takes time."""
    app = typer.Typer(
        help="Shallow water on the cubed sphere: run test cases and compare time integrators.",
        no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    )  # fmt: skip
    app.callback()(_program)
    for name in names:
        module, _, function = COMMANDS[name].partition(":")
        app.command(name)(getattr(import_module(f"swe_sphere.cli.{module}"), function))
    return app


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"swe-sphere {__version__}")
        raise typer.Exit


def _program(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    if context.invoked_subcommand != "run":
        refuse_ranks()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and leave with its exit status.

    0: done, 2: the request cannot be carried out as written, 1: the run failed, 130: interrupted.
    """
    token = command_began.set(time.monotonic() - (process_age() if arguments is None else 0.0))
    if arguments is None:
        arguments = sys.argv[1:]
        os.environ["MPLBACKEND"] = "agg"  # pictures are files
    open_streams()
    try:
        with print_lines(), on_compile(lambda: LOGGER.info(COMPILING)):
            status = _status(arguments)
    finally:
        command_began.reset(token)
    sys.exit(status)


def _status(arguments: Sequence[str]) -> int:
    """Run the command line and return the exit status; print why it fails."""
    try:
        app = program([name for name in arguments[:1] if name in COMMANDS] or COMMANDS)
        status = app(arguments, prog_name="swe-sphere", standalone_mode=False, obj=arguments) or 0
        if status == Interrupted.exit_status and arguments[0] != "run":  # typer caught Ctrl-C
            raise Interrupted("interrupted by Ctrl-C")
        return status
    except Exception as error:
        if os.environ.get(DEBUG):
            traceback.print_exc()
        line, status = explain(error)
        if "--json" in arguments and (arguments[0] != "run" or isinstance(error, TyperException)):
            from swe_sphere.simulation.summary import failed_summary  # slow to import

            with suppress(RunFailed):  # the line below states the failure
                typer.echo(failed_summary({}, line, status).as_json())  # `run` prints its own
        if line:
            _show_failure(line)
        return status


def _show_failure(line: str) -> None:
    """Print in one line why the program fails; if all ranks fail, on one of them."""
    try:
        comm = world()
        comm.agree_to_fail(line)
        first = comm.rank == 0
    except ConfigError:  # the line states that the other ranks are unknown
        first = all(os.environ.get(name, "0") == "0" for name in RANK_VARIABLES)
    if first:
        LOGGER.error(line)
