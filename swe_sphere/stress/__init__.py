"""Stress trials: hard runs with criteria decided beforehand, for every stepper."""

from swe_sphere.stress.groups import GROUPS, choose
from swe_sphere.stress.page import page
from swe_sphere.stress.result import Result, judge, try_out
from swe_sphere.stress.store import Store
from swe_sphere.stress.trial import Bound, Group, Trial

__all__ = ["GROUPS", "Bound", "Group", "Result", "Store", "Trial", "choose", "judge", "page",
           "try_out"]  # fmt: skip
