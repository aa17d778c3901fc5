"""The pages of verification and of stability, in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

from swe_sphere.files.fingerprints import versions
from swe_sphere.settings.values import read_toml
from swe_sphere.studies.cases.case import NORMS, families
from swe_sphere.studies.cases.rows import OUTCOMES, Row, count_outcomes
from swe_sphere.studies.pages import anchor, rendered

MASS = "mass_drift"
"""Shown once for all rows of the verification, unless it is out of bounds."""
COLUMNS = {name: f"{name[:-2]}({name[-1]})" for name in NORMS} | {
    "order": "order(h)",
    "order_v": "order(v)",
}
"""Quantities that have a column of their own, and its head."""
HEADS = {
    "verification": ("ne", "np", "Δt [s]", *COLUMNS.values(), "other", "of bound"),
    "stability": ("case", "Δt [s]", "× 1/ρ", "outcome", "numbers"),
}
"""Columns of tables; those without any entry are left out."""

Table = tuple[str, Sequence[str], Sequence[Sequence[str]], Sequence[str]]
"""A caption, heads, lines, and remarks below."""


def page(folder: str, rows: Sequence[Row], command: str) -> str:
    """Return the page of the rows of "verification" or "stability", made by a command.

    Families are in their order; verification has a table for each case, stability one for each
    family.
    """
    sections, summary = [], []
    for family in families(folder).values():
        mine = [row for row in rows if row.case.family == family.name]
        if mine and folder == "verification":
            cases = groupby(mine, lambda row: row.case.name)
            sections.append((family, [_case_table([*case]) for _, case in cases]))
        elif mine:
            sections.append((family, [_family_table(mine)]))
            numbers = [*count_outcomes(mine).values(), len(family.cases) - len(mine)]
            summary.append([f"[{family.title}](#{anchor(family.title)})", *map(str, numbers)])
    return rendered(
        "swe_sphere.studies.cases", f"{folder}.md.j2", sections=sections, command=command,
        summary=(["group", *OUTCOMES, "not run"], summary), count=len(rows),
        failed=sum(not row.passed for row in rows), mass=max(map(_drift, rows), default=0.0),
        stepping=sum(row.seconds for row in rows),
        seconds=sum(row.quantities.get("seconds", 0.0) for row in rows), **versions(),
    )  # fmt: skip


def _drift(row: Row) -> float:
    """Return the relative drift of mass, 0 where it is not conserved to round-off."""
    kept = any(check.quantity == MASS for check in row.checks)
    return abs(row.quantities.get(MASS, 0.0)) if kept and row.config.precision == "float64" else 0.0


def _table(folder: str, cells: Iterable[Mapping[str, str]]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and the lines of a table from the cells of each line by head."""
    rows = [*cells]
    heads = [head for head in HEADS[folder] if any(row.get(head) for row in rows)]
    return heads, [[row.get(head, "") for head in heads] for row in rows]


@cache
def _quantities() -> dict[str, dict[str, Any]]:
    """Return labels, and digits worth showing, of quantities that need them."""
    return read_toml(Path(__file__).with_name("quantities.toml"))


def _label(name: str) -> str:
    return str(_quantities().get(name, {}).get("label", COLUMNS.get(name, name)))


def _number(name: str, value: float) -> str:
    if name.startswith("order"):
        return f"{value:.1f}"
    digits = _quantities().get(name, {}).get("digits")
    return f"{value:.{digits}g}" if digits else f"{value:.2e}"


def _case_table(rows: list[Row]) -> Table:
    case = rows[0].case
    caption = f"**{case.name}** ({case.scene})" + (f": {case.title}" if case.title else "")
    return caption, *_table("verification", map(_cells, rows)), [*_case_remarks(rows)]


def _cells(row: Row) -> dict[str, str]:
    """Return what is bounded, and all norms and orders if one of the norms is."""
    wanted, numbers = {check.quantity for check in row.checks}, row.quantities
    wanted |= {"order", "order_v"} if wanted & set(NORMS) else set()
    others = []
    for check in row.checks:
        if check.quantity not in COLUMNS and (check.quantity != MASS or not check.holds):
            limit = f" (≤ {check.high:.3g})" if math.isinf(check.low) else ""
            limit = f" (≥ {check.low:.3g})" if math.isinf(check.high) else limit
            number = _number(check.quantity, check.obtained)
            others.append(f"{_label(check.quantity)} {number}{limit}")
    return {
        "ne": f"{row.config.ne}", "np": f"{row.config.np}",
        "Δt [s]": "-" if row.case.method == "start" else f"{row.dt:.4g}",
        **{COLUMNS[n]: _number(n, numbers[n]) for n in COLUMNS if n in wanted and n in numbers},
        "other": "; ".join(others),
        "of bound": f"{row.used:.2f} {'✓' if row.passed else '**fails**'}",
    }  # fmt: skip


def _case_remarks(rows: list[Row]) -> Iterator[str]:
    """Yield published numbers, failures, and the note of a case."""
    for row in rows:
        for source, values in row.level.published.items():
            for name, value in values.items():
                ours = _number(name, row.quantities.get(name, math.nan))
                yield f"{_label(name)}: {ours} here, {value:.4g} published ({source})."
    stopped = [row.measure for row in rows if row.measure.status != "completed"]
    yield from (f"The run was {measure.status}: {measure.reason}." for measure in stopped)
    if note := rows[0].case.note:
        yield f"{note[0].upper()}{note[1:]}."


def _family_table(rows: list[Row]) -> Table:
    """Return the table of a family, with each reason once below it."""
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.reason:
            reasons.setdefault(f"{row.outcome}: {row.reason}", []).append(row.case.name)
    remarks = [f"`{'`, `'.join(names)}` {reason}" for reason, names in reasons.items()]
    return "", *_table("stability", map(_outcome_cells, rows)), remarks


def _outcome_cells(row: Row) -> dict[str, str]:
    numbers, outcome = row.measure.numbers, row.outcome
    names = dict.fromkeys([*(check.quantity for check in row.checks), *row.case.report])
    if outcome != "passed" and numbers.get("last_day") is not None:
        names |= {"last_day": None}
    shown = {name: _short(numbers[name], name) for name in numbers}
    return {
        "case": row.case.name, "Δt [s]": shown.get("dt", ""),
        "× 1/ρ": shown.get("dt_over_gravity", ""),
        "outcome": f"**{outcome}**" if outcome in ("broke", "failed") else outcome,
        "numbers": ", ".join(f"{name} {shown[name]}" for name in names if name in shown),
    }  # fmt: skip


def _short(value: float | None, name: str) -> str:
    if value is None:
        return "none" if name == "symmetry_day" else "–"
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.4g}"
