"""Advice before a run: stepper, step and preconditioner for an error, by laws fitted to sweeps."""

from swe_sphere.studies.advice.advise import Advice, advise

__all__ = ["Advice", "advise"]
