"""The pages of verification and of stability, in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

from swe_sphere.files.fingerprints import versions
from swe_sphere.settings.values import read_toml
from swe_sphere.studies.cases.case import NORMS, Check
from swe_sphere.studies.cases.families import Family, families
from swe_sphere.studies.cases.rows import OUTCOMES, Row
from swe_sphere.studies.pages import anchor, rendered

MASS = "mass_drift"
"""Shown once for all rows of the verification, unless it is out of bounds."""

COLUMNS = {name: f"{name[:-2]}({name[-1]})" for name in NORMS} | {
    "order": "order(h)",
    "order_v": "order(v)",
}
"""Quantities that have a column of their own, and its head."""


Table = tuple[str, Sequence[str], Sequence[Sequence[str]], Sequence[str]]
"""A caption, heads, lines, and remarks below."""


def verification_page(rows: Sequence[Row], command: str) -> str:
    """Return the page of these rows, in the order of the families: a table for each case."""
    sections = [
        (family, [_case_table([*case]) for _, case in groupby(mine, lambda row: row.case.name)])
        for family, mine in _by_family("verification", rows)
    ]
    return _rendered(
        "verification", sections, command=command, count=len(rows),
        failed=sum(not row.passed for row in rows), seconds=sum(row.seconds for row in rows),
        mass=max(map(_drift, rows), default=0.0),
    )  # fmt: skip


def stability_page(rows: Sequence[Row], quick: bool) -> str:
    """Return the page of these rows, in the order of the families: a table for each family."""
    shown = _by_family("stability", rows)
    lines = []
    for family, mine in shown:
        counts = Counter(row.outcome for row in mine)
        numbers = [*(counts[name] for name in OUTCOMES), len(family.cases) - len(mine)]
        lines.append([f"[{family.title}](#{anchor(family.title)})", *map(str, numbers)])
    return _rendered(
        "stability", [(family, [_family_table(mine)]) for family, mine in shown], quick=quick,
        summary=(["group", *OUTCOMES, "not run"], lines),
        seconds=sum(row.quantities.get("seconds", 0.0) for row in rows),
    )  # fmt: skip


def _rendered(name: str, sections: list[tuple[Family, list[Table]]], **values: object) -> str:
    return rendered(
        "swe_sphere.studies.cases", f"{name}.md.j2", sections=sections, **versions(), **values
    )


def _by_family(folder: str, rows: Sequence[Row]) -> list[tuple[Family, list[Row]]]:
    """Return the families of which there are rows, in order, and their rows."""
    every = families(folder).values()
    found = [(each, [row for row in rows if row.case.family == each.name]) for each in every]
    return [(family, mine) for family, mine in found if mine]


# --- verification


def _drift(row: Row) -> float:
    """Return the relative drift of mass, 0 where it is not conserved to round-off."""
    kept = any(check.quantity == MASS for check in row.checks)
    return abs(row.quantities.get(MASS, 0.0)) if kept and row.config.precision == "float64" else 0.0


def _case_table(rows: list[Row]) -> Table:
    case, shown, others = rows[0].case, [*map(_shown, rows)], [*map(_others, rows)]
    names = [name for name in COLUMNS if any(name in numbers for numbers in shown)]
    other = ["other"] * any(others)
    lines = []
    for row, numbers, texts in zip(rows, shown, others, strict=True):
        step = "-" if case.method == "start" else f"{row.dt:.4g}"
        cells = [_number(name, numbers[name]) if name in numbers else "" for name in names]
        mark = "✓" if row.passed else "**fails**"
        cells += [*["; ".join(texts)] * len(other), f"{row.worst.used:.2f} {mark}"]
        lines.append([f"{row.config.ne}", f"{row.config.np}", step, *cells])
    caption = f"**{case.name}** ({case.scene})" + (f": {case.title}" if case.title else "")
    heads = ["ne", "np", "Δt [s]", *(COLUMNS[name] for name in names), *other, "of bound"]
    return caption, heads, lines, [*_case_remarks(rows)]


def _shown(row: Row) -> dict[str, float]:
    """Return the numbers with a column: what is bounded, and all norms if one of them is."""
    wanted = {check.quantity for check in row.checks}
    wanted |= {"order", "order_v"} if wanted & set(NORMS) else set()
    return {name: x for name, x in row.quantities.items() if name in wanted and name in COLUMNS}


def _others(row: Row) -> list[str]:
    """Return the numbers without a column."""
    return [
        f"{_label(check.quantity)} {_number(check.quantity, check.obtained)}{_limit(check)}"
        for check in row.checks
        if check.quantity not in COLUMNS and (check.quantity != MASS or not check.holds)
    ]


def _limit(check: Check) -> str:
    if math.isinf(check.low):
        return f" (≤ {check.high:.3g})"
    return f" (≥ {check.low:.3g})" if math.isinf(check.high) else ""


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


# --- stability


def _family_table(rows: list[Row]) -> Table:
    """Return the table of a family, with each reason once below it."""
    reasons: dict[str, list[str]] = {}
    lines = []
    for row in rows:
        numbers, outcome = row.measure.numbers, row.outcome
        if row.reason:
            reasons.setdefault(f"{outcome}: {row.reason}", []).append(row.case.name)
        names = dict.fromkeys([*(check.quantity for check in row.checks), *row.case.report])
        texts = [f"{name} {_short(numbers[name], name)}" for name in names if name in numbers]
        if outcome != "passed" and numbers.get("last_day") is not None:
            texts.append(f"last_day {_short(numbers['last_day'])}")
        marked = f"**{outcome}**" if outcome in ("broke", "failed") else outcome
        steps = [_short(numbers[x]) if x in numbers else "" for x in ("dt", "dt_over_gravity")]
        lines.append([row.case.name, *steps, marked, ", ".join(texts)])
    remarks = [f"`{'`, `'.join(names)}` {reason}" for reason, names in reasons.items()]
    return "", ["case", "Δt [s]", "× 1/ρ", "outcome", "numbers"], lines, remarks


def _short(value: float | None, name: str = "") -> str:
    if value is None:
        return "none" if name == "symmetry_day" else "–"
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.4g}"
