"""What every preconditioner does."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import warp as wp
from numpy.typing import NDArray

from swe_sphere.equations.model import Model
from swe_sphere.registry import Registry

PRECONDITIONERS: "Registry[Preconditioner]" = Registry("preconditioner")
"""All preconditioners by name; a class with a `name` is entered where it is defined."""


def elimination_memory(ne: int, np: int, real: int = 4) -> float:
    """Memory [bytes] of block elimination on the device, in numbers of so many bytes."""
    return (4 + 8 * real) * 6.0 * (ne * np) ** 2 + (32 + 10 * real) * unique_nodes(ne, np)


def coarse_memory(ne: int, np: int) -> float:
    """Memory [bytes] of the coarse spaces and their operators while these are made."""
    more = 600 if np in (6, 12) else 0  # the smooth functions have a cell more on an edge
    return (1300 + 1600 / (np - 1) ** 2 + more) * unique_nodes(ne, np)


def unique_nodes(ne: int, np: int) -> float:
    """Nodes of a mesh, counted once."""
    return 6.0 * (ne * (np - 1)) ** 2 + 2.0


class Preconditioner(ABC):
    """Approximate inverse of I - tau J, J the Jacobian of the right-hand side."""

    name: ClassVar[str]
    """By which users call it; a class without a name of its own is a base of others."""

    setups, applications, setup_seconds = 0, 0, 0.0
    """Set-ups and applications so far, and wall time of the former [s]."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" in vars(cls):
            PRECONDITIONERS.add(cls)

    @classmethod
    def for_model(cls, model: Model) -> Self | None:
        """The one for a model; None where there is nothing to precondition with."""
        return cls(model)  # type: ignore[call-arg]

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """Memory [bytes] that it takes on that mesh; rather too much."""
        return elimination_memory(ne, np) + coarse_memory(ne, np)

    @abstractmethod
    def setup(self, state: wp.array, tau: float) -> None:
        """Prepare for the implicit step tau [s] at a state; cheap when little has changed."""

    def costs(self) -> dict[str, float]:
        """What it has taken so far: counts, and seconds of the set-ups."""
        return {
            "preconditioner_applications": self.applications,
            "setups": self.setups,
            "setup_seconds": self.setup_seconds,
        }

    def __call__(self, r: wp.array, out: wp.array) -> None:
        """`apply`, counted."""
        self.applications += 1
        self.apply(r, out)

    @abstractmethod
    def apply(self, r: wp.array, out: wp.array) -> None:
        """out near (I - tau J)^-1 r, both states."""

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """What the set-up in use was made for, that a restarted run makes the same one."""
        return {}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:  # noqa: B027 (optional)
        """Make that set-up again; where `state` tells of none, be as new."""


class Unpreconditioned(Preconditioner):
    """None at all."""

    name = "none"

    @classmethod
    def for_model(cls, model: Model) -> None:
        """None."""

    @classmethod
    def memory_estimate(cls, ne: int, np: int) -> float:
        """None [bytes]."""
        return 0.0

    def setup(self, state: wp.array, tau: float) -> None:
        """Nothing to prepare."""

    def apply(self, r: wp.array, out: wp.array) -> None:
        """out = r."""
        wp.copy(out, r)
