"""The map of regimes: which family of steppers is cheapest in which flow, on which mesh."""

from swe_sphere.studies.regimes.map_page import write_map
from swe_sphere.studies.regimes.points import Point, read_points

__all__ = ["Point", "read_points", "write_map"]
