"""Preconditioning of tracers beside the flow that carries them."""

from collections.abc import Mapping
from typing import Any

import warp as wp
from numpy.typing import NDArray

from swe_sphere.operators.transport_operator import MixingRatio
from swe_sphere.solvers.preconditioners.preconditioner import Preconditioner


class WithTracers(Preconditioner):
    """A preconditioner for wind and depth, which tracers then follow: z_hq = r_hq + q (z_h - r_h).

    That is block elimination with the gravity waves of the depth, -div(hq V) being q times
    -div(h V) but for the gradient of q, which is advection and left out here as it is for the
    depth.  A constant q gives z_hq = q z_h for r_hq = q r_h, and so for every Krylov vector: it
    stays constant to round-off, whatever the tolerance of the solver.
    """

    def __init__(self, flow: Preconditioner, ratio: MixingRatio) -> None:
        self._flow, self._ratio = flow, ratio

    def costs(self) -> dict[str, float]:
        """What the flow's has taken so far."""
        return self._flow.costs()

    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; mixing ratios are always its own."""
        self._flow.setup(state, tau)
        self._ratio.set(state)

    def apply(self, r: wp.array, out: wp.array) -> None:
        """out near (I - tau J)^-1 r, both states."""
        self._flow(r, out)
        self._ratio.follow(r, out)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """What the set-up in use was made for."""
        return self._flow.state_dict()

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Make that set-up again."""
        self._flow.load_state_dict(state)
