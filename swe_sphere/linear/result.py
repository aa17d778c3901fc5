"""What a solver reports: never an exception, always a status, a history and one line."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

__all__ = ["LinearResult", "Status"]


class Status(Enum):
    """How a solve ended."""

    CONVERGED = "converged"
    STAGNATED = "stagnated"
    DIVERGED = "diverged"
    NOT_A_NUMBER = "not a number"


@dataclass(frozen=True)
class LinearResult:
    """The end of a linear solve.

    history: norm of the residual, in the norm of the space, at the start and after each iteration;
    within a cycle it is the one of the Arnoldi process, at a restart and where a tolerance comes
    near round-off it is recomputed from the solution.
    roundoff: the solution is as good as the arithmetic allows, which missed the tolerance; the
    status is CONVERGED then.
    """

    status: Status
    iterations: int
    history: tuple[float, ...]
    message: str
    roundoff: bool = False

    @property
    def converged(self) -> bool:
        """Whether the status is CONVERGED."""
        return self.status is Status.CONVERGED

    @property
    def residual(self) -> float:
        """The last residual norm."""
        return self.history[-1]
