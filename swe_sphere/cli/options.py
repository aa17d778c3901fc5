"""The flags of a command from the fields of its configuration: names, types and help texts."""

from collections.abc import Callable, Collection
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from pydantic import BaseModel

from swe_sphere.settings.values import flag_of, read_toml

F = TypeVar("F", bound=Callable[..., Any])

METAVARS = read_toml(Path(__file__).with_name("placeholders.toml"))
"""Placeholders of the values of flags in the help, if the type is not enough."""


AsJson = Annotated[bool, typer.Option("--json", help="Print one line of JSON.")]
Jobs = Annotated[int, typer.Option(metavar="N", help="Number of parallel processes.")]
Field = Annotated[str | None, typer.Option(metavar="NAME", help="h, surface, vorticity, ...")]
"""Flags that several commands have."""

LIST = "A,B,..."
REPEATED = ("settings", "diagnostics", "reference", "trust")
"""Fields of several values whose flag is repeated for each; others take a list, A,B,..."""


def option(metavar: str, text: str, default: Any = None) -> Any:
    """Return an option of a command, to be the default value of the parameter with its name."""
    return typer.Option(default, metavar=metavar, help=text)


def flag(name: str, text: str) -> Any:
    """Return a boolean option of a command that is off by default."""
    return typer.Option(False, f"--{name}", help=text)


def with_flags(
    model: type[BaseModel], argument: str = "", without: Collection[str] = ()
) -> Callable[[F], F]:
    """Give a command `f(**values)` a flag for each field of the model.

    argument: field that becomes a positional argument, if any; without: fields without a flag. The
    command keeps its other parameters; missing flags are None; descriptions of fields are the help.
    """

    def give(function: F) -> F:
        known = signature(function, eval_str=True).parameters.values()
        own = [x.replace(kind=x.KEYWORD_ONLY) for x in known if x.kind is not x.VAR_KEYWORD]
        names = [name for name in model.model_fields if name not in without]
        names.sort(key=lambda name: name not in model.__annotations__)  # inherited ones come last
        parameters = [*(_parameter(model, name, argument) for name in names), *own]
        function.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        function.__annotations__ = {p.name: p.annotation for p in parameters}
        return function

    return give


def given(values: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Return the fields of the model that the user gave."""
    absent: tuple[object, ...] = (None, [], ())
    return {k: x for k, x in values.items() if k in model.model_fields and x not in absent}


def _parameter(model: type[BaseModel], name: str, argument: str) -> Parameter:
    field = model.model_fields[name]
    kind, choices = _kind(field.annotation, name in REPEATED)
    text = (field.description or "").replace("[", r"\[")
    no = f"/--no-{flag_of(name)}" if kind is bool and field.default is not False else ""
    metavar = LIST if choices == LIST else METAVARS.get(name) or choices
    info = typer.Option(f"--{flag_of(name)}{no}", metavar=metavar, help=text)
    wanted: Any = kind | None
    annotation = Annotated[wanted, typer.Argument(help=text) if name == argument else info]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def _kind(annotation: Any, repeated: bool) -> tuple[Any, str | None]:
    """Return the plain type of a field as a flag converts it, and its choices in words."""
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inside[0], repeated)
    if origin is Literal:
        return str, "|".join(map(str, inside))
    if origin is tuple and repeated:
        return list[_kind(inside[0], repeated)[0]], None  # type: ignore[misc]
    if origin is tuple:
        return str, LIST if inside[-1] is ... else None
    kinds = [_kind(each, repeated) for each in inside if each is not type(None)]
    if len(kinds) == 1:  # of several, the configuration distinguishes numbers and words
        return kinds[0]
    return (annotation if annotation in (bool, int, float, Path) else str), None
