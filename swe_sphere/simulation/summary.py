"""How a run ended, its numbers for `--json`, and the lines of its table."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any, TypeVar

from swe_sphere.errors import ConfigError, RunFailed, SweError, in_one_line
from swe_sphere.planet import DAY
from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import DIAGNOSTICS
from swe_sphere.simulation.loop import Interrupted

T = TypeVar("T")

KEYS = (
    "scene", "stepper", "ne", "np", "dt", "steps", "days", "wall_seconds", "compile_seconds",
    "rhs_evaluations", "newton_iterations", "krylov_iterations", "l1_h", "l2_h", "linf_h",
    "l2_v", "mass_drift", "energy_drift", "enstrophy_drift", "completed", "reason",
)  # fmt: skip
"""Keys that every JSON line has, in this order; more follow."""

GROUPS = {
    "error of depth": {"l1": "l1_h", "l2": "l2_h", "linf": "linf_h"},
    "error of wind": {"l1": "l1_v", "l2": "l2_v", "linf": "linf_v"},
    "drift": {"mass": "mass_drift", "energy": "energy_drift", "enstrophy": "enstrophy_drift"},
    "mean": {"vorticity": "total_vorticity", "divergence": "total_divergence"},
    "Courant number": {"gravity": "courant_gravity", "advective": "courant_advective"},
    "largest wind [m/s]": {"": "max_wind"},
}
"""Rows of the table: labels and names in the JSON line."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    status: str = "completed"
    """completed, not begun, refused (before the first step), unstable, solver-failed, timed-out,
    interrupted, or failed (the disk, a user-defined function)."""
    reason: str | None = None
    """Why the run stopped early, in words; None if it did not."""
    exit_status: int = 0

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return self.status == "completed"

    @property
    def is_sound(self) -> bool:
        """Whether the state is one of the solution."""
        return self.status in ("not begun", "completed", "timed-out", "interrupted")


INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""
BREAKDOWNS = (ArithmeticError, ValueError, MemoryError)
"""Errors of libraries that are given a state that is not finite, or too large a problem."""


def outcome_of(error: Exception, time: float) -> Outcome:
    """Return how an error ended a run at a time [s]."""
    text = in_one_line(error)
    if isinstance(error, Interrupted):
        reason = f"interrupted by {error} at day {time / DAY:.4g}"
        return Outcome("interrupted", reason, INTERRUPTED)
    if not isinstance(error, SweError):
        return Outcome("solver-failed", f"{type(error).__name__}: {text}", RunFailed.exit_status)
    # it is too late to refuse the run for what functions of the scene raise while it is stepped
    status = "failed" if isinstance(error, ConfigError) else error.status
    return Outcome(status, text, error.exit_status)


@dataclass(frozen=True)
class Summary(Outcome):
    """How a run ended, and its numbers."""

    numbers: dict[str, Any] = field(default_factory=dict)
    """Values by the names of the JSON line."""

    def __getitem__(self, name: str) -> Any:
        """Return a value of the JSON line, None where there is none."""
        return self.as_dict().get(name)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the values."""
        return iter(self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """Return all values of the JSON line; None for what is missing or not finite."""
        ended = {"completed": self.completed, "reason": self.reason, "status": self.status}
        ordered = {**dict.fromkeys(KEYS), **self.numbers, **ended}
        return {name: finite(value) for name, value in ordered.items()}

    def as_json(self) -> str:
        """Return the JSON line."""
        return json.dumps(self.as_dict(), allow_nan=False)

    @property
    def title(self) -> str:
        """Scene and stepper."""
        scheme = "" if self["scheme"] == self["stepper"] else f" ({self['scheme']})"
        return f"{self['scene']} with {self['stepper']}{scheme}"

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield the lines of a table: labels and values."""
        n = self.as_dict()
        yield "scene", str(n["title"])
        ended = self.status if self.status in ("completed", "not begun") else "stopped early"
        yield "result", f"{ended} at day {n['days']:.6g} after {n['steps']} steps"
        yield "mesh", f"ne {n['ne']}, np {n['np']}" + _stretched(n["stretch"])
        if n["dt"] is not None:
            yield "time step", _step(n)
            limit = self.numbers["stable_dt"]  # None where it has not been computed
            if limit is not None:
                yield "stability limit", f"{limit:.5g} s" if math.isfinite(limit) else "none"
        yield "machine", f"{n['device']}, {n['precision']}"
        yield "time", f"{n['wall_seconds']:.3g} s stepping, {n['compile_seconds']:.3g} s compiling"
        yield from _costs(n)
        for title, names in GROUPS.items():
            there = {label: n[name] for label, name in names.items() if n.get(name) is not None}
            if there:
                yield title, ", ".join(f"{label} {x:.3g}".strip() for label, x in there.items())
        for tracer in (key.removeprefix("min_q_") for key in n if key.startswith("min_q_")):
            yield f"tracer {tracer}", _tracer(n, tracer)
        for own in DIAGNOSTICS.values():
            if own.name in self.numbers:
                yield own.label, f"{self.numbers[own.name]:.5g}"

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"<Summary of {self.title}: {self.status}{reason}>"

    def _repr_html_(self) -> str:
        reason = [("why", self.reason)] if self.reason else []
        return html_table(self.title, [*self.rows(), *reason])


def failed_summary(values: Mapping[str, object], reason: str, exit_status: int) -> Summary:
    """Return the summary of a run that never began, with the requested values."""
    asked = {name: values.get(name) for name in ("scene", "stepper", "ne", "np")}
    asked["stepper"] = asked["stepper"] or RunConfig.model_fields["stepper"].default
    return Summary("refused" if exit_status == 2 else "failed", reason, exit_status, asked)


def html_table(title: str, rows: list[tuple[str, str]]) -> str:
    """Return a table for notebooks."""
    cells = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def _tracer(n: dict[str, Any], name: str) -> str:
    """Return the known errors, the range and the drift of the mass of a tracer."""
    names = ("l1", "l2", "linf", "min", "max", "mass_drift")
    values = {label.replace("_", " "): n.get(f"{label}_q_{name}") for label in names}
    return ", ".join(f"{label} {x:.3g}" for label, x in values.items() if x is not None)


def _costs(n: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "right-hand sides", str(n["rhs_evaluations"])
    if n["krylov_iterations"]:
        yield "iterations", f"{n['newton_iterations']} Newton, {n['krylov_iterations']} Krylov"
    if "accepted_steps" in n:
        yield "steps in these", f"{n['accepted_steps']}, {n['rejected_steps']} taken back"
    elif n["rejected_steps"]:
        yield "rejected steps", str(n["rejected_steps"])
    if n["setups"]:
        times = "once" if n["setups"] == 1 else f"{n['setups']} times"
        yield (
            "preconditioner",
            (
                f"{n.get('preconditioner', 'built in')}: {n['preconditioner_applications']}"
                f" applications, set up {times} in {n['setup_seconds']:.3g} s"
            ),
        )


def _stretched(factor: float) -> str:
    return "" if factor == 1.0 else f", refined {factor:g} times"


def _step(n: dict[str, Any]) -> str:
    text = f"{n['dt']:.6g} s ({n['dt_rule']})"
    if abs(n["dt"] - n["dt_wanted"]) > 1e-9 * n["dt"]:
        text += f", shortened from {n['dt_wanted']:.6g} s to fit the frames"
    return text


def finite(value: T) -> T | None:
    """Return the value; None for a number that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
