"""How exactly each linear system of a Newton iteration is solved."""

from collections.abc import Callable
from dataclasses import dataclass

from swe_sphere.errors import ConfigError

Forcing = Callable[[float, float | None, float | None, float], float]
"""The relative tolerance eta of the next linear solve, |F + J d| <= eta |F|, from |F_k|, |F_(k-1)|,
eta_(k-1) (None at the first) and the norm that Newton is to reach."""


@dataclass(frozen=True)
class EisenstatWalker:
    """Choice 2: eta_k = gamma (|F_k| / |F_(k-1)|)^alpha, doi:10.1137/0917003 (1996), eq. (2.6).

    first: eta_0.  cap: largest eta; one well below the customary 0.9 saves Newton iterations in
    time stepping, where residual evaluations and set-ups are dear.  Safeguard of the paper: not
    below gamma eta_(k-1)^alpha where that exceeds `threshold`.  guard: never solve beyond this part
    of what Newton still needs (Kelley, Solving Nonlinear Equations with Newton's Method, 2003, eq.
    3.3); it may exceed the cap.
    """

    gamma: float = 0.9
    alpha: float = 2.0
    first: float = 0.1
    cap: float = 0.1
    threshold: float = 0.1
    guard: float = 0.5

    def __post_init__(self) -> None:
        """Raises ConfigError for parameters with which Newton cannot converge."""
        inside = all(0.0 < value < 1.0 for value in (self.first, self.cap))
        if not (inside and 0.0 < self.gamma <= 1.0 < self.alpha <= 2.0 and 0.0 <= self.guard < 1.0):
            raise ConfigError(
                "forcing terms need first and cap in (0, 1), gamma in (0, 1], alpha in (1, 2] and "
                f"guard in [0, 1), not {self}"
            )

    def __call__(
        self, norm: float, previous_norm: float | None, previous: float | None, target: float
    ) -> float:
        """See `Forcing`."""
        eta = self.first
        if previous is not None and previous_norm is not None:
            eta = self.gamma * (norm / previous_norm) ** self.alpha
            safeguard = self.gamma * previous**self.alpha
            if safeguard > self.threshold:
                eta = max(eta, safeguard)
        return max(min(eta, self.cap), self.guard * target / norm)
