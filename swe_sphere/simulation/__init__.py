"""Stepping a scene: configuration, time plan, loop, health check, interruption."""

from swe_sphere.simulation.config import RunConfig, first_complaint, load_config, make_config
from swe_sphere.simulation.health import HealthCheck
from swe_sphere.simulation.interrupt import Interrupted, Interruption
from swe_sphere.simulation.loop import Loop
from swe_sphere.simulation.moment import Moment, Observer
from swe_sphere.simulation.plan import TimePlan, continued_plan, time_plan
from swe_sphere.simulation.setup import identity, make_mesh, make_model, make_scene
from swe_sphere.simulation.stepping import (
    StepChoice,
    accurate_step,
    choose_step,
    longest_step,
    stepper_options,
)

__all__ = [
    "HealthCheck",
    "Interrupted",
    "Interruption",
    "Loop",
    "Moment",
    "Observer",
    "RunConfig",
    "StepChoice",
    "TimePlan",
    "accurate_step",
    "choose_step",
    "continued_plan",
    "first_complaint",
    "identity",
    "load_config",
    "longest_step",
    "make_config",
    "make_mesh",
    "make_model",
    "make_scene",
    "stepper_options",
    "time_plan",
]
