"""The form of what stands in a journal, by which lines of anything else are told from records."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from swe_sphere.studies.sweep.execute import COUNTS
from swe_sphere.studies.sweep.judge import ERRORS, KINDS, NORMS

__all__ = ["UNITS", "WORDS", "Record", "complaint"]

Record = dict[str, Any]

WORDS = (
    "scene", "stepper", "preconditioner", "precision", "device", "settings", "role", "status",
    "reason",
)  # fmt: skip
"""Words of a row."""
UNITS = {
    **dict.fromkeys(("ne", "np", "stretch", "steps", *COUNTS), "1"),
    **dict.fromkeys(("mass_drift", "energy_drift", "enstrophy_drift"), "1"),
    **dict.fromkeys(("dt", "gravity_limit", "advective_limit"), "s"),
    **dict.fromkeys(
        ("wall_seconds", "cpu_seconds", "compile_seconds", "setup_seconds", "total_seconds"), "s"
    ),
    **dict.fromkeys(("days", "days_planned"), "d"),
    "peak_memory": "byte",
}
"""Numbers of a row and their units."""
ALWAYS = ("ne", "np", "stretch", "dt", "days_planned")
"""Numbers that no row lacks."""


class _Strict(BaseModel):
    """Nothing is taken for what it is not; keys besides are let be."""

    model_config = ConfigDict(strict=True)


class _Bench(_Strict):
    ne: int
    np: int
    stretch: float
    precision: str
    device: str


class _Made(_Strict):
    sources: dict[str, str]


class _Header(_Made):
    record: Literal["sweep"]
    scene: str
    title: str
    plan: dict[str, Any]
    machine: str
    cores: int | None
    versions: dict[str, str]
    created: str
    command: str


class _Calibration(_Made):
    record: Literal["calibration"]
    bench: _Bench
    seconds: Annotated[float, Field(gt=0.0)]


def _row() -> Any:
    fields: dict[str, Any] = {name: (float | None, None) for name in UNITS}
    fields |= {name: (float, ...) for name in ALWAYS} | {name: (str, ...) for name in WORDS}
    return create_model("_Row", __base__=_Strict, **fields)


def _errors() -> Any:
    norms = create_model("_Norms", __base__=_Strict, **_named(NORMS, float | None))
    fields: dict[str, Any] = {"kind": (Literal[KINDS], ...), "day": (float, ...)}
    return create_model("_Errors", __base__=_Strict, **fields, **_named(ERRORS, norms))


def _named(names: tuple[str, ...], kind: Any) -> dict[str, Any]:
    """Fields that may be missing."""
    return {name: (kind, None) for name in names}


def _run() -> Any:
    """A model; it is made from the names of what is in a row, which are kept in one place."""
    fields: dict[str, Any] = {
        "record": (Literal["run"], ...),
        "key": (str, ...),
        "repeat": (int, ...),
        "row": (_row(), ...),
        "errors": (list[_errors()], ...),  # type: ignore[misc]
        "time_limit": (float | None, None),
    }
    return create_model("_Run", __base__=_Made, **fields)


@cache
def _records() -> TypeAdapter[Any]:
    kinds: Any = _Header | _run() | _Calibration
    return TypeAdapter(Annotated[kinds, Field(discriminator="record")])


def complaint(record: object) -> str:
    """What keeps this from being a record, in a few words; empty for a record."""
    try:
        _records().validate_python(record)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if not first["loc"]:
            return "its record must be sweep, run or calibration"
        where = ".".join(str(part) for part in first["loc"][1:])
        return f"{where}: {first['msg'].replace('Input should', 'must')}"
    return ""
