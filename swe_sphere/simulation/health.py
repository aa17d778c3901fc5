"""Does the solution still make sense? A look every few steps keeps nonsense from going on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swe_sphere.errors import Unstable
from swe_sphere.planet import DAY
from swe_sphere.simulation.snapshot import Array, Moment

if TYPE_CHECKING:
    from swe_sphere.equations.model import Model

__all__ = ["HealthCheck"]

EVERY = 16
"""Steps between looks: they cost about a hundredth of the steps then."""

RUNAWAY = 10.0
"""Growth of the total energy that no scene here has, and every numerical explosion soon."""


class HealthCheck:
    """Ends the run where a value is not a number, a depth negative or the energy runs away."""

    def __init__(self, model: Model, start: dict[str, Array], limit: str) -> None:
        """start: fields at the start, for their energy; limit: what to say on stability."""
        self._area = model.mesh.area / model.mesh.area.sum()
        self._gravity = model.scene.planet.gravity
        self._linear = model.scene.linear
        self._energy = self._energy_of(start)
        self._limit = limit

    def due(self, step: int) -> bool:
        """Every few steps."""
        return step % EVERY == 0

    def observe(self, moment: Moment) -> None:
        """Look; Unstable says what is wrong, when, and what could be done."""
        trouble = self._trouble(moment.fields)
        if trouble:
            when = f"at day {moment.time / DAY:.4g} (step {moment.step})"
            raise Unstable(f"{trouble} {when}: {self._limit}")

    def _trouble(self, fields: dict[str, Array]) -> str | None:
        if not all(np.isfinite(values).all() for values in fields.values()):
            return "the solution is not a number any more"
        # a passive h, and that of a linear wave, may undershoot zero without harm
        if not self._linear and fields["h"].min() < 0.0:
            return f"the depth is negative ({fields['h'].min():.3g} m)"
        growth = self._energy_of(fields) / self._energy
        if growth > RUNAWAY:
            return f"the energy has grown {growth:.3g} times"
        return None

    def _energy_of(self, fields: dict[str, Array]) -> float:
        """Kinetic energy and that of the depth above a flat bottom: never negative."""
        h = fields["h"]
        speed2 = fields["u"] ** 2 + fields["v"] ** 2
        return 0.5 * float(np.sum(self._area * (h * speed2 + self._gravity * h**2)))
