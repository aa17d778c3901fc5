"""Functions of the small matrix of a Krylov basis, and how far it reaches."""

import math

import numpy as np
import scipy

from swe_sphere.arrays import Array

APART = 16
"""Looks at the error are a part of the basis apart: one over this, of the vectors there are."""


class SmallMatrix:
    """H (m + 1, m) with A V_m = V_(m+1) H, which grows by a column at a time, up to `size`."""

    def __init__(self, size: int) -> None:
        self._entries = np.zeros((size + 1, size))
        self.columns = 0

    def append(self, above: Array, below: float) -> None:
        """Add a column: its last entries down to the diagonal, others being 0, and that below."""
        j = self.columns
        self._entries[j + 1 - len(above) : j + 1, j] = above
        self._entries[j + 1, j] = below
        self.columns = j + 1

    def phi(self, order: int, t: float) -> tuple[Array, float]:
        """Coefficients (m + 1,) of t^order phi_order(t A) v_0, and an estimate of the error.

        phi_k of t H and the one after it come from one exponential (Sidje 1998, Expokit): the last
        entry of the latter, times the last of H, is about the error of the basis of m vectors, and
        here the coefficient of one vector more.
        """
        m = self.columns
        matrix = np.zeros((m + order + 1, m + order + 1))
        matrix[:m, :m] = t * self._entries[:m, :m]
        matrix[0, m] = 1.0
        matrix[range(m, m + order), range(m + 1, m + order + 1)] = 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            found = scipy.linalg.expm(matrix)
        last = t * self._entries[m, m - 1] * found[m - 1, m + order]
        return t**order * np.append(found[:m, m + order - 1], last), t**order * abs(float(last))

    def radius(self) -> float:
        """About the spectral radius of the skew part of A, for a basis by short recurrences."""
        m = self.columns
        couplings = np.diag(self._entries, -1)[: m - 1] - np.diag(self._entries, 1)[: m - 1]
        return float(couplings.mean()) if m > 1 else 0.0

    def next_look(self, t: float) -> int:
        """Columns with which it is worth looking whether the basis reaches t [s].

        Waves are resolved by no fewer vectors than the angle that the fastest turns.
        """
        least = self.columns + 2 + self.columns // APART
        return max(least, math.ceil(t * self.radius()))
