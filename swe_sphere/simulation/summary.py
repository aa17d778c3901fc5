"""The outcome of a run, its numbers for `--json`, and the lines of its table."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from swe_sphere import errors
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import DIAGNOSTICS, NAMES

ROWS = Path(__file__).with_name("summary.j2")


BREAKDOWNS = (ArithmeticError, ValueError, RuntimeError, MemoryError)
"""Errors of libraries that are given a state that is not finite, or too large a problem."""


@dataclass(frozen=True, repr=False)
class Summary(Mapping[str, Any]):
    """Outcome of a run, and the values of its JSON line by name; `print` shows them in a table."""

    status: str = "completed"
    """completed, not begun, running, refused (before the first step), unstable, solver-failed (or
    another numerical error), timed-out, interrupted, or failed (the disk, a custom function)."""
    reason: str | None = None
    """Why the run stopped early or its plot failed, in words; else None."""
    exit_status: int = 0
    numbers: dict[str, Any] = field(default_factory=dict)
    """Values by the names of the JSON line."""

    @property
    def completed(self) -> bool:
        """True if the run reached its end."""
        return self.status == "completed"

    @property
    def is_sound(self) -> bool:
        """True if the final state is a valid part of the solution."""
        return self.status in ("not begun", "completed", "timed-out", "interrupted")

    def __getitem__(self, name: str) -> Any:
        """Return a value, None if it is missing or not finite; KeyError for an unknown name."""
        if name not in (values := self.as_dict()):
            raise KeyError(str(errors.unknown_name("value of a summary", str(name), values)))
        return values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.as_dict())

    def __len__(self) -> int:
        return len(self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """Return all values of the JSON line; None for what is missing or not finite."""
        ended = {"completed": self.completed, "reason": self.reason, "status": self.status}
        return dict(finite({**dict.fromkeys(NAMES["keys"]), **self.numbers, **ended}))

    def as_json(self) -> str:
        """Return the JSON line."""
        return json.dumps(self.as_dict(), allow_nan=False)

    @property
    def title(self) -> str:
        """Scene and stepper."""
        scene, stepper, scheme = map(self.get, ("scene", "stepper", "scheme"))
        if scene is None:
            return "run"
        return f"{scene} with {stepper}" + ("" if scheme in (None, stepper) else f" ({scheme})")

    def rows(self) -> list[tuple[str, str]]:
        """Return the lines of a table: labels and values."""
        from jinja2 import Template  # slow to import

        n = self.as_dict()

        def listed(names: Mapping[str, str]) -> str:
            """Return labels and values of those `names` whose values are known."""
            known = {label: n[name] for label, name in names.items() if n.get(name) is not None}
            return ", ".join(f"{label} {value:.3g}".strip() for label, value in known.items())

        text = Template(ROWS.read_text(), trim_blocks=True, lstrip_blocks=True).render(
            n=n, numbers=self.numbers, status=self.status, limit=self.numbers.get("stable_dt"),
            listed=listed, own=[one for one in DIAGNOSTICS.values() if one.name in self.numbers],
            tracers=[name.removeprefix("min_q_") for name in n if name.startswith("min_q_")],
        )  # fmt: skip
        rows = (line.partition(" | ") for line in text.splitlines())
        return [(label, value) for label, _, value in rows if value]

    def all_rows(self) -> list[tuple[str, str]]:
        """Return the lines of the table, and why the run stopped early."""
        rows = self.rows() if "title" in self else [("result", self.status)]
        return rows + ([("why", self.reason)] if self.reason else [])

    def __str__(self) -> str:
        rows = self.all_rows()
        width = max(len(label) for label, _ in rows)
        return "\n".join([self.title, *(f"{a:{width}}  {b}" for a, b in rows)])

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"<Summary of {self.title}: {self.status}{reason}>"

    def _repr_html_(self) -> str:
        return html_table(self.title, self.all_rows())


def summary_of(error: Exception, time: float) -> Summary:
    """Return how an error ended a run at a time [s], without numbers."""
    text = errors.in_one_line(error)
    if isinstance(error, errors.Interrupted):
        return Summary(error.status, f"{error} at day {time / DAY:.4g}", error.exit_status)
    if not isinstance(error, errors.SweError):
        line = f"{type(error).__name__}: {text}"
        return Summary("solver-failed", line, errors.RunFailed.exit_status)
    # a ConfigError in a function of the scene comes too late to refuse the run
    status = "failed" if isinstance(error, errors.ConfigError) else error.status
    return Summary(status, text, error.exit_status)


def failed_summary(values: Mapping[str, object], reason: str, exit_status: int) -> Summary:
    """Return the summary of a run that never began, with the requested values."""
    asked = {name: values.get(name) for name in ("scene", "stepper", "ne", "np")}
    asked["stepper"] = asked["stepper"] or RunConfig.model_fields["stepper"].default
    return Summary("refused" if exit_status == 2 else "failed", reason, exit_status, asked)


def html_table(title: str, rows: list[tuple[str, str]]) -> str:
    """Return a table for notebooks."""
    cells = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def finite(value: Any) -> Any:
    """Return the value as JSON can hold it, with None for numbers in it that are not finite."""
    if isinstance(value, Mapping):
        return {name: finite(each) for name, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
