"""The effects a scene may call for: small frozen dataclasses.

An effect says *what* acts on the fluid and with which coefficients.  Those with derivatives name
the terms of the kernels that they switch on; those without bring their formulas along, and a scene
may define such of its own (`PointwiseEffect`).
"""

from swe_sphere.equations.effects.dissipation import (
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
    "DYNAMICS", "EFFECTS", "MASSES", "Drag", "Effect", "Forcing", "Hyperviscosity", "Linearised",
    "MomentumAdvection", "Orography", "PointwiseEffect", "PrescribedWind", "PressureGradient",
    "Relaxation", "Rotation", "Tracers", "Viscosity", "hyperviscosity_default",
]  # fmt: skip

DYNAMICS: tuple[Effect, ...] = (MomentumAdvection(), PressureGradient())
"""The effects of every scene that steps the wind."""

EFFECTS: dict[str, type[Effect]] = {
    cls.name: cls
    for cls in (
        MomentumAdvection, PressureGradient, Rotation, Orography, PrescribedWind, Forcing, Tracers,
        Linearised, Viscosity, Hyperviscosity, Drag, Relaxation,
    )
}  # fmt: skip
"""All effects of the package by name."""
