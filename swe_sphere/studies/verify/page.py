"""The verification page: all rows as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from swe_sphere.machine import versions
from swe_sphere.studies.verify.cases import FAMILIES
from swe_sphere.studies.verify.verdict import NORMS, Check, Row

__all__ = ["page"]

HEAD = """# Verification

Every scene on a ladder of resolutions: errors against its exact solution, or against an independent
model where there is none, and what the discrete equations must keep. Made by

    {command}

Unless said otherwise: float64, rk4 with its own safe step, no dissipation, errors at the end of 5
days. l1, l2, linf are the normalised norms of Williamson et al. (1992); h is the depth, or the free
surface where the bottom is not flat; v is the wind vector. The order is that of l2 since the row
before, for h and for v: in 1/ne, in 1/(np - 1) (where it should grow), or in the time step.

Every norm has an upper bound, 1.2 to 1.35 times what was found when the row was made; orders have
a lower bound; time errors of steppers and the constants of scenes are held in narrow bands; mass
must be kept to 1e-13 by every run. The last column says how much of its tightest bound a row uses:
above 1 it fails.

**{verdict}** {count} rows in {seconds:.0f} s of stepping; largest drift of mass where it is
conserved, float64: {mass:.1e}; Python {python}, Warp {warp}.
"""

MASS = "mass_drift"
"""Told once for all rows, unless it is out of bounds."""

LABELS = {
    "l2_q_gaussian_hills": "l2(hills)",
    "l2_q_cosine_bells": "l2(bells)",
    "l2_q_correlated": "l2(correlated)",
    "l2_q_slotted_cylinders": "l2(cylinders)",
    "order_q": "order(hills)",
    "beyond_bounds": "out of bounds by",
    "tracer_mass_drift": "tracer mass drift",
    "mass_drift": "mass drift",
    "energy_drift": "energy drift",
    "order_energy": "order",
    "enstrophy_drift": "potential enstrophy drift",
    "max_v": "largest northward wind [m/s]",
    "max_speed": "largest wind [m/s]",
    "rms_h": "rms error of h [m]",
    "max_h": "largest error of h [m]",
    "l2_vorticity": "l2(vorticity)",
    "decorrelation": "1 - correlation of vorticity",
    "mean_depth": "mean depth [m]",
    "energy": "mean energy [m³/s²]",
    "enstrophy": "potential enstrophy [1/(m s²)]",
    "max_wind": "largest wind [m/s]",
    "rms_coriolis": "rms of f [1/s]",
    "mean_bottom": "mean bottom [m]",
    "area": "error of the sphere's area",
}
"""Quantities in words, where the name does not say enough."""


def page(rows: Sequence[Row], command: str) -> str:
    """The page (Markdown) of these rows, in the order of the families."""
    failed, found = sum(not row.passed for row in rows), versions()
    head = HEAD.format(
        command=command,
        verdict=f"{failed} of" if failed else "All bounds hold:",
        count=f"{len(rows)} rows fail:" if failed else len(rows),
        seconds=sum(row.measure.seconds for row in rows),
        mass=max((_drift(row) for row in rows), default=0.0),
        python=found["python"],
        warp=found["warp"],
    )
    return "\n".join([head, *(line for line in _families(rows))]) + "\n"


def _drift(row: Row) -> float:
    """Relative drift of mass, 0 where it is not to be conserved to round-off."""
    kept = row.case.mass is not None and row.setting.precision == "float64"
    return abs(row.quantities[MASS]) if kept else 0.0


def _families(rows: Sequence[Row]) -> Iterator[str]:
    for title, cases in FAMILIES.items():
        names = {case.name for case in cases}
        mine = [row for row in rows if row.case.name in names]
        if not mine:
            continue
        yield f"## {title}\n"
        for name in dict.fromkeys(row.case.name for row in mine):
            yield from _case([row for row in mine if row.case.name == name])


def _case(rows: list[Row]) -> Iterator[str]:
    case = rows[0].case
    yield f"**{case.name}** ({case.scene})" + (f": {case.title}\n" if case.title else "\n")
    columns = [name for name in _NUMBERS if any(name in _shown(row) for row in rows)]
    heads = [_NUMBERS[name] for name in columns]
    others = any(_others(row) for row in rows)
    heads = ["ne", "np", "Δt [s]", *heads, *["other"] * others, "of bound"]
    yield "| " + " | ".join(heads) + " |"
    yield "|" + "---|" * len(heads)
    for row in rows:
        yield "| " + " | ".join(_cells(row, columns, others)) + " |"
    yield ""
    yield from _remarks(rows)


_NUMBERS = {name: f"{name[:-2]}({name[-1]})" for name in NORMS} | {
    "order": "order(h)",
    "order_v": "order(v)",
}
"""Quantities that have a column of their own, and its head."""


def _cells(row: Row, columns: list[str], others: bool) -> Iterator[str]:
    setting = row.setting
    yield f"{setting.ne}"
    yield f"{setting.np}"
    yield f"{row.measure.dt:.4g}" if setting.days else "-"
    shown = _shown(row)
    for name in columns:
        yield _number(name, shown[name]) if name in shown else ""
    if others:
        yield "; ".join(_others(row))
    yield f"{row.used:.2f} {'✓' if row.passed else '**fails**'}"


def _shown(row: Row) -> dict[str, float]:
    """What stands in columns: what is bounded, and all norms if one of them is."""
    bounded = {check.quantity for check in row.checks}
    orders = {name for name in ("order", "order_v") if bounded & set(NORMS)}
    wanted = bounded | orders
    return {name: x for name, x in row.quantities.items() if name in wanted and name in _NUMBERS}


def _others(row: Row) -> list[str]:
    """Numbers without a column."""
    return [
        f"{_label(check.quantity)} {_number(check.quantity, check.obtained)}{_bound(check)}"
        for check in row.checks
        if check.quantity not in _NUMBERS and (check.quantity != MASS or not check.passed)
    ]


def _bound(check: Check) -> str:
    if math.isinf(check.low):
        return f" (≤ {check.high:.3g})"
    return f" (≥ {check.low:.3g})" if math.isinf(check.high) else ""


def _remarks(rows: list[Row]) -> Iterator[str]:
    lines = [
        f"* {_label(figure.quantity)}: {_number(figure.quantity, row.quantities[figure.quantity])}"
        f" here, {figure.value:.4g} published ({figure.source})."
        for row in rows
        for figure in row.rung.figures
    ]
    if rows[0].case.note:
        lines.append(f"* {rows[0].case.note[0].upper()}{rows[0].case.note[1:]}.")
    yield from lines
    if lines:
        yield ""


def _label(name: str) -> str:
    return LABELS.get(name) or _NUMBERS.get(name, name)


def _number(name: str, value: float) -> str:
    if name.startswith("order"):
        return f"{value:.1f}"
    return f"{value:.7g}" if name in EXACT else f"{value:.2e}"


EXACT = ("mean_depth", "energy", "enstrophy", "max_wind", "rms_coriolis", "mean_bottom")
"""Numbers worth all their digits."""
