"""One colour and one marker for each stepper, the same in every picture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from swe_sphere.pictures.panels import COLOURS
from swe_sphere.steppers import STEPPERS
from swe_sphere.steppers.stepper import Marker
from swe_sphere.studies.report.rows import Row


@dataclass(frozen=True)
class Look:
    """How something is drawn: a colour, and a marker of matplotlib."""

    colour: str
    marker: Marker


GREY = "#7F7F7F"
MARKERS = ("8", "H", "d", "*", "X")
LINES = ("-", "--", ":", "-.")
"""Styles of the variants of a stepper (preconditioner, precision, device, settings)."""
STATUS = {
    "completed": Look("#009E73", "o"),
    "unstable": Look("#D55E00", "X"),
    "timed-out": Look("#E69F00", "s"),
    "solver-failed": Look("#CC79A7", "v"),
    "refused": Look(GREY, "_"),
    "failed": Look("#56B4E9", "P"),
}
"""How the ends of runs are drawn."""


def look(stepper: str) -> Look:
    """The colour and marker of a stepper; of one without, always the same for its name."""
    style = STEPPERS[stepper].style if stepper in STEPPERS else None
    if style is not None:
        return Look(*style)
    place = sum((i + 1) * byte for i, byte in enumerate(stepper.encode()))
    colours = (*COLOURS, GREY)
    return Look(colours[place % len(colours)], MARKERS[place // 7 % len(MARKERS)])


@dataclass(frozen=True, eq=False)
class Curve:
    """Rows that differ in their step only, by rising step."""

    label: str
    stepper: str
    line: str
    rows: tuple[Row, ...]


def curves(rows: Iterable[Row]) -> list[Curve]:
    """Rows of one mesh as curves; a label says what tells it from the stepper's other curves."""
    rows = list(rows)
    names: set[str] = {row.stepper for row in rows}
    only = {name: _only([row for row in rows if row.stepper == name]) for name in names}
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        variant = (part or one for part, one in zip(_variant(row), only[row.stepper], strict=True))
        groups.setdefault((row.stepper, *variant), []).append(row)
    made = []
    for key, members in sorted(groups.items()):
        others = [other for other in sorted(groups) if other[0] == key[0]]
        label = ", ".join([key[0], *_difference(key, others)])
        line = LINES[others.index(key) % len(LINES)]
        made.append(Curve(label, key[0], line, tuple(sorted(members, key=lambda row: row.dt))))
    return made


def _variant(row: Row) -> tuple[str, ...]:
    return row.preconditioner, row.precision, row.device, row.settings


def _only(rows: list[Row]) -> tuple[str, ...]:
    """What stands for an empty part of a variant: a run that never began may not have noted it."""
    parts = [set(filter(None, values)) for values in zip(*map(_variant, rows), strict=True)]
    return tuple(part.pop() if len(part) == 1 else "" for part in parts)


PLAIN = {(1, "none"): "no preconditioner"}


def _difference(key: tuple[str, ...], others: list[tuple[str, ...]]) -> list[str]:
    return [
        PLAIN.get((i, part), part or "default")
        for i, part in enumerate(key)
        if i and len({other[i] for other in others}) > 1
    ]
