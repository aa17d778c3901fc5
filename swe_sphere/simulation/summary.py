"""What a run comes to: the numbers of `--json`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from swe_sphere.simulation.config import RunConfig

__all__ = ["Summary", "failed_summary"]

KEYS = (
    "scene", "stepper", "ne", "np", "dt", "steps", "days", "wall_seconds", "compile_seconds",
    "rhs_evaluations", "newton_iterations", "krylov_iterations", "l1_h", "l2_h", "linf_h",
    "l2_v", "mass_drift", "energy_drift", "enstrophy_drift", "completed", "reason",
)  # fmt: skip
"""The keys that are always there, in this order; more follow."""


@dataclass(frozen=True)
class Summary:
    """How a run went."""

    numbers: dict[str, object] = field(default_factory=dict)
    """Values by the names of the JSON line."""
    completed: bool = False
    reason: str | None = None
    """Why the run stopped early, in words; None if it did not."""
    exit_status: int = 0

    def __getitem__(self, name: str) -> object:
        """A value of the JSON line, None where there is none."""
        return self.as_dict().get(name)

    def as_dict(self) -> dict[str, object]:
        """All values of the JSON line; None for what is missing or not finite."""
        values = {**self.numbers, "completed": self.completed, "reason": self.reason}
        ordered = dict.fromkeys(KEYS) | values
        return {name: _plain(value) for name, value in ordered.items()}

    def as_json(self) -> str:
        """The JSON line."""
        return json.dumps(self.as_dict(), allow_nan=False)


def failed_summary(values: Mapping[str, object], reason: str, exit_status: int) -> Summary:
    """The summary of a run that never began: what was asked for, as far as it is known."""
    asked = {name: values.get(name) for name in ("scene", "stepper", "ne", "np")}
    asked["stepper"] = asked["stepper"] or RunConfig.model_fields["stepper"].default
    return Summary(asked, completed=False, reason=reason, exit_status=exit_status)


def _plain(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
