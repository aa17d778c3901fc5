"""Stress trials: hard runs with criteria decided beforehand, for every stepper."""

from swe_sphere.studies.stress.page import Store, page
from swe_sphere.studies.stress.result import OUTCOMES, Result, judge, try_out
from swe_sphere.studies.stress.trial import Group, Trial, choose, groups

__all__ = ["OUTCOMES", "Group", "Result", "Store", "Trial", "choose", "groups", "judge", "page",
           "try_out"]  # fmt: skip
