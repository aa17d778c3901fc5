"""Many runs of one scene: what accuracy costs in time, by stepper and step."""

from swe_sphere.studies.sweep.api import run_plan, sweep
from swe_sphere.studies.sweep.sweep_plan import SweepPlan, make_plan
from swe_sphere.studies.sweep.watcher import SweepWatcher

__all__ = ["SweepPlan", "SweepWatcher", "make_plan", "run_plan", "sweep"]
