"""Preconditioners by name, all behind one small interface."""

from collections.abc import Callable
from functools import partial
from typing import Any

import warp as wp

from swe_sphere.equations.effects import unknown_name
from swe_sphere.equations.model import Model
from swe_sphere.solvers.preconditioners.block_elimination import Helmholtz
from swe_sphere.solvers.preconditioners.inner import Direct, Jacobi, Multilevel
from swe_sphere.solvers.preconditioners.preconditioner import Preconditioner
from swe_sphere.solvers.preconditioners.schwarz import Schwarz
from swe_sphere.solvers.preconditioners.with_tracers import WithTracers

__all__ = ["PRECONDITIONERS", "Helmholtz", "Preconditioner", "make_preconditioner"]

PRECONDITIONERS: dict[str, Callable[[Model], Any]] = {
    "none": lambda model: None,
    "jacobi": partial(Helmholtz, inner=Jacobi),
    "helmholtz": partial(Helmholtz, inner=Multilevel),
    "helmholtz-schwarz": partial(Helmholtz, inner=Schwarz),
    "helmholtz-direct": partial(Helmholtz, inner=Direct, real=wp.float64),
}
"""Block elimination with the inverse of the Schur complement by: its diagonal (jacobi), coarse
correction and Chebyshev steps (helmholtz), overlapping patches (helmholtz-schwarz), sparse factors
(helmholtz-direct)."""


def make_preconditioner(name: str, model: Model) -> Preconditioner | None:
    """The preconditioner of that name for a model; None for "none".

    A scene with prescribed wind has no gravity waves and gets none.  Raises ConfigError, naming the
    nearest one, for an unknown name.
    """
    if name not in PRECONDITIONERS:
        raise unknown_name("preconditioner", name, PRECONDITIONERS)
    if model.scene.wind is not None:
        return None
    made: Preconditioner | None = PRECONDITIONERS[name](model)
    if made is None or model.tracers is None:
        return made
    return WithTracers(made, model.tracers.mixing_ratio())
