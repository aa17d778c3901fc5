"""The map of regimes: which family of steppers is cheapest in which flow, on which mesh."""

from swe_sphere.studies.regimes.page import write_map
from swe_sphere.studies.regimes.places import RegimeMap, read_map

__all__ = ["RegimeMap", "read_map", "write_map"]
