"""What every effect says of itself, so that nothing else need know which ones there are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from swe_sphere.arrays import Array
from swe_sphere.errors import ConfigError

if TYPE_CHECKING:
    from swe_sphere.mesh import Mesh

MASSES = frozenset({"mass", "tracers"})
"""The total mass of the fluid, and those of its tracers."""


@dataclass(frozen=True)
class Effect:
    """One thing that acts on the fluid; the fields of a subclass are its parameters."""

    name: ClassVar[str]
    """The name used on the command line and in files."""

    needs: ClassVar[str | None] = None
    """The function of the `Scene` that this effect, and only this effect, calls for."""

    terms: ClassVar[frozenset[str]] = frozenset()
    """Flags of `swe_sphere.kernels.Terms` (with derivatives) and `Pointwise` that it switches on:
    in the dissipation if it damps, else in the rest."""

    everywhere: ClassVar[frozenset[str]] = frozenset()
    """Flags that hold in all components of the right-hand side, as they say what the fields are."""

    constant: ClassVar[bool] = False
    """Whether what it brings is the same for all states, so that it has no derivative."""

    excludes: ClassVar[Mapping[str, str]] = {}
    """Names of effects that cannot act beside this one, and what to say then."""

    conserves: ClassVar[frozenset[str]] = frozenset()
    """What the effect leaves as it is all over the globe, of `MASSES`: implicit steppers restore
    the masses that all effects of a scene conserve, and leave the others to their solver.  (What
    forcing brings is known: see `Model.mean_source`.)"""

    dissipation: ClassVar[bool] = False
    """Whether the effect damps: the user may switch it on for any scene, and leapfrog schemes take
    it at the past level."""

    @property
    def diffuses(self) -> bool:
        """True for a linear damping with derivatives, which explicit steppers apply separately."""
        return bool(self.terms & {"diffusion", "biharmonic", "edge-penalty"})

    @property
    def degree(self) -> int | None:
        """Of the polynomial of the state that it is, but for derivatives in space; None if it is
        none."""
        return 1

    @property
    def differentiable(self) -> bool:
        """Whether the kernels have its derivative along any change of the state."""
        return True

    @property
    def absent(self) -> bool:
        """Whether the parameters make the effect vanish, so that it need not be computed."""
        return False

    def coefficients(self, mesh: Mesh) -> Mapping[str, float | Array]:
        """The numbers, and for point-wise effects fields (N,), that its terms read, by name."""
        return {}

    def damping(self, mesh: Mesh, squares: Array) -> Array | float:
        """Rate [s-1] at which it damps waves of the squared wavenumbers k^2 [m-2], if it does.

        What preconditioners of implicit steps know of it.
        """
        return 0.0

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(field.name for field in fields(cls))


def check_coefficient(label: str, value: float) -> None:
    """ConfigError for a coefficient that is negative or not finite."""
    if not (math.isfinite(value) and value >= 0.0):
        raise ConfigError(f"{label} must be finite and not negative, not {value}")
