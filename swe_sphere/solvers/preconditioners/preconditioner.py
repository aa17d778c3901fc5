"""What every preconditioner does."""

from collections.abc import Mapping
from typing import Any, Protocol

import warp as wp
from numpy.typing import NDArray


class Preconditioner(Protocol):
    """Approximate inverse of I - tau J, J the Jacobian of the right-hand side."""

    @property
    def setup_seconds(self) -> float:
        """Wall time spent in `setup` so far [s]."""
        ...

    @property
    def setups(self) -> int:
        """Set-ups so far."""
        ...

    @property
    def applications(self) -> int:
        """Applications so far."""
        ...

    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; cheap when little has changed."""
        ...

    def apply(self, r: wp.array, out: wp.array) -> None:
        """out near (I - tau J)^-1 r, both (3N,)."""
        ...

    def memory(self) -> dict[str, NDArray[Any]]:
        """What the set-up in use was made for."""
        ...

    def restore(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Make the set-up again that `memory` tells of; where it tells of none, be as new."""
        ...
