"""Explicit stages for waves alone: of fourth order, and stable for nearly as long as there are any.

`benchmarks/tracer_stages.py` derives the numbers.
"""

import math

from swe_sphere.errors import Unstable

Stages = tuple[float, ...]
"""f_i in m_i = m_0 + f_i tau A m_(i-1); the last is 1."""

_REACH: dict[float, Stages] = {
    2.8: (1 / 4, 1 / 3, 1 / 2, 1.0),
    4.6: (0.16904917667410368, 0.13380303671748228, 1 / 4, 1 / 3, 1 / 2, 1.0),
    6.2: (
        0.12480976664540724, 0.07662096184186656, 0.16667480464512058, 0.17018634951480482,
        1 / 4, 1 / 3, 1 / 2, 1.0,
    ),
    7.9: (
        0.09907015380844966, 0.04926610891320422, 0.12406549675252491, 0.10608279520348493,
        0.1659580170045138, 0.1832494363935329, 1 / 4, 1 / 3, 1 / 2, 1.0,
    ),
}  # fmt: skip
"""Stages by how far they reach: the largest stable tau times the spectral radius of A."""
LONGEST = max(_REACH)
MOST_PARTS = 1000
"""So many even out that a wind has grown beyond all bounds."""


def stages_for(reach: float) -> tuple[int, Stages]:
    """Into how many equal parts to divide a step of that reach, and the stages of each.

    Raises Unstable for so many that no step would ever end, and for a reach that is NaN.
    """
    if not reach <= MOST_PARTS * LONGEST:
        raise Unstable(
            f"tracers would take {reach / LONGEST:.4g} parts in a step, more than {MOST_PARTS}: the"
            " solution blows up; take a smaller dt or smaller tracer-steps"
        )
    parts = max(1, math.ceil(reach / LONGEST))
    # rounded, the product may fall short of what it was divided from
    return parts, next((f for far, f in _REACH.items() if parts * far >= reach), _REACH[LONGEST])
