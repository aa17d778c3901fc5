"""Linear algebra on device vectors: weighted inner products and flexible GMRES."""

from .gmres import FlexibleGMRES, Operator
from .result import LinearResult, Status
from .space import VectorSpace

__all__ = ["FlexibleGMRES", "LinearResult", "Operator", "Status", "VectorSpace"]
