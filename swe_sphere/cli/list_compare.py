"""`swe-sphere list` and `compare`: looking at what there is."""

import json
from pathlib import Path
from typing import Annotated

import typer

from swe_sphere.cli.options import AsJson
from swe_sphere.planet import DAY

Field = Annotated[
    str | None, typer.Option("--field", metavar="NAME", help="h, surface, vorticity, ...")
]


def list_all() -> None:
    """List the scenes and steppers, one line each."""
    from swe_sphere.steppers import list_steppers
    from swe_sphere.testcases import list_scenes

    _list("Scenes", list_scenes())
    _list("Steppers", list_steppers())


def compare(
    a: Annotated[Path, typer.Argument(help="File whose errors are wanted.")],
    b: Annotated[Path, typer.Argument(help="File taken for right; any other grid.")],
    field: Field = None,
    time: Annotated[
        float | None, typer.Option(metavar="DAYS", help="Time of both (the last that both have).")
    ] = None,
    across_scenes: Annotated[
        bool, typer.Option("--across-scenes", help="Also runs of different scenes.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Print l1, l2 and linf of A against B."""
    from swe_sphere.io.compare import compare as compare_files

    result = compare_files(a, b, field, _seconds(time), across_scenes)
    if as_json:
        typer.echo(json.dumps(result))
        return
    when = "" if result["time"] is None else f" at day {float(result['time']) / DAY:g}"
    typer.echo(f"{result['field']}{when}")
    for norm in ("l1", "l2", "linf"):
        typer.echo(f"  {norm:5} {result[norm]:.6e}")


def _list(title: str, lines: dict[str, str]) -> None:
    width = max(map(len, lines))
    typer.echo(f"{title}:")
    for name, text in lines.items():
        typer.echo(f"  {name:{width}}  {text}")


def _seconds(days: float | None) -> float | None:
    return None if days is None else days * DAY
