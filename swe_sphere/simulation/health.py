"""Does the solution still make sense? A look every few steps keeps nonsense from going on."""

import numpy as np

from swe_sphere.arrays import Array
from swe_sphere.errors import Unstable
from swe_sphere.planet import DAY
from swe_sphere.simulation.running import Running

EVERY = 16
"""Steps between looks: they cost about a hundredth of the steps then."""

RUNAWAY = 10.0
"""Growth of the total energy that no scene here has, and every numerical explosion soon."""


class HealthCheck:
    """Ends the run where a value is NaN, a depth negative or the energy runs away."""

    def __init__(self, sim: Running) -> None:
        self._area = sim.mesh.area / sim.mesh.area.sum()
        self._gravity = sim.scene.planet.gravity
        self._linear = sim.scene.linear
        self._energy = self._energy_of(sim.initial.fields)

    def due(self, step: int) -> bool:
        """Every few steps."""
        return step % EVERY == 0

    def observe(self, sim: Running) -> None:
        """Look; Unstable says what is wrong, when, and what could be done."""
        failure = self._failure(sim.snapshot.fields)
        if failure:
            when = f"at day {sim.time / DAY:.4g} (step {sim.steps})"
            raise Unstable(f"{failure} {when}: {_advice(sim.plan.dt, sim.stable_dt)}")

    def _failure(self, fields: dict[str, Array]) -> str | None:
        if not all(np.isfinite(values).all() for values in fields.values()):
            return "the solution is NaN"
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


def _advice(dt: float, limit: float) -> str:
    """What to say when a run goes wrong."""
    text = f"dt = {dt:.6g} s, stability limit at the start about {limit:.4g} s"
    if dt > limit:
        return f"{text}; take a smaller dt"
    return f"{text}; try a finer mesh, a smaller dt or more dissipation"
