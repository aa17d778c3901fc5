"""The pages of verification and of stability, in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from swe_sphere.files.fingerprints import versions
from swe_sphere.settings.values import read_toml
from swe_sphere.studies.cases.bounds import Check
from swe_sphere.studies.cases.case import NORMS
from swe_sphere.studies.cases.families import Family, families
from swe_sphere.studies.cases.verdict import OUTCOMES, Row
from swe_sphere.studies.pages import anchor, rendered

MASS = "mass_drift"
"""Shown once for all rows of the verification, unless it is out of bounds."""

COLUMNS = {name: f"{name[:-2]}({name[-1]})" for name in NORMS} | {
    "order": "order(h)",
    "order_v": "order(v)",
}
"""Quantities that have a column of their own, and its head."""


@dataclass(frozen=True)
class Table:
    """A table of a page, what stands above it, and remarks below."""

    heads: Sequence[str]
    lines: Sequence[Sequence[str]]
    remarks: Sequence[str] = ()
    caption: str = ""


def verification_page(rows: Sequence[Row], command: str) -> str:
    """Return the page of these rows, in the order of the families: a table for each case."""
    sections = [
        (family, [_case_table([*by_case]) for by_case in _by_case(mine)])
        for family, mine in _by_family("verification", rows)
    ]
    return _rendered(
        "verification", sections, command=command, count=len(rows),
        failed=sum(not row.passed for row in rows), seconds=sum(row.seconds for row in rows),
        mass=max(map(_drift, rows), default=0.0),
    )  # fmt: skip


def stability_page(rows: Sequence[Row], quick: bool) -> str:
    """Return the page of these rows, in the order of the families: a table for each family."""
    shown = [*_by_family("stability", rows)]
    sections = [(family, [_family_table(mine)]) for family, mine in shown]
    heads = ["group", *OUTCOMES, "not run"]
    return _rendered(
        "stability", sections, quick=quick, summary=(heads, [_summary(*each) for each in shown]),
        seconds=sum(row.quantities.get("seconds", 0.0) for row in rows),
    )  # fmt: skip


def _rendered(name: str, sections: list[tuple[Family, list[Table]]], **values: object) -> str:
    return rendered(
        "swe_sphere.studies.cases", f"{name}.md.j2", sections=sections, **versions(), **values
    )


def _by_family(folder: str, rows: Sequence[Row]) -> Iterator[tuple[Family, list[Row]]]:
    """Yield the families of which there are rows, and these in the order of the cases."""
    for family in families(folder).values():
        mine = [row for case in family.cases for row in rows if row.case.name == case.name]
        if mine:
            yield family, mine


def _by_case(rows: list[Row]) -> Iterator[list[Row]]:
    for name in dict.fromkeys(row.case.name for row in rows):
        yield [row for row in rows if row.case.name == name]


# --- verification


def _drift(row: Row) -> float:
    """Return the relative drift of mass, 0 where it is not conserved to round-off."""
    kept = any(check.quantity == MASS for check in row.checks)
    return abs(row.quantities.get(MASS, 0.0)) if kept and row.config.precision == "float64" else 0.0


def _case_table(rows: list[Row]) -> Table:
    case, columns = rows[0].case, [name for name in COLUMNS if any(name in _shown(r) for r in rows)]
    others = any(_others(row) for row in rows)
    heads = ["ne", "np", "Δt [s]", *(COLUMNS[name] for name in columns)]
    title = f": {case.title}" if case.title else ""
    return Table(
        [*heads, *["other"] * others, "of bound"],
        [_case_line(row, columns, others) for row in rows],
        [*_case_remarks(rows)],
        f"**{case.name}** ({case.scene}){title}",
    )


def _case_line(row: Row, columns: list[str], others: bool) -> list[str]:
    config, shown = row.config, _shown(row)
    step = "-" if row.case.method == "start" else f"{row.dt:.4g}"
    numbers = [_number(name, shown[name]) if name in shown else "" for name in columns]
    other = ["; ".join(_others(row))] if others else []
    verdict = f"{row.worst.used:.2f} {'✓' if row.passed else '**fails**'}"
    return [f"{config.ne}", f"{config.np}", step, *numbers, *other, verdict]


def _shown(row: Row) -> dict[str, float]:
    """Return the numbers with a column: what is bounded, and all norms if one of them is."""
    bounded = {check.quantity for check in row.checks}
    orders = {name for name in ("order", "order_v") if bounded & set(NORMS)}
    wanted = bounded | orders
    return {name: x for name, x in row.quantities.items() if name in wanted and name in COLUMNS}


def _others(row: Row) -> list[str]:
    """Return the numbers without a column."""
    return [
        f"{_label(check.quantity)} {_number(check.quantity, check.obtained)}{_limit(check)}"
        for check in row.checks
        if check.quantity not in COLUMNS and (check.quantity != MASS or not check.holds)
    ]


def _limit(check: Check) -> str:
    if math.isinf(check.bound.low):
        return f" (≤ {check.bound.high:.3g})"
    return f" (≥ {check.bound.low:.3g})" if math.isinf(check.bound.high) else ""


def _case_remarks(rows: list[Row]) -> Iterator[str]:
    """Yield published numbers, failures, and the note of a case."""
    for row in rows:
        for published in row.level.published:
            for name, value in published.values.items():
                ours = _number(name, row.quantities.get(name, math.nan))
                theirs = f"{value:.4g} published ({published.source})"
                yield f"{_label(name)}: {ours} here, {theirs}."
    stopped = [row.measure for row in rows if row.measure.status != "completed"]
    yield from (f"The run was {measure.status}: {measure.reason}." for measure in stopped)
    if note := rows[0].case.note:
        yield f"{note[0].upper()}{note[1:]}."


@cache
def _quantities() -> dict[str, dict[str, Any]]:
    """Return labels, and digits worth showing, of quantities that need them."""
    return read_toml(Path(str(resources.files(__package__))) / "quantities.toml")


def _label(name: str) -> str:
    return str(_quantities().get(name, {}).get("label", COLUMNS.get(name, name)))


def _number(name: str, value: float) -> str:
    if name.startswith("order"):
        return f"{value:.1f}"
    digits = _quantities().get(name, {}).get("digits")
    return f"{value:.{digits}g}" if digits else f"{value:.2e}"


# --- stability


def _summary(family: Family, rows: list[Row]) -> list[str]:
    """Return how many cases of a family came to which outcome."""
    counts = Counter(row.outcome for row in rows)
    numbers = [*(counts[name] for name in OUTCOMES), len(family.cases) - len(rows)]
    return [f"[{family.title}](#{anchor(family.title)})", *map(str, numbers)]


def _family_table(rows: list[Row]) -> Table:
    """Return the table of a family, with each reason once below it."""
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.reason:
            reasons.setdefault(f"{row.outcome}: {row.reason}", []).append(row.case.name)
    return Table(
        ["case", "Δt [s]", "× 1/ρ", "outcome", "numbers"],
        [_family_line(row) for row in rows],
        [f"`{'`, `'.join(names)}` {reason}" for reason, names in reasons.items()],
    )


def _family_line(row: Row) -> list[str]:
    numbers, outcome = row.measure.numbers, row.outcome
    names = dict.fromkeys([*(check.quantity for check in row.checks), *row.case.report])
    texts = [f"{name} {_short(numbers[name], name)}" for name in names if name in numbers]
    if outcome != "passed" and numbers.get("last_day") is not None:
        texts.append(f"last_day {_short(numbers['last_day'])}")
    marked = f"**{outcome}**" if outcome in ("broke", "failed") else outcome
    steps = [_short(numbers[x]) if x in numbers else "" for x in ("dt", "dt_over_gravity")]
    return [row.case.name, *steps, marked, ", ".join(texts)]


def _short(value: float | None, name: str = "") -> str:
    if value is None:
        return "none" if name == "symmetry_day" else "–"
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.4g}"
