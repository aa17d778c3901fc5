"""Stress trials: hard runs with criteria decided beforehand, for every stepper."""

from swe_sphere.studies.stress.methods import tried_beside, try_out
from swe_sphere.studies.stress.trial import OUTCOMES, Group, Result, Trial, choose, groups, judge
from swe_sphere.studies.stress.trial_page import Store, page

__all__ = ["OUTCOMES", "Group", "Result", "Store", "Trial", "choose", "groups", "judge", "page",
           "tried_beside", "try_out"]  # fmt: skip
