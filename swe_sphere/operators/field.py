"""Nodal values as every element has them for itself."""

from dataclasses import dataclass

import warp as wp


@dataclass(frozen=True)
class Field:
    """Values at the nodes of each element, or what elements leave for DSS there.

    `values` (groups + 1, np*np, unknowns) of SIMD registers, and the same memory as numbers in
    `flat`.
    """

    values: wp.array
    flat: wp.array
