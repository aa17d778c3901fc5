"""`swe-sphere run`: flags and configuration file to a run, and its result to the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from swe_sphere.cli.errors import Stopped, explain
from swe_sphere.cli.show import Terminal, show_summary
from swe_sphere.compiling import on_compile
from swe_sphere.simulation.config import RunConfig, load_config, make_config
from swe_sphere.simulation.run import run as run_scene
from swe_sphere.simulation.summary import Summary, failed_summary

__all__ = ["is_given", "run"]


def _number(flag: str, unit: str, text: str) -> Any:
    """An option that is a number, with its unit in the help."""
    return typer.Option(flag, metavar=unit, help=text)


def run(
    context: typer.Context,
    scene: Annotated[
        str | None, typer.Argument(help="Name of a scene, or a .py or .toml file with one.")
    ] = None,
    stepper: Annotated[
        str | None, typer.Option(metavar="NAME", help="Time integrator, or a .py file with one.")
    ] = None,
    preconditioner: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Of an implicit stepper's solves, or a .py file."),
    ] = None,
    tolerance: Annotated[
        float | None,
        _number("--tolerance", "T", "Of an implicit stepper's solves, relative to the change."),
    ] = None,
    dt: Annotated[
        str | None,
        _number(
            "--dt",
            "SECONDS|auto",
            "Time step. auto (the default): a safe part of the stability limit; for a stepper"
            " without one, advective Courant number 2, but no more than an hour.",
        ),
    ] = None,
    adaptive: Annotated[
        float | None,
        _number("--adaptive", "TOL", "Let steps inside of --dt follow their error (relative)."),
    ] = None,
    adaptive_by: Annotated[
        str | None,
        typer.Option(
            metavar="embedded|energy", help="That error: of a step, or the energy drift per day."
        ),
    ] = None,
    days: Annotated[
        float | None, _number("--days", "D", "Length of the run, from the very start.")
    ] = None,
    ne: Annotated[int | None, _number("--ne", "N", "Elements along an edge of the cube.")] = None,
    np: Annotated[int | None, _number("--np", "N", "Nodes along an edge of an element.")] = None,
    stretch: Annotated[
        float | None, _number("--stretch", "S", "Refine the mesh S times at the centre.")
    ] = None,
    centre_lon: Annotated[
        float | None, _number("--centre-lon", "RADIANS", "Longitude of the centre.")
    ] = None,
    centre_lat: Annotated[
        float | None, _number("--centre-lat", "RADIANS", "Latitude of the centre.")
    ] = None,
    spin: Annotated[
        float | None, _number("--spin", "RADIANS", "Turn of the cube about the centre.")
    ] = None,
    alpha: Annotated[
        float | None, _number("--alpha", "RADIANS", "Angle between flow and equator.")
    ] = None,
    device: Annotated[str | None, typer.Option(metavar="cpu|cuda:0", help="Where to run.")] = None,
    precision: Annotated[
        str | None, typer.Option(metavar="float64|float32", help="Number type of the state.")
    ] = None,
    launch: Annotated[
        str | None, typer.Option(metavar="element|node", help="Threads of the kernels.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="EFFECT.PARAMETER=VALUE",
            help="Change an effect (viscosity.nu=1e5), the scene (scene.alpha=0.5) or an option of"
            " the stepper (stepper.tolerance=1e-4); repeatable.",
        ),
    ] = None,
    diagnostics: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE.py", help="Diagnostics of your own, in a file; repeatable."),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.nc", help="Write frames here.")] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace that file if it is there already.")
    ] = False,
    every: Annotated[
        float | None, _number("--every", "HOURS", "Time between frames (about a day).")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the last frame.")
    ] = None,
    restart: Annotated[
        Path | None,
        typer.Option(metavar="FILE.nc", help="Go on where that run stopped; --out may name it."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE.nc", help="Lat-lon reference for the errors.")
    ] = None,
    time_limit: Annotated[
        float | None,
        _number("--time-limit", "SECONDS", "End the run after so long, in good order."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Options by name; flags go first.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one line of JSON.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> int:
    """Run a scene and report errors, conservation and cost."""
    try:
        asked = _configuration(context, config)
        summary = _run(asked)
    except Exception as error:
        if as_json:
            typer.echo(failed_summary(context.params, *explain(error)).as_json())
        raise
    show_summary(summary, asked)
    return summary.exit_status


def _run(asked: RunConfig) -> Summary:
    terminal = Terminal(asked)
    try:
        with on_compile(terminal.compiling):
            return run_scene(asked, terminal)
    except KeyboardInterrupt:
        raise Stopped("interrupted by Ctrl-C") from None


def _configuration(context: typer.Context, file: Path | None) -> RunConfig:
    """What the flags say, and for the rest the file."""
    flags = {name: value for name, value in context.params.items() if is_given(value)}
    flags.pop("config", None)
    values = load_config(file) if file is not None else {}
    return make_config(values | flags)


def is_given(value: object) -> bool:
    """Whether a flag was given: none of them can be given as nothing, false or an empty list."""
    return value is not None and value is not False and value != [] and value != ()
