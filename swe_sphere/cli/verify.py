"""`swe-sphere verify`: run the verification cases and judge them."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swe_sphere.errors import ConfigError

if TYPE_CHECKING:
    from swe_sphere.studies.verify import Row

__all__ = ["verify"]

PAGE = "verification.md"
NUMBERS = "verification.json"


def verify(
    quick: Annotated[
        bool, typer.Option("--quick", help="Only the cheap rows, in less than a minute.")
    ] = False,
    scenes: Annotated[
        str | None, typer.Option(metavar="A,B", help="Only these scenes, or cases by name.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR|FILE.md", help="Write the page; into a folder, numbers too."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one line of JSON.")] = False,
) -> int:
    """Measure errors, orders and invariants of the scenes; fail where a bound does not hold."""
    from swe_sphere.studies.verify import choose, page

    names = [name.strip() for name in scenes.split(",")] if scenes else []
    chosen = {case.name for case in choose(names)}
    files = _files(out)
    rows = _run(chosen, quick, quiet=as_json)
    if not rows:
        raise ConfigError(f"nothing of {scenes} is in the quick form: leave out --quick")
    result = {
        "passed": all(row.passed for row in rows),
        "quick": quick,
        "seconds": sum(row.measure.seconds for row in rows),
        "rows": [row.as_dict() for row in rows],
    }
    if files:
        files[0].write_text(page(rows, _command(quick, scenes, out)), encoding="utf-8")
    for file in files[1:]:
        file.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    typer.echo(json.dumps(result) if as_json else _conclusion(rows, files))
    return 0 if result["passed"] else 1


def _run(chosen: set[str], quick: bool, quiet: bool) -> list[Row]:
    """All rows, family by family; each family's table as soon as it is there."""
    from swe_sphere.studies.verify import FAMILIES
    from swe_sphere.studies.verify import verify as run_cases

    found: list[Row] = []
    for title, cases in FAMILIES.items():
        rows = list(run_cases([case for case in cases if case.name in chosen], quick))
        found += rows
        if rows and not quiet:
            _print(title, rows)
    return found


def _print(title: str, rows: Sequence[Row]) -> None:
    from rich.console import Console
    from rich.table import Column, Table

    heads = ("ne", "np", "Δt [s]", "l2(h)", "l2(v)", "order", "of bound")
    name = Column("case", min_width=max(len(row.case.name) for row in rows))
    table = Table(name, *heads, "", title=title)
    for row in rows:
        numbers, setting = row.quantities, row.setting
        cells = [f"{numbers[name]:.2e}" if name in numbers else "" for name in ("l2_h", "l2_v")]
        order = f"{numbers['order']:.1f}" if "order" in numbers else ""
        step = f"{row.measure.dt:.4g}" if setting.days else ""
        end = (f"{row.used:.2f}", "" if row.passed else f"FAILED: {_worst(row)}")
        style = "" if row.passed else "bold red"
        table.add_row(
            row.case.name, str(setting.ne), str(setting.np), step, *cells, order, *end, style=style
        )
    Console(markup=False, highlight=False).print(table)


def _worst(row: Row) -> str:
    """The bound that is missed by most."""
    check = max(row.checks, key=lambda check: check.used)
    low, high = f"{check.low:.6g} ≤ ", f" ≤ {check.high:.6g}"
    return (
        f"{check.obtained:.6g} is not {low * math.isfinite(check.low)}{check.quantity}"
        f"{high * math.isfinite(check.high)}"
    )


def _conclusion(rows: Sequence[Row], files: Sequence[Path]) -> str:
    failed = sum(not row.passed for row in rows)
    verdict = f"{failed} of {len(rows)} rows failed" if failed else f"all {len(rows)} rows passed"
    written = f"; written: {', '.join(map(str, files))}" if files else ""
    return verdict + written


def _files(out: Path | None) -> list[Path]:
    """The page, and in a folder the numbers; checked before anything is run."""
    if out is None:
        return []
    folder = out.parent if out.suffix == ".md" else out
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot write to {folder}: {error.strerror}") from None
    return [out] if out.suffix == ".md" else [out / PAGE, out / NUMBERS]


def _command(quick: bool, scenes: str | None, out: Path | None) -> str:
    words = ["swe-sphere verify", "--quick" * quick, f"--scenes {scenes}" if scenes else ""]
    return " ".join([*filter(None, words), f"--out {out}"])
