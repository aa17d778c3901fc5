"""Options of the stepper and the length of its steps, where the user leaves them open."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from swe_sphere.errors import ConfigError
from swe_sphere.planet import DAY, HOUR
from swe_sphere.settings import STEPPER, by_owner, convert
from swe_sphere.simulation.config import RunConfig

if TYPE_CHECKING:
    from swe_sphere.arrays import Array
    from swe_sphere.mesh import Mesh
    from swe_sphere.steppers import Stepper

UNLIMITED = 1e7
"""A limit above this [s] is none."""


@dataclass(frozen=True)
class StepChoice:
    """A time step before it is fitted to the frames."""

    dt: float
    """[s]"""
    rule: str
    """How it was chosen, in words."""


def choose_step(
    asked: float | None,
    days: float,
    stable_dt: float,
    safety: float,
    accurate: StepChoice,
    cautious: bool = False,
) -> StepChoice:
    """The step asked for [s], else one within the stability limit or, without one, an accurate one.

    days: length of the run, which an automatic step does not exceed; stable_dt: stability limit
    [s], infinite where there is none; safety: part of it to use; accurate: see `accurate_step`;
    cautious: whether an automatic step shall be an accurate one within the limit too.
    """
    if asked is not None:
        return StepChoice(asked, "as given")
    if stable_dt < UNLIMITED and not (cautious and safety * stable_dt > accurate.dt):
        return StepChoice(min(safety * stable_dt, days * DAY), f"{safety:g} of the stability limit")
    return replace(accurate, dt=min(accurate.dt, days * DAY))


def longest_step(config: RunConfig, days: float) -> StepChoice:
    """The outer step of an adaptive run of that length [days]: the time between frames."""
    interval = DAY if config.every is None else config.every * HOUR
    return StepChoice(min(interval, days * DAY), "time between frames, in which steps adapt")


def accurate_step(kind: type[Stepper], mesh: Mesh, fields: dict[str, Array]) -> StepChoice:
    """The step in which the fastest wind u, v (N,) [m s-1] passes so many of the finest spacings.

    The number is the stepper's `courant`, and the step its `longest` at the most.
    """
    wind, longest = float(np.hypot(fields["u"], fields["v"]).max()), kind.longest
    dt = min(longest, kind.courant * mesh.spacing()[0] / wind) if wind > 0.0 else longest
    return StepChoice(dt, f"advective Courant number {kind.courant:g}, at most {longest:g} s")


def stepper_options(kind: type[Stepper], config: RunConfig) -> dict[str, Any]:
    """Everything the stepper is built with besides model and dt: as asked for, else its defaults.

    Raises:
        ConfigError: the stepper takes no such option, or not that value.
    """
    known = inspect.signature(kind, eval_str=True).parameters
    # a default that depends on the scheme is an attribute of its class
    defaults = {
        name: getattr(kind, f"default_{name}", parameter.default)
        for name, parameter in known.items()
    }
    options: dict[str, Any] = {
        name: default
        for name, default in defaults.items()
        if isinstance(default, (bool, int, float, str))
    }
    for name, value in _asked(config).items():
        if name not in options:
            has = f"it has {', '.join(options)}" if options else "implicit steppers have some"
            raise ConfigError(f"stepper {kind.name} has no option {name!r}; {has}")
        options[name] = convert(f"stepper {kind.name}: {name}", known[name].annotation, value)
    return options


def _asked(config: RunConfig) -> dict[str, object]:
    flags = {"preconditioner": config.preconditioner, "tolerance": config.tolerance}
    given: dict[str, object] = {key: value for key, value in flags.items() if value is not None}
    settings = by_owner(config.settings).get(STEPPER, {})
    for name in given.keys() & settings.keys():
        raise ConfigError(f"{name} is given twice: by {name} and by set stepper.{name}")
    return given | settings
