"""How linear solvers begin, and what they report: always a status, a history and one line."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Self

import warp as wp

from swe_sphere.solvers.vector_space import VectorSpace

# An operator reads its first vector and writes its second.
Operator = Callable[[wp.array, wp.array], None]


class Status(Enum):
    """How a solve ended."""

    CONVERGED = "converged"
    STAGNATED = "stagnated"
    DIVERGED = "diverged"
    NAN = "NaN"


@dataclass
class LinearResult:
    """A solve of operator(x) = rhs, under way and after its end.

    scale: norm of the right-hand side; target: residual norm that ends the solve; limit: iterations
    allowed; guess: whether it began from an x other than 0; terms: size of the terms that the
    residual is the difference of.
    history: norm of the residual, in the norm of the space, at the start and after each iteration;
    within a cycle it is the one of the Arnoldi process, at a restart and where a tolerance comes
    near round-off it is recomputed from the solution.
    roundoff: the solution is as good as the arithmetic allows, which missed the tolerance; the
    status is CONVERGED then.
    """

    operator: Operator
    precondition: Operator | None
    rhs: wp.array
    x: wp.array
    scale: float
    target: float
    limit: int
    guess: bool = True
    iterations: int = 0
    terms: float = 0.0
    history: list[float] = field(default_factory=list)
    status: Status | None = None
    message: str = ""
    roundoff: bool = False

    def end(self, status: Status, message: str, roundoff: bool = False) -> Self:
        """Return this result with its status, and its message with the size of the residual."""
        relative = self.residual / (self.scale or 1.0)
        self.status, self.roundoff = status, roundoff
        self.message = f"{message} ({self.iterations} iterations, relative residual {relative:.1e})"
        return self

    @property
    def converged(self) -> bool:
        """Whether the status is CONVERGED."""
        return self.status is Status.CONVERGED

    @property
    def residual(self) -> float:
        """The last residual norm."""
        return self.history[-1]


class KrylovSolver(ABC):
    """Solver of A x = b; keep it, it allocates once."""

    space: VectorSpace

    def solve(
        self,
        operator: Operator,
        rhs: wp.array,
        x: wp.array,
        precondition: Operator | None = None,
        rtol: float = 1e-6,
        atol: float = 0.0,
        max_iterations: int = 200,
        floor: float = 0.0,
        scale: float | None = None,
        guess: bool = True,
    ) -> LinearResult:
        """Solve operator(x) = rhs (n,) from the guess x, which is replaced by the solution.

        operator(v, out) must be linear; precondition(r, out) is an approximate inverse of it, which
        may vary.  Both see vectors of this solver: they must not write to the first nor keep
        either.  Converged means |rhs - A x| <= max(rtol |rhs|, atol) [norm of the space]; a
        tolerance that the arithmetic cannot reach, 0 included, is met by a residual of round-off
        size, and the result then says `roundoff`.  floor: a residual that is worth no iteration
        after the first.  scale: |rhs| where it is known; guess: false where x holds none, for 0.
        Nothing that is not finite is ever added to x.
        """
        scale = self.space.norm(rhs) if scale is None else scale
        target = max(rtol * scale, atol)
        p = LinearResult(operator, precondition, rhs, x, scale, target, max_iterations, guess)
        if scale == 0.0 or not guess:
            self.space.clear(x)
        if scale == 0.0:
            p.history.append(0.0)
            return p.end(Status.CONVERGED, "the right-hand side is zero")
        p.history.append(self._true_residual(p) if math.isfinite(scale) else scale)
        if not math.isfinite(p.history[0]):
            return p.end(Status.NAN, "the right-hand side or the guess is not finite")
        if p.history[0] <= p.target:
            return p.end(Status.CONVERGED, "the guess is good enough")
        p.terms, p.target = max(scale, p.history[0]), max(p.target, floor)
        while p.status is None:
            self._cycle(p)
        return p

    @abstractmethod
    def _true_residual(self, p: LinearResult) -> float:
        """Put rhs - A x where iterations begin; returns its norm."""

    @abstractmethod
    def _cycle(self, p: LinearResult) -> None:
        """Iterate up to the next true residual; end the solve there if nothing is to be gained."""
