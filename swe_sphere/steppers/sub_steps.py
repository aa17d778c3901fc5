"""Steps that cannot be solved are taken in parts."""

from typing import TYPE_CHECKING

import warp as wp

from swe_sphere.errors import SolverFailed

if TYPE_CHECKING:
    from swe_sphere.steppers.variable_stepper import VariableStepper

SMALLEST_PART = 64
"""A step that cannot be solved is halved, and halved again, down to this part of it."""


def step_in_parts(stepper: "VariableStepper") -> None:
    """Take a step of `stepper.dt`, or as many equal parts of it as its solver needs.

    Raises SolverFailed, with the state as it was, where the smallest parts fail.
    """
    done, parts, start = 0, 1, stepper.state
    while done < parts:
        dt = stepper.dt / parts
        fault = stepper.attempt(stepper.time + done * dt, dt)
        if fault is None:
            stepper.accept(dt)
            done += 1
            continue
        start = wp.clone(stepper.state) if parts == 1 else start
        stepper.counters["rejected_steps"] += 1
        done, parts = 2 * done, 2 * parts
        if parts > SMALLEST_PART:
            wp.copy(stepper.state, start)
            raise SolverFailed(
                f"{stepper.name}: the step from {stepper.time:.0f} s cannot be solved even in "
                f"{parts // 2} parts: {fault}; choose a smaller --dt"
            )
