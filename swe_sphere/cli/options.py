"""The flags of a command from the fields of its configuration: names, types and help texts."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from pydantic import BaseModel

from swe_sphere.simulation.config import flag_of

__all__ = ["given", "with_flags"]

F = TypeVar("F", bound=Callable[..., Any])

METAVARS = {
    "stepper": "NAME|FILE.py", "preconditioner": "NAME|FILE.py", "tolerance": "T",
    "dt": "SECONDS|auto", "adaptive": "TOL", "days": "D", "ne": "N", "np": "N", "stretch": "S",
    "centre_lon": "RADIANS", "centre_lat": "RADIANS", "spin": "RADIANS", "alpha": "RADIANS",
    "device": "cpu|cuda:0", "settings": "EFFECT.PARAMETER=VALUE", "diagnostics": "FILE.py",
    "out": "FILE.nc", "every": "HOURS", "plot": "FILE.png", "restart": "FILE.nc",
    "reference": "FILE.nc", "time_limit": "SECONDS",
}  # fmt: skip
"""What a flag takes, where its type does not say it."""


def with_flags(model: type[BaseModel], argument: str) -> Callable[[F], F]:
    """Give a command `f(context, **values)` a flag for each field of the model.

    argument: the field that is given without a flag.  The command's own parameters stay; what the
    user does not give is None, and the texts of the fields are the help.
    """

    def give(function: F) -> F:
        own = [
            parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for parameter in inspect.signature(function, eval_str=True).parameters.values()
            if parameter.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        fields = [_parameter(model, name, argument) for name in model.model_fields]
        parameters = [own[0], *fields, *own[1:]]
        function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        function.__annotations__ = {p.name: p.annotation for p in parameters}
        return function

    return give


def given(values: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """The fields of the model that the user gave."""
    names = model.model_fields
    return {n: v for n, v in values.items() if n in names and v not in (None, False, [], ())}


def _parameter(model: type[BaseModel], name: str, argument: str) -> inspect.Parameter:
    field = model.model_fields[name]
    kind, choices = _kind(field.annotation)
    text = (field.description or "").replace("[", r"\[")
    if name == argument:
        info = typer.Argument(help=text)
    elif kind is bool:
        info = typer.Option(f"--{flag_of(name)}", help=text)
    else:
        metavar = METAVARS.get(name) or choices
        info = typer.Option(f"--{flag_of(name)}", metavar=metavar, help=text)
    default = False if kind is bool else None
    annotation = Annotated[kind if kind is bool else kind | None, info]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


def _kind(annotation: Any) -> tuple[Any, str | None]:
    """The plain type of a field as a flag takes it, and its choices in words."""
    if get_origin(annotation) is Annotated:
        return _kind(get_args(annotation)[0])
    if get_origin(annotation) is Literal:
        return str, "|".join(map(str, get_args(annotation)))
    if get_origin(annotation) is tuple:
        return list[_kind(get_args(annotation)[0])[0]], None  # type: ignore[misc]
    kinds = [_kind(each) for each in get_args(annotation) if each is not type(None)]
    if len(kinds) == 1:
        return kinds[0]
    if kinds:  # a number or a word: the configuration tells them apart
        return str, None
    return (annotation if annotation in (bool, int, float, Path) else str), None
