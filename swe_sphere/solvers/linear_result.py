"""What a solver reports: never an exception, always a status, a history and one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import warp as wp

__all__ = ["LinearResult", "LinearSolve", "Operator", "Status"]

# An operator reads its first vector and writes its second.
Operator = Callable[[wp.array, wp.array], None]


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


@dataclass
class LinearSolve:
    """One solve of operator(x) = rhs under way.

    scale: norm of the right-hand side; target: residual norm that ends the solve; limit: iterations
    allowed; terms: size of the terms that the residual is the difference of; floor: residual norm
    that ends the solve after the first iteration.
    """

    operator: Operator
    precondition: Operator | None
    rhs: wp.array
    x: wp.array
    scale: float
    target: float
    limit: int
    iterations: int = 0
    terms: float = 0.0
    floor: float = 0.0
    history: list[float] = field(default_factory=list)

    def end(self, status: Status, message: str, roundoff: bool = False) -> LinearResult:
        """The result, its message led by the size of the residual."""
        relative = self.history[-1] / (self.scale or 1.0)
        line = f"{message} ({self.iterations} iterations, relative residual {relative:.1e})"
        return LinearResult(status, self.iterations, tuple(self.history), line, roundoff)
