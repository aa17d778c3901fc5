"""The effects a scene may call for: small frozen dataclasses.

An effect says *what* acts on the fluid and with which coefficients.  Those with derivatives name
the terms of the kernels that they switch on; those without bring their formulas along, and a scene
may define such of its own (`PointwiseEffect`).
"""

import importlib
import pkgutil
from collections.abc import Iterator

from swe_sphere.equations.effects.dissipation import (
    EdgePenalty,
    Hyperviscosity,
    Viscosity,
    hyperviscosity_default,
)
from swe_sphere.equations.effects.dynamics import (
    Forcing,
    Linearised,
    MomentumAdvection,
    Orography,
    PrescribedWind,
    PressureGradient,
    Rotation,
    Tracers,
)  # fmt: skip
from swe_sphere.equations.effects.effect import MASSES, Effect
from swe_sphere.equations.effects.pointwise_effect import Drag, PointwiseEffect, Relaxation

__all__ = [
    "DYNAMICS", "EFFECTS", "MASSES", "Drag", "EdgePenalty", "Effect", "Forcing", "Hyperviscosity",
    "Linearised", "MomentumAdvection", "Orography", "PointwiseEffect", "PrescribedWind",
    "PressureGradient", "Relaxation", "Rotation", "Tracers", "Viscosity", "hyperviscosity_default",
]  # fmt: skip

DYNAMICS: tuple[Effect, ...] = (MomentumAdvection(), PressureGradient())
"""The effects of every scene that steps the wind."""

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)


def _named(kind: type[Effect]) -> Iterator[tuple[str, type[Effect]]]:
    for each in kind.__subclasses__():
        if "name" in vars(each):
            yield each.name, each
        yield from _named(each)


EFFECTS = dict(_named(Effect))
"""All effects of the package by name."""
