"""Inexact Newton-Krylov solver of nonlinear equations on device vectors."""

from .forcing import ConstantForcing, EisenstatWalker, Forcing
from .line_search import Backtracking
from .newton import NewtonHistory, NewtonKrylov, NewtonResult, Problem

__all__ = [
    "Backtracking",
    "ConstantForcing",
    "EisenstatWalker",
    "Forcing",
    "NewtonHistory",
    "NewtonKrylov",
    "NewtonResult",
    "Problem",
]
