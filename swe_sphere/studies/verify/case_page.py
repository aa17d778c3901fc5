"""The verification page: all rows as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from swe_sphere.files.fingerprints import versions
from swe_sphere.settings.values import read_toml
from swe_sphere.studies.ended import Check
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.verify.case import NORMS, Case, families
from swe_sphere.studies.verify.verdict import Row

PACKAGE = "swe_sphere.studies.verify"

MASS = "mass_drift"
"""Told once for all rows, unless it is out of bounds."""

COLUMNS = {name: f"{name[:-2]}({name[-1]})" for name in NORMS} | {
    "order": "order(h)",
    "order_v": "order(v)",
}
"""Quantities that have a column of their own, and its head."""


def page(rows: Sequence[Row], command: str) -> str:
    """The page (Markdown) of these rows, in the order of the families."""
    return rendered(
        PACKAGE, "page.md.j2", _cells, _remarks, **versions(), command=command,
        families=[*_told(rows)], count=len(rows), failed=sum(not row.passed for row in rows),
        seconds=sum(row.seconds for row in rows), mass=max(map(_drift, rows), default=0.0),
    )  # fmt: skip


def _told(rows: Sequence[Row]) -> Iterator[tuple[str, list[tuple[Case, list[Row]]]]]:
    """Cases and their rows by the title of their family."""
    for title, cases in families().items():
        of_cases = [(case, [row for row in rows if row.case.name == case.name]) for case in cases]
        if any(mine for _, mine in of_cases):
            yield title, [(case, mine) for case, mine in of_cases if mine]


def _drift(row: Row) -> float:
    """Relative drift of mass, 0 where it is not to be conserved to round-off."""
    kept = math.isfinite(row.case.mass) and row.config.precision == "float64"
    return abs(row.quantities.get(MASS, 0.0)) if kept else 0.0


def _cells(rows: list[Row]) -> tuple[list[str], list[list[str]]]:
    """Heads and lines of the table of a case."""
    columns = [name for name in COLUMNS if any(name in _shown(row) for row in rows)]
    others = any(_others(row) for row in rows)
    heads = ["ne", "np", "Δt [s]", *(COLUMNS[name] for name in columns)]
    lines = [_line(row, columns, others) for row in rows]
    return [*heads, *["other"] * others, "of bound"], lines


def _line(row: Row, columns: list[str], others: bool) -> list[str]:
    config, shown = row.config, _shown(row)
    step = "-" if row.case.start else f"{row.dt:.4g}"
    numbers = [_number(name, shown[name]) if name in shown else "" for name in columns]
    other = ["; ".join(_others(row))] if others else []
    verdict = f"{row.worst.used:.2f} {'✓' if row.passed else '**fails**'}"
    return [f"{config.ne}", f"{config.np}", step, *numbers, *other, verdict]


def _shown(row: Row) -> dict[str, float]:
    """What stands in columns: what is bounded, and all norms if one of them is."""
    bounded = {check.quantity for check in row.checks}
    orders = {name for name in ("order", "order_v") if bounded & set(NORMS)}
    wanted = bounded | orders
    return {name: x for name, x in row.quantities.items() if name in wanted and name in COLUMNS}


def _others(row: Row) -> list[str]:
    """Numbers without a column."""
    return [
        f"{_label(check.quantity)} {_number(check.quantity, check.obtained)}{_limit(check)}"
        for check in row.checks
        if check.quantity not in COLUMNS and (check.quantity != MASS or not check.holds)
    ]


def _limit(check: Check) -> str:
    if math.isinf(check.bound.low):
        return f" (≤ {check.bound.high:.3g})"
    return f" (≥ {check.bound.low:.3g})" if math.isinf(check.bound.high) else ""


def _remarks(rows: list[Row]) -> Iterator[str]:
    """Published numbers, failures, and the note of a case."""
    for row in rows:
        for published in row.level.published:
            for name, value in published.values.items():
                ours = _number(name, row.quantities.get(name, math.nan))
                theirs = f"{value:.4g} published ({published.source})"
                yield f"{_label(name)}: {ours} here, {theirs}."
    yield from (f"The run was {r.measure.status}: {r.measure.reason}." for r in rows if r.stopped)
    if note := rows[0].case.note:
        yield f"{note[0].upper()}{note[1:]}."


@cache
def _quantities() -> dict[str, dict[str, Any]]:
    """Labels, and digits worth showing, of quantities whose name does not say enough."""
    return read_toml(Path(str(resources.files(PACKAGE))) / "quantities.toml")


def _label(name: str) -> str:
    return str(_quantities().get(name, {}).get("label", COLUMNS.get(name, name)))


def _number(name: str, value: float) -> str:
    if name.startswith("order"):
        return f"{value:.1f}"
    digits = _quantities().get(name, {}).get("digits")
    return f"{value:.{digits}g}" if digits else f"{value:.2e}"
