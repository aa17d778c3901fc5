"""The steppers by what limits their steps."""

from __future__ import annotations

__all__ = ["EXPLICIT", "IMPLICIT", "SPLIT"]

EXPLICIT = ("rk4", "ssprk3", "kg5", "leapfrog")
SPLIT = ("semi-implicit", "ark2", "ars343")
IMPLICIT = (
    "implicit-euler", "crank-nicolson", "implicit-midpoint", "bdf2", "tr-bdf2", "sdirk3",
    "esdirk4", "gauss-legendre", "average-vector-field", "rosenbrock-w",
)  # fmt: skip
