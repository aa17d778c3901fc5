"""Verdicts and pages from measured numbers: observed orders, bounds, outcomes, Markdown."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, groupby
from pathlib import Path

import pandas as pd

from swe_sphere.files.fingerprints import code_fingerprint, versions
from swe_sphere.settings.values import read_toml
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.summary import finite
from swe_sphere.studies.cases.case import NORMS, Case, Check, groups
from swe_sphere.studies.cases.measure import TIMES, Measure, Tick, measure
from swe_sphere.studies.jobs import in_processes
from swe_sphere.studies.pages import rendered
from swe_sphere.studies.record_store import STOPPED, Store

OUTCOMES = ("passed", "refused", "stopped", "broke", "failed")
QUANTITIES = read_toml(Path(__file__).with_name("quantities.toml"))
"""Labels and significant digits of quantities, and names of their observed orders."""
ORDERS = {name: of["order"] for name, of in QUANTITIES.items() if "order" in of}
"""Quantities that fall with refinement, and the names of their observed orders."""


@dataclass(frozen=True, eq=False)
class Row:
    """A case, its measured numbers, and the preceding row for observed orders."""

    case: Case
    measure: Measure
    before: "Row | None" = None
    """The preceding row of the same name; None for the first."""

    @cached_property
    def quantities(self) -> dict[str, float]:
        """All numbers, and the observed orders since the preceding row, named as in `ORDERS`."""
        numbers = {n: math.nan if x is None else x for n, x in self.measure.numbers.items()}
        if self.before is None or self.before._fineness == self._fineness:
            return numbers
        if self.case.along == "ne" and self.before.config.np != self.config.np:
            return numbers  # refined in two ways
        ratio = math.log(self._fineness / self.before._fineness)
        old, new = self.before.measure.numbers, self.measure.numbers
        return {
            order: math.log(abs(a / b)) / ratio
            for name, order in ORDERS.items()
            if (a := old.get(name)) and (b := new.get(name))
        } | numbers

    @property
    def _fineness(self) -> float:
        """ne, np - 1 or one over the time step: the quantity in which rows of a name differ."""
        ne, np = self.config.ne or 0, self.config.np or 0
        return {"ne": ne, "np": np - 1, "dt": 1.0 / self.dt}[self.case.along]

    @property
    def config(self) -> RunConfig:
        """Settings of the run."""
        return self.case.configured()

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self.measure.numbers.get("dt") or math.nan

    @property
    def seconds(self) -> float:
        """Wall time of the steps alone [s]."""
        return self.measure.numbers.get("step_seconds") or 0.0

    @cached_property
    def checks(self) -> list[Check]:
        """Every bound, those of orders not in the first row; an unmeasured quantity fails it."""
        checks = self.case.checks
        if self.before is None:
            checks = [check for check in checks if check.quantity not in ORDERS.values()]
        found = [(check, self.quantities.get(check.quantity, math.nan)) for check in checks]
        # an upper bound alone limits the absolute value
        return [replace(of, obtained=abs(x) if math.isinf(of.low) else x) for of, x in found]

    @property
    def used(self) -> float:
        """Largest fraction of a bound that is used, see `Check.used`."""
        return max((check.used for check in self.checks), default=0.0)

    @cached_property
    def _verdict(self) -> tuple[str, list[str]]:
        """The outcome, one of `OUTCOMES`, and the reasons for it."""
        status, reason, expect = self.measure.status, self.measure.reason, self.case.expect
        stopped = status in STOPPED
        if status != "completed" and not stopped:
            return "failed", [f"{status}: {reason}"]
        if not stopped and expect == "refuse":
            return "failed", ["it should have been refused or stopped, but ran to its end"]
        reasons = [str(x) for x in self.checks if (x.always or not stopped) and not x.holds]
        if reasons or (stopped and expect == "pass"):
            return ("broke" if expect == "break" else "failed"), [*reasons, reason]
        return {"completed": "passed", "refused": "refused"}.get(status, "stopped"), [reason]

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        return self._verdict[0]

    @property
    def reason(self) -> str:
        """Reason of the outcome; empty for a run that passed."""
        return "; ".join(filter(None, self._verdict[1]))

    @property
    def passed(self) -> bool:
        """True if the run reached its end within all its bounds."""
        return self.outcome == "passed"

    def as_dict(self) -> dict[str, object]:
        """Return the row in plain numbers and words; None for numbers that are not finite."""
        config, case = self.config, self.case
        values = {
            "case": case.name, "scene": case.scene, "title": case.title,
            "ne": config.ne, "np": config.np, "dt": self.dt,
            "days": 0.0 if case.method == "start" else config.days,
            "stepper": config.stepper, "seconds": self.seconds,
            "status": self.measure.status, "reason": self.measure.reason or None,
            "quantities": {n: x for n, x in self.quantities.items() if n not in TIMES},
            "checks": [
                {"quantity": check.quantity, "obtained": check.obtained, "low": check.low,
                 "high": check.high, "passed": check.holds}
                for check in self.checks
            ],
            "published": [
                {"quantity": quantity, "value": value, "source": source}
                for source, values in self.case.published.items()
                for quantity, value in values.items()
            ],
            "passed": self.passed,
        }  # fmt: skip
        return dict(finite(values))

    def as_result(self) -> dict[str, object]:
        """Return measure, outcome and bounds in words; None for numbers that are not finite."""
        return self.measure.model_dump() | {
            "numbers": finite(self.measure.numbers), "reason": self.reason,
            "stopped": self.measure.reason, "stepper": self.case.stepper, "outcome": self.outcome,
            "bounds": [check.limits for check in self.checks],
        }  # fmt: skip


def count_outcomes(rows: Iterable[Row]) -> dict[str, int]:
    """Return how many of the rows had each of the `OUTCOMES`."""
    counts = Counter(row.outcome for row in rows)
    return {name: counts[name] for name in OUTCOMES}


def run_cases(
    cases: Sequence[Case], known: Iterable[Measure] = (), store: Store[Measure] | None = None,
    jobs: int = 1, tick: Tick | None = None,
) -> Iterator[Row]:  # fmt: skip
    """Run the cases and yield their rows in order.

    Args:
        cases: The cases.
        known: Existing measures, which are not repeated.
        store: Store of new measures.
        jobs: Number of processes; with several, cases that are not timed are measured first.
        tick: Called with the progress in words.
    """
    found = {each.fingerprint: each for each in known}
    keep = store.add if store else (lambda measured: measured)
    beside = measured_beside(jobs, cases, found) if jobs > 1 else ()
    for count, measured in enumerate(beside, 1):
        found[measured.fingerprint] = keep(measured)
        if tick is not None:
            tick(f"{count} measured")
    before = None
    for case in cases:
        measured = found.get(case.fingerprint) or keep(measure(case, tick))
        follows = before is not None and before.case.name == case.name
        before = Row(case, measured, before if follows else None)
        yield before


def measured_beside(
    jobs: int, cases: Sequence[Case], known: Collection[str] = ()
) -> Iterator[Measure]:
    """Measure cases in parallel, except timed ones; one process measures all cases of a name.

    known: Fingerprints of cases that are not measured.  Raises the errors of `in_processes`.
    """
    left = [case for case in cases if not case.is_timed and case.fingerprint not in known]
    tasks = [[*group] for _, group in groupby(left, lambda case: case.name)]
    yield from chain.from_iterable(in_processes(jobs, _measuring, tasks))


def _measuring() -> Callable[[list[Case]], list[Measure]]:
    return lambda task: [measure(case) for case in task]


MASS = "mass_drift"
"""Shown once for all rows of a page, and in a row unless it is within its bound."""
COLUMNS = {name: f"{name[:-2]}({name[-1]})" for name in NORMS}
COLUMNS |= {"order": "order(h)", "order_v": "order(v)"}
"""Quantities with a separate column, and its head."""


def page(folder: str, rows: Sequence[Row], command: str) -> str:
    """Return the Markdown page of rows of "verification" or "stability"; command: its origin."""
    sections, summary = [], []
    # a rerun with a remedy counts only if it fails
    own = [row for row in rows if "+" not in row.case.name or row.outcome == "failed"]
    good = {row.case.name.partition("+")[0] for row in rows if row.passed}
    for group in groups(folder).values():
        if mine := [row for row in rows if row.case.group == group.name]:
            # of stability cases, show those that did not pass, and the same cases with a remedy
            hard = {row.case.name for row in mine if folder == "verification" or not row.passed}
            shown = [row for row in mine if row.case.name.partition("+")[0] in hard]
            table = pd.DataFrame(map(cells_of, shown))
            table = table.loc[:, (table != "").any()]
            reasons: dict[str, list[str]] = {}
            for row in mine:
                if row.reason and row.outcome not in ("refused", "stopped"):
                    reasons.setdefault(f"{row.outcome}: {row.reason}", []).append(row.case.name)
            sections.append((group, [*table], table.values, mine, reasons))
            numbers = [*count_outcomes({*own} & {*mine}).values(), len(group.cases) - len(mine)]
            summary.append([group.title, *map(str, numbers)])
    return rendered(
        "swe_sphere.studies.cases", f"{folder}.md.j2", _label, _quantity, sections=sections,
        command=command, counts=count_outcomes(own), code=code_fingerprint(), rows=rows, own=own,
        summary=(["group", *OUTCOMES, "not run"], summary), mass=max(map(_drift, rows), default=0),
        helped=sum(row.outcome == "stopped" and row.case.name in good for row in own),
        seconds=sum(row.quantities.get("seconds", 0.0) for row in rows), **versions(),
    )  # fmt: skip


def _drift(row: Row) -> float:
    """Return the relative drift of mass; 0 for a run in float32 or without a bound on it."""
    kept = any(check.quantity == MASS for check in row.checks)
    return abs(row.quantities.get(MASS, 0.0)) if kept and row.config.precision == "float64" else 0.0


def cells_of(row: Row) -> dict[str, str]:
    """Return the cells of a row by the heads of their columns; cells may be empty.

    They show bounded and reported quantities, and all norms and orders if one norm is shown.
    """
    case, numbers, checks = row.case, row.quantities, row.checks
    # the page states the largest drift of mass
    stated_once = {MASS} if any(x.quantity == MASS and x.holds for x in checks) else set()
    names = dict.fromkeys([*(check.quantity for check in checks), *case.report])
    names |= dict.fromkeys(COLUMNS if {*names} & {*NORMS} else ())
    names |= dict.fromkeys([] if row.passed else ["last_day"])
    shown = {name: _quantity(numbers[name], name) for name in names if name in numbers}
    others = [name for name in shown if name not in COLUMNS and name not in stated_once]
    return {
        "case": case.name, "ne": str(row.config.ne or ""), "np": str(row.config.np or ""),
        "Δt [s]": "" if math.isnan(row.dt) or case.method == "start" else f"{row.dt:.4g}",
        "× 1/ρ": _quantity(x, "") if (x := numbers.get("dt_over_gravity")) else "",
        **{head: shown.get(name, "") for name, head in COLUMNS.items()},
        "other quantities": ", ".join(f"{_label(name)} {shown[name]}" for name in others),
        "of bound": f"{row.used:.2f}" if math.isfinite(row.used) else "",
        "outcome": f"**{row.outcome}**" if row.outcome in ("broke", "failed") else row.outcome,
    }  # fmt: skip


def _label(name: str) -> str:
    return str(QUANTITIES.get(name, {}).get("label", COLUMNS.get(name, name)))


def _quantity(value: float | None, name: str) -> str:
    if value is None or not math.isfinite(value):
        return "none"
    if name.startswith("order"):
        return f"{value:.1f}"
    digits = QUANTITIES.get(name, {}).get("digits", 4)
    if name in NORMS or (digits == 4 and value and not 1e-2 <= abs(value) < 1e5):
        return f"{value:.2e}"
    return f"{value:.{digits}g}"
