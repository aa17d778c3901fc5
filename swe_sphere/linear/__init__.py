"""Linear algebra on device vectors: weighted inner products and Krylov solvers."""

from .conjugate_gradients import ConjugateGradients
from .gmres import FlexibleGMRES
from .result import LinearResult, Operator, Status
from .space import VectorSpace

__all__ = [
    "ConjugateGradients",
    "FlexibleGMRES",
    "LinearResult",
    "Operator",
    "Status",
    "VectorSpace",
]
