"""What a run comes to: the numbers of `--json`, and the lines of the table."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any, TypeVar

from swe_sphere.simulation.config import RunConfig
from swe_sphere.simulation.diagnostics import DIAGNOSTICS

T = TypeVar("T")

KEYS = (
    "scene", "stepper", "ne", "np", "dt", "steps", "days", "wall_seconds", "compile_seconds",
    "rhs_evaluations", "newton_iterations", "krylov_iterations", "l1_h", "l2_h", "linf_h",
    "l2_v", "mass_drift", "energy_drift", "enstrophy_drift", "completed", "reason",
)  # fmt: skip
"""The keys that are always there, in this order; more follow."""

GROUPS = {
    "error of depth": {"l1": "l1_h", "l2": "l2_h", "linf": "linf_h"},
    "error of wind": {"l1": "l1_v", "l2": "l2_v", "linf": "linf_v"},
    "drift": {"mass": "mass_drift", "energy": "energy_drift", "enstrophy": "enstrophy_drift"},
    "mean": {"vorticity": "total_vorticity", "divergence": "total_divergence"},
    "Courant number": {"gravity": "courant_gravity", "advective": "courant_advective"},
    "largest wind [m/s]": {"": "max_wind"},
}
"""Rows of the table: what stands in them, and the names in the JSON line."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    status: str = "completed"
    """completed, refused (before the first step), unstable, solver-failed, timed-out, interrupted,
    failed (the disk, a function of the user's)."""
    reason: str | None = None
    """Why the run stopped early, in words; None if it did not."""
    exit_status: int = 0

    @property
    def completed(self) -> bool:
        """Whether the run came to its end."""
        return self.status == "completed"


@dataclass(frozen=True)
class Summary(Outcome):
    """How a run went, and how it ended."""

    numbers: dict[str, Any] = field(default_factory=dict)
    """Values by the names of the JSON line."""

    def __getitem__(self, name: str) -> Any:
        """A value of the JSON line, None where there is none."""
        return self.as_dict().get(name)

    def __iter__(self) -> Iterator[str]:
        """Names of the values."""
        return iter(self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """All values of the JSON line; None for what is missing or not finite."""
        told = {"completed": self.completed, "reason": self.reason, "status": self.status}
        ordered = {**dict.fromkeys(KEYS), **self.numbers, **told}
        return {name: finite(value) for name, value in ordered.items()}

    def as_json(self) -> str:
        """The JSON line."""
        return json.dumps(self.as_dict(), allow_nan=False)

    @property
    def title(self) -> str:
        """Scene and stepper."""
        scheme = "" if self["scheme"] == self["stepper"] else f" ({self['scheme']})"
        return f"{self['scene']} with {self['stepper']}{scheme}"

    def rows(self) -> Iterator[tuple[str, str]]:
        """The lines of a table: what, and its values."""
        n = self.as_dict()
        yield "scene", str(n["title"])
        ended = self.status if self.status in ("completed", "not begun") else "stopped early"
        yield "result", f"{ended} at day {n['days']:.6g} after {n['steps']} steps"
        yield "mesh", f"ne {n['ne']}, np {n['np']}" + _stretched(n["stretch"])
        yield "time step", _step(n)
        yield "stability limit", "none" if n["stable_dt"] is None else f"{n['stable_dt']:.5g} s"
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
    """The summary of a run that never began: what was asked for, as far as it is known."""
    asked = {name: values.get(name) for name in ("scene", "stepper", "ne", "np")}
    asked["stepper"] = asked["stepper"] or RunConfig.model_fields["stepper"].default
    return Summary("refused" if exit_status == 2 else "failed", reason, exit_status, asked)


def html_table(title: str, rows: list[tuple[str, str]]) -> str:
    """A table for notebooks."""
    cells = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def _tracer(n: dict[str, Any], name: str) -> str:
    """Errors, as far as they are known, range and drift of the mass."""
    names = ("l1", "l2", "linf", "min", "max", "mass_drift")
    told = {label.replace("_", " "): n.get(f"{label}_q_{name}") for label in names}
    return ", ".join(f"{label} {x:.3g}" for label, x in told.items() if x is not None)


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
    """The value; None for a number that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
