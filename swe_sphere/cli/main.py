"""The program `swe-sphere`: its commands and its exit status."""

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from swe_sphere import __version__
from swe_sphere.cli.advise import advise
from swe_sphere.cli.explain import explain, show_traceback
from swe_sphere.cli.look import compare, list_all
from swe_sphere.cli.pictures import animate, plot
from swe_sphere.cli.ranks import fail, refuse_ranks
from swe_sphere.cli.regrid import regrid, scrip
from swe_sphere.cli.run import run
from swe_sphere.cli.show import tell_of_compiling
from swe_sphere.cli.stress import stress
from swe_sphere.cli.sweep import sweep
from swe_sphere.cli.verify import verify
from swe_sphere.compiling import on_compile

app = typer.Typer(
    help="Shallow water on the cubed sphere: run test cases and compare time integrators.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("list")(list_all)
app.command("run")(run)
app.command("sweep")(sweep)
app.command("advise")(advise)
app.command("plot")(plot)
app.command("animate")(animate)
app.command("compare")(compare)
app.command("regrid")(regrid)
app.command("scrip")(scrip)
app.command("verify")(verify)
app.command("stress")(stress)


def _tell_version(asked: bool) -> None:
    if asked:
        typer.echo(f"swe-sphere {__version__}")
        raise typer.Exit


@app.callback()
def _program(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_tell_version, is_eager=True, help="Tell the version."),
    ] = False,
) -> None:
    if context.invoked_subcommand != "run":
        refuse_ranks()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and leave with its exit status.

    0: done, 2: the request cannot be carried out as written, 1: the run failed, 130: interrupted.
    """
    sys.exit(_status(sys.argv[1:] if arguments is None else arguments))


def _status(arguments: Sequence[str]) -> int:
    try:
        with on_compile(tell_of_compiling):
            return app(arguments, prog_name="swe-sphere", standalone_mode=False, obj=arguments) or 0
    except Exception as error:
        show_traceback()
        line, status = explain(error)
    return fail(line, status)
