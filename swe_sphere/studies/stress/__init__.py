"""Stress trials: hard runs with criteria decided beforehand, for every stepper."""

from swe_sphere.studies.stress.groups import GROUPS, choose
from swe_sphere.studies.stress.page import page
from swe_sphere.studies.stress.result import Result, judge, try_out
from swe_sphere.studies.stress.store import Store
from swe_sphere.studies.stress.trial import Bound, Group, Trial

__all__ = ["GROUPS", "Bound", "Group", "Result", "Store", "Trial", "choose", "judge", "page",
           "try_out"]  # fmt: skip
