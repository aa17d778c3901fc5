"""Steppers and bounds that several groups share."""

from __future__ import annotations

from swe_sphere.studies.stress.steppers import EXPLICIT, IMPLICIT, SPLIT
from swe_sphere.studies.stress.trial import Bound

__all__ = ["EXPLICIT", "IMPLICIT", "KINDS", "LONG", "MASS", "SOUND", "SPLIT", "bounded"]

KINDS = ("rk4", "ssprk3", "kg5", "leapfrog", "semi-implicit", "ars343", "bdf2", "tr-bdf2")
"""For long runs: all explicit ones, and of the others those that are recommended."""

LONG = ("rk4", "kg5", "leapfrog", "semi-implicit", "tr-bdf2")
"""For the longest runs."""

MASS = Bound("mass_drift", 1e-12, always=True)
"""Kept to round-off, in runs of up to tens of thousands of steps."""
SOUND = (MASS, Bound("min_depth", low=0.0, always=True))
"""Of every run, also of one that stops itself: mass is kept, and no negative depth is shown."""


def bounded(wind: float) -> tuple[Bound, ...]:
    """Sound, and the wind never above a speed [m s-1]."""
    return (*SOUND, Bound("max_wind", wind))
