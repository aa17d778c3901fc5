"""Steps that cannot be solved are taken in parts."""

from typing import Protocol

import warp as wp

from swe_sphere.errors import SolverFailed

SMALLEST_PART = 64
"""A step that cannot be solved is halved, and halved again, down to this part of it."""


class AnyLength(Protocol):
    """A stepper that attempts steps of any length, and accepts or repeats them."""

    name: str
    dt: float
    state: wp.array
    new: wp.array
    counters: dict[str, int]

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        ...

    def attempt(self, t: float, dt: float) -> str | None:
        """Write the state one step dt [s] after `state`, at t [s], to `new`.

        Returns what is wrong with it, in words; `state` has not changed before `accept`.
        """
        ...

    def accept(self, dt: float) -> None:
        """Make `new`, a step of dt [s] on, the present state."""
        ...


def step_in_parts(stepper: AnyLength) -> None:
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
