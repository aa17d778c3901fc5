"""Many runs of one scene: what accuracy costs in time, by stepper and step."""

from swe_sphere.studies.sweep.engine import run_sweep, sweep
from swe_sphere.studies.sweep.plots import SweepFigures
from swe_sphere.studies.sweep.runner import SweepWatcher
from swe_sphere.studies.sweep.sweep_plan import SweepPlan, make_plan

__all__ = ["SweepFigures", "SweepPlan", "SweepWatcher", "make_plan", "run_sweep", "sweep"]
