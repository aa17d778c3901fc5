"""The pages of verification and of stability, in Markdown."""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

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


def page(folder: str, rows: Sequence[Row], command: str) -> str:
    """Return the page of the rows of "verification" or "stability", made by a command."""
    sections, summary = [], []
    for family in families(folder).values():
        mine = [row for row in rows if row.case.family == family.name]
        if mine:
            table = pd.DataFrame(map(cells_of, mine))
            table = table.loc[:, (table != "").any()]
            reasons: dict[str, list[str]] = {}
            for row in mine:
                if row.reason:
                    reasons.setdefault(f"{row.outcome}: {row.reason}", []).append(row.case.name)
            cases = {row.case.name: row.case for row in mine}
            sections.append((family, [*table], table.values, mine, cases, reasons))
            numbers = [*count_outcomes(mine).values(), len(family.cases) - len(mine)]
            summary.append([f"[{family.title}](#{anchor(family.title)})", *map(str, numbers)])
    return rendered(
        "swe_sphere.studies.cases", f"{folder}.md.j2", _label, _quantity, sections=sections,
        command=command,
        summary=(["group", *OUTCOMES, "not run"], summary), count=len(rows),
        failed=sum(not row.passed for row in rows), mass=max(map(_drift, rows), default=0.0),
        stepping=sum(row.seconds for row in rows),
        seconds=sum(row.quantities.get("seconds", 0.0) for row in rows), **versions(),
    )  # fmt: skip


def _drift(row: Row) -> float:
    """Return the relative drift of mass, 0 where it is not conserved to round-off."""
    kept = any(check.quantity == MASS for check in row.checks)
    return abs(row.quantities.get(MASS, 0.0)) if kept and row.config.precision == "float64" else 0.0


def cells_of(row: Row) -> dict[str, str]:
    """Return the cells of a row by the heads of their columns, empty where there is nothing.

    They show what is bounded or reported, and all norms and orders if one of the norms is.
    """
    case, numbers, checks = row.case, row.quantities, row.checks
    # the introduction states the largest of those that hold
    told = {MASS} if any(x.quantity == MASS and x.holds for x in checks) else set()
    names = dict.fromkeys([*(check.quantity for check in checks), *case.report])
    names |= dict.fromkeys(COLUMNS if {*names} & {*NORMS} else ())
    names |= dict.fromkeys([] if row.passed else ["last_day"])
    shown = {name: _quantity(numbers[name], name) for name in names if name in numbers}
    others = [name for name in shown if name not in COLUMNS and name not in told]
    return {
        "case": case.name, "ne": str(row.config.ne or ""), "np": str(row.config.np or ""),
        "Δt [s]": "" if math.isnan(row.dt) or case.method == "start" else f"{row.dt:.4g}",
        "× 1/ρ": _quantity(x, "") if (x := numbers.get("dt_over_gravity")) else "",
        **{head: shown.get(name, "") for name, head in COLUMNS.items()},
        "other": ", ".join(f"{_label(name)} {shown[name]}" for name in others),
        "of bound": f"{row.used:.2f}" if math.isfinite(row.used) else "",
        "outcome": f"**{row.outcome}**" if row.outcome in ("broke", "failed") else row.outcome,
    }  # fmt: skip


@cache
def _quantities() -> dict[str, dict[str, Any]]:
    """Return labels, and digits worth showing, of quantities that need them."""
    return read_toml(Path(__file__).with_name("quantities.toml"))


def _label(name: str) -> str:
    return str(_quantities().get(name, {}).get("label", COLUMNS.get(name, name)))


def _quantity(value: float | None, name: str) -> str:
    if value is None or not math.isfinite(value):
        return "none"
    if name.startswith("order"):
        return f"{value:.1f}"
    digits = _quantities().get(name, {}).get("digits", 4)
    if name in NORMS or (digits == 4 and value and not 1e-2 <= abs(value) < 1e5):
        return f"{value:.2e}"
    return f"{value:.{digits}g}"
