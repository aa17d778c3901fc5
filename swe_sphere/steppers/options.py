"""How exactly a stepper solves its equations."""

from dataclasses import dataclass

from ..errors import ConfigError


@dataclass(frozen=True)
class SolverOptions:
    """How stage equations are solved.

    `tolerance`: largest residual, relative to the change of the state over the last step; solved
    for is the estimated truncation error of the step, where that is smaller (see `Motion`).
    `preconditioner`: a name of `PRECONDITIONERS`.  Raises ConfigError for a tolerance out of range.
    """

    tolerance: float
    preconditioner: str = "helmholtz"

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance < 1.0:
            raise ConfigError(f"the solver tolerance must be in [0, 1), not {self.tolerance}")
